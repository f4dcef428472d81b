"""Displacement fields that a network proposes: their derivatives, their energies, and the frequencies they give."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

import scipy.linalg  # noqa: E402
from make_features import write, write_splits  # noqa: E402

from meshes import distorted_box  # noqa: E402
from vibraverse.cli import main  # noqa: E402
from vibraverse.config.learn import Learn, Network  # noqa: E402
from vibraverse.contract.seeds import rng  # noqa: E402
from vibraverse.geometry.boundary import boundary  # noqa: E402
from vibraverse.learn import inside, subspaces  # noqa: E402
from vibraverse.learn.baselines.galerkin import at_nodes  # noqa: E402
from vibraverse.learn.networks.fields import Fields  # noqa: E402
from vibraverse.learn.samples import Samples  # noqa: E402
from vibraverse.learn.tasks import task_at  # noqa: E402
from vibraverse.learn.tasks.subspace import Subspace, numbers, spectra_on  # noqa: E402
from vibraverse.physics.elasticity import assemble  # noqa: E402
from vibraverse.physics.materials import lame  # noqa: E402

pytestmark = pytest.mark.learn
MODES, POISSON = 12, 0.3


def bent() -> tuple[np.ndarray, np.ndarray]:
    """Return the tetrahedra of a bar bent through 200 degrees, thicker at one end: no mirror leaves it as it is."""
    points, cells = distorted_box((6.0, 0.8, 0.5), (12, 2, 2), 0.0, rng("bent"))
    along, across, up = points.T
    wide = 1.0 + 0.05 * along
    angle, radius = along * np.radians(200) / 6.0, 1.9 + (across - 0.2) * wide
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), up * wide + 0.1 * across]), cells


class Body:
    """A body with its elements, and their own lowest frequencies by LAPACK, as logarithms (m,)."""

    def __init__(self, points: np.ndarray, cells: np.ndarray):
        self.known = inside.describe(points, cells)
        self.operators = assemble(self.known["points"], self.known["cells"])
        self.half, self.values = numbers(self.known["points"], self.known["fields"])
        self.nodes = at_nodes(self.operators, self.values)

    def own(self) -> np.ndarray:
        stiffness = self.operators.stiffness(*lame(1.0, POISSON)).toarray()
        mass = self.operators.mass.toarray()
        found = scipy.linalg.eigh(stiffness, mass, eigvals_only=True, subset_by_index=(6, 5 + MODES))
        return 0.5 * np.log(found)

    def polynomials(self, degree: int) -> np.ndarray:
        scalars = subspaces.polynomials(torch.tensor(self.nodes[:, :3]), degree)[0]
        return spectra_on(self.operators, along_axes(scalars), [POISSON], MODES)[0]

    def batch(self, points: int, random, dtype=torch.float32) -> dict[str, torch.Tensor]:
        """Return a batch of this body alone at points inside."""
        known = self.known
        places, gradients = inside.draw(known["points"], known["cells"], self.values, points, random)
        parts = {"places": places, "gradients": gradients, "half": self.half, "scalars": known["scales"]}
        return {name: torch.tensor(value, dtype=dtype)[None] for name, value in parts.items()} | {
            "poisson": torch.tensor([POISSON], dtype=dtype)
        }

    def proposed(self, model: Subspace) -> np.ndarray:
        """Return what the fields of a model give on the elements."""
        batch = self.batch(1024, rng("code"))
        with torch.no_grad():
            codes = model.codes(batch["places"], batch["scalars"])
        space = model.at_nodes(codes, torch.tensor(self.nodes, dtype=torch.float32))
        return spectra_on(self.operators, space, [POISSON], MODES)[0]


def along_axes(scalars: torch.Tensor) -> np.ndarray:
    return subspaces.in_all_directions(scalars).flatten(0, 1).numpy()


def untrained(width: int = 48) -> Subspace:
    torch.manual_seed(0)
    scalars = 1 + inside.HARMONICS
    return Subspace(Network(width=width, layers=2), MODES, np.zeros(scalars), np.ones(scalars))


@pytest.fixture(scope="module")
def body():
    torch.set_num_threads(1)
    return Body(*bent())


def test_derivatives_of_the_fields_are_those_of_automatic_differentiation():
    torch.manual_seed(1)
    fields, codes = Fields(5, 16, 3, 4).double(), torch.randn(2, 64, dtype=torch.float64)
    places, gradients = (torch.randn(2, 7, *shape, 5, dtype=torch.float64) for shape in ((), (3,)))
    _, slopes = fields(codes, places, gradients)
    for axis in range(3):
        _, expected = torch.func.jvp(lambda at: fields(codes, at)[0], (places,), (gradients[:, :, axis],))
        torch.testing.assert_close(slopes[:, :, axis], expected, rtol=1e-10, atol=1e-12)


def test_energies_at_points_are_those_of_the_elements(body):
    """Quadratic polynomials are exact on quadratic elements with straight edges, so only the drawing of points errs."""
    batch = body.batch(20_000, rng("many"), torch.float64)
    scalars, sloped = subspaces.polynomials(batch["places"][..., :3], 2)
    slopes = subspaces.in_all_directions(sloped / batch["half"][:, None, :, None])
    stretched = subspaces.strains(slopes, batch["poisson"])[0]
    moved = subspaces.in_all_directions(scalars).flatten(1, 2)[0]
    nodes = along_axes(subspaces.polynomials(torch.tensor(body.nodes[:, :3]), 2)[0])
    for found, exact in (
        (stretched, body.operators.stiffness(*lame(1.0, POISSON))),
        (moved, body.operators.mass),
    ):
        expected = nodes.T @ (exact @ nodes)
        size = np.sqrt(np.diag(expected).clip(1e-6))  # constants have no energy
        error = ((found.T @ found).numpy() / 20_000 - expected) / size[:, None] / size
        assert np.abs(error).max() < 0.03
    count = nodes.shape[1] - 6
    at_points = subspaces.spectra(stretched[None], moved[None], count)[0].numpy()
    np.testing.assert_allclose(at_points, spectra_on(body.operators, nodes, [POISSON], count)[0], atol=0.02)


def test_the_gradient_of_the_loss_is_that_of_finite_differences(body):
    model, batch = untrained(16).double(), body.batch(200, rng("few"), torch.float64)

    def loss() -> torch.Tensor:
        places, gradients = batch["places"], batch["gradients"]
        values, slopes = model.space(model.codes(places, batch["scalars"]), places, gradients, batch["half"])
        return subspaces.spectra(
            subspaces.strains(slopes, batch["poisson"]), values.flatten(1, 2), MODES
        ).mean()

    model.fields.last.weight.data *= 0.3
    loss().backward()
    weights = [weight for weight in model.parameters() if weight.grad is not None]
    ways = [torch.randn_like(weight) for weight in weights]
    expected = sum((weight.grad * way).sum() for weight, way in zip(weights, ways, strict=True))
    ends = []
    for step in (1e-5, -2e-5):
        for weight, way in zip(weights, ways, strict=True):
            weight.data += step * way
        ends.append(loss().detach())
    assert abs(expected) > 1e-3
    torch.testing.assert_close((ends[0] - ends[1]) / 2e-5, expected.detach(), rtol=1e-3, atol=0)


def test_training_lowers_bounds_that_stay_bounds(body):
    """Below polynomials of the same dimension after a few steps on one body, and never below the elements."""
    model, own = untrained(), body.own()
    fourth, sixth, before = body.polynomials(4), body.polynomials(6), body.proposed(model)
    assert (before < fourth + 1e-9).all()  # the space holds these polynomials
    optimiser, random = torch.optim.AdamW(model.parameters(), 3e-3), rng("training")
    for _ in range(40):
        optimiser.zero_grad()
        model(body.batch(400, random)).mean().backward()
        optimiser.step()
    after = body.proposed(model)
    assert (after > own - 1e-9).all()
    assert (after < fourth + 1e-9).all()
    excess = {name: (found - own).mean() for name, found in
              {"4": fourth, "6": sixth, "before": before, "after": after}.items()}  # fmt: skip
    assert excess["after"] < 0.8 * excess["before"]
    assert excess["after"] < excess["6"] < 0.5 * excess["4"]


def test_a_turned_mirrored_or_scaled_body_is_the_same(body):
    turn = np.linalg.qr(rng("turn").standard_normal((3, 3)))[0]
    model = untrained()
    expected = body.proposed(model)
    points, cells = bent()
    for matrix in (turn, -turn):
        if np.linalg.det(matrix) < 0:
            moved = Body(2.5 * points @ matrix + 1.0, cells[:, [1, 0, 2, 3]])
        else:
            moved = Body(2.5 * points @ matrix + 1.0, cells)
        np.testing.assert_allclose(moved.known["points"], body.known["points"], atol=1e-12)
        np.testing.assert_allclose(moved.known["fields"], body.known["fields"], atol=1e-5)
        np.testing.assert_allclose(moved.proposed(model), expected, atol=1e-5)


def test_the_frame_of_a_symmetric_body_is_known_but_for_signs():
    points, cells = distorted_box((3.0, 2.0, 1.0), (3, 3, 3), 0.0, rng("box"))
    turn = np.linalg.qr(rng("turn").standard_normal((3, 3)))[0]
    once, again = (inside.describe(one, cells)["points"] for one in (points, points @ turn))
    for axis in range(3):
        same, mirrored = (np.abs(once - sign * again)[:, axis].max() for sign in (1, -1))
        assert min(same, mirrored) < 1e-12
    np.testing.assert_allclose(np.ptp(once, axis=0) * np.cbrt(6.0), [1.0, 2.0, 3.0])


def test_harmonics_and_torsion_of_a_bar_are_those_of_the_formula():
    """Along a bar the harmonics are cosines; in its section the torsion function is highest in the middle."""
    points, cells = distorted_box((8.0, 1.0, 1.0), (40, 4, 4), 0.0, rng("bar"))
    known = inside.describe(points, cells)
    np.testing.assert_allclose(
        np.exp(known["scales"][1:6]), (np.pi * np.arange(1, 6) / 8.0) ** 2 * np.cbrt(8.0) ** 2, rtol=0.02
    )
    along = points[:, 0] * np.pi / 8.0
    for number in range(1, 6):
        alike = np.corrcoef(known["fields"][:, number], np.cos(number * along))[0, 1]
        assert abs(alike) > 0.999
    assert np.exp(known["scales"][0]) * np.cbrt(8.0) ** 2 == pytest.approx(0.0737, rel=0.15)
    assert (known["fields"][boundary(cells)[1], 0] == 0).all()


def test_random_turns_mix_only_axes_of_nearly_equal_moments():
    random = rng("turns")
    apart = random.standard_normal((500, 3)) * [1.0, 2.0, 4.0]
    alike = random.standard_normal((500, 3)) * [1.0, 3.0, 3.0]
    for _ in range(20):
        assert (np.abs(inside.turn(apart, random)) == np.eye(3)).all()
        found = inside.turn(alike, random)
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
        assert abs(found[0, 0]) == 1
    assert 0.05 < abs(found[1, 2]) < 0.999


def test_from_training_to_answers_that_are_bounds(tmp_path):
    """Through the command line, as the rules call it: frequencies in Hz above those of the elements."""
    objects = [f"bar-{number:04d}" for number in range(10)]
    features = write(tmp_path / "0", objects, solidities=("solid",))
    splits = write_splits(tmp_path / "splits.tsv", objects)
    learn = Learn(preset="tiny", frequencies={"training": {"steps": 3, "batch_size": 4, "validate_every": 0}})
    asked = learn.run("frequencies", "object", "subspace", 0)
    common = ["--features", str(features), "--splits", str(splits), "--options", asked.model_dump_json()]
    at = {name: str(tmp_path / name) for name in ("model", "curves", "training", "answers", "record")}
    outputs = ["--model", at["model"], "--curves", at["curves"], "--record", at["training"]]
    assert main(["train", *common, *outputs]) == 0
    inputs = ["--model", at["model"], "--training", at["training"]]
    assert main(["evaluate", *inputs, *common, "--answers", at["answers"], "--record", at["record"]]) == 0
    assert {row["measure"] for row in json.loads((tmp_path / "record").read_text())["rows"]} >= {"median"}
    answers, samples = np.load(at["answers"]), Samples([features])
    task = task_at([features / "features.json"], splits, asked)
    assert list(answers["test/body"]) == task.ids("test")
    body = int(task.sides["test"][0])
    points, cells, _ = samples.tetrahedra(body)
    operators = assemble(points, cells)
    for number, one in enumerate(samples.materials.values()):
        stiffness = operators.stiffness(*lame(1.0, one["poisson"])).toarray()
        own = scipy.linalg.eigh(stiffness, operators.mass.toarray(), eigvals_only=True)[6:30]
        logarithms = 0.5 * np.log(own)[None]
        bounds = task.hertz(logarithms, np.array([body]), number)[0]
        found = answers["test/found_hz"][0, number]
        assert (found > bounds * (1 - 1e-9)).all()
        assert (found[:6] < 1.5 * bounds[:6]).all()
