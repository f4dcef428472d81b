"""Model ``subspace`` of task ``frequencies``: a network proposes displacement fields, mechanics does the rest.

The trial space holds all polynomials of total degree 4 and as many proposed fields as make its dimension that of
degree 6. Training minimises the Ritz values at points inside, so it needs no labels; the true spectrum only makes the
loss readable. Fields do not depend on the material. The answers come from the stored tetrahedra with quadratic
elements, which gives upper bounds of the frequencies of these elements. (Those of the dataset are corrected for the
elements' error, so they may be lower still.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg
import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

from vibraverse.contract.seeds import rng
from vibraverse.learn import inside, subspaces
from vibraverse.learn.baselines.galerkin import at_nodes, check_enough, elastic_basis
from vibraverse.learn.baselines.polynomials import exponents
from vibraverse.learn.networks.fields import BodyCode, Fields
from vibraverse.learn.precision import exact, tf32
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import log_dimensionless
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.tasks.bodies import Bodies, Drawn
from vibraverse.learn.tasks.frequencies import Frequencies, between
from vibraverse.physics.columns import project
from vibraverse.physics.elasticity import Operators, assemble, rigid_modes
from vibraverse.physics.materials import lame

#: Degree of the polynomials in the space, and that of the polynomials whose dimension the space has.
DEGREE, EQUAL = 4, 6
#: Bodies whose fields are in memory at once.
_TOGETHER = 4
#: Most points of a body in a step; `network.points` are points on surfaces, which cost less.
_POINTS = 1024
#: Points for validation, as a multiple of those for a step: the fewer, the lower a Ritz value that fits them.
_MORE = 4


def dimension(degree: int) -> int:
    """Return the number of polynomial displacements up to a total degree."""
    return 3 * len(exponents(degree))


class Subspace(nn.Module):
    """Points inside bodies to the logarithms of dimensionless frequencies, by Ritz values of polynomials and a network.

    ``centre`` and ``spread`` (s,) normalise the numbers that describe a body.
    """

    def __init__(self, network, modes: int, centre: np.ndarray, spread: np.ndarray):
        super().__init__()
        self.modes = modes
        inputs = 3 + 1 + inside.HARMONICS
        self.code = BodyCode(inputs, len(centre), network.width)
        self.fields = Fields(inputs, network.width, network.layers, dimension(EQUAL) - dimension(DEGREE))
        for name, values in (("centre", centre), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, batch: dict) -> torch.Tensor:
        """Return the logarithms (B, m), whose derivatives are those of the Ritz values."""
        names = ("places", "gradients", "half", "scalars", "poisson")
        parts = zip(*(batch[name].split(_TOGETHER) for name in names), strict=True)
        # Fields fill the memory, so those of a few bodies are there at once, and are computed again for derivatives.
        # Derivatives are small differences of large numbers: no rounding to bfloat16 or TF32.
        with exact(batch["places"].device), tf32(False):
            found = [checkpoint(self.spectra, *part, use_reentrant=False) for part in parts]
        return torch.cat(found)

    def spectra(self, places, gradients, half, scalars, poisson) -> torch.Tensor:
        """Return the logarithms (B, m) of a few bodies."""
        values, slopes = self.space(self.codes(places, scalars), places, gradients, half)
        stretched = subspaces.strains(slopes, poisson)
        return subspaces.spectra(stretched, values.flatten(1, 2), self.modes).float()

    def codes(self, places: torch.Tensor, scalars: torch.Tensor) -> torch.Tensor:
        """Return the codes of bodies from points inside (B, q, k) and numbers (B, s)."""
        return self.code(places, (scalars - self.centre) / self.spread)

    def space(self, codes, places, gradients, half) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the whole trial space (B, q, 3, n) at places, and its derivatives (B, q, a, 3, n) in float64."""
        proposed, slopes = self.fields(codes, places, gradients)
        scalars, sloped = subspaces.polynomials(places[..., :3].double(), DEGREE)
        # ∂/∂x_a = 1/half_a ∂/∂ξ_a for the coordinates of the body's box.
        known = subspaces.in_all_directions(sloped * (1.0 / half.double())[:, None, :, None])
        values = torch.cat([subspaces.in_all_directions(scalars), proposed.double()], dim=-1)
        return values, torch.cat([known, slopes.double()], dim=-1)

    @torch.no_grad()
    def at_nodes(self, codes: torch.Tensor, places: torch.Tensor) -> np.ndarray:
        """Return the trial space (3N, n) at the nodes of a body, whose numbers are ``places`` (N, k)."""
        proposed, _ = self.fields(codes, places[None])
        scalars, _ = subspaces.polynomials(places[:, :3].double(), DEGREE)
        space = torch.cat([subspaces.in_all_directions(scalars), proposed[0].double()], dim=-1)
        return space.flatten(0, 1).cpu().numpy()


class Insides(Drawn):
    """Bodies as points inside. With a ``seed`` each item draws points, a mirroring and a Poisson's ratio of its own."""

    def __init__(self, bodies: Bodies, points: int, seed: int | None, answered: bool = False):
        super().__init__(bodies, seed)
        self.points, self.answered = points, answered

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body."""
        samples, body = self.items.samples, item["body"]
        poisson, turn, signs = self.items.parameters[item["material"], 2], np.eye(3), 1.0
        points, cells, fields = samples.tetrahedra(body)
        drawn = random
        if random is None:
            drawn = rng(samples.ids[body], "inside")
        else:
            poisson = random.uniform(samples.poisson[0], samples.poisson[-1])
            turn = inside.turn(points, random)
            signs = np.append(1.0, random.choice([-1.0, 1.0], size=fields.shape[1] - 1))
        half, values = numbers(points @ turn, fields * signs)
        places, gradients = inside.draw(points @ turn, cells, values, self.points, drawn)
        return {
            "body": np.int64(body),
            "answered": np.bool_(self.answered),
            "places": places.astype(np.float32),
            "gradients": gradients.astype(np.float32),
            "half": half.astype(np.float32),
            "scalars": scalars(samples, body, half),
            "poisson": np.float32(poisson),
            "log_omega": np.array(samples.row("log_omega", body)),
        }


def numbers(points: np.ndarray, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half the sides of a body's box (3,), and the numbers of its vertices (N, 3): coordinates in it, fields."""
    middle, half = 0.5 * (points.max(axis=0) + points.min(axis=0)), 0.5 * np.ptp(points, axis=0)
    return half, np.column_stack([(points - middle) / half, fields])


def scalars(samples: Samples, body: int, half: np.ndarray) -> np.ndarray:
    """Return the numbers (s,) that describe a body as a whole."""
    parts = [np.log(samples.row("invariants", body)), np.log(half), samples.row("scales", body)]
    return np.concatenate(parts).astype(np.float32)


class SubspaceTask(Frequencies):
    """The task for the trainer."""

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        rows = []
        for body in self.sides[TRAIN]:
            points, _, fields = self.samples.tetrahedra(body)
            rows.append(scalars(self.samples, body, numbers(points, fields)[0]))
        about = np.mean(rows, axis=0), np.std(rows, axis=0) + 1e-3
        return Subspace(self.options.network, self.samples.row("log_omega", 0).shape[-1], *about)

    def dataset(self, split: str, material: int = 0, answered: bool = False) -> Insides:
        """Return the bodies of a side; those of ``train`` are drawn anew in each epoch, others have one material."""
        bodies = Bodies(self.samples, self.sides[split], material)
        points = min(self.options.network.points, _POINTS) * (1 if split == TRAIN else _MORE)
        return Insides(bodies, points, self.seed(split), answered)

    def prepare(self, batch: dict, device) -> dict:
        """Return the batch on a device, with the spectrum at the Poisson's ratio of each body."""
        batch = super(Frequencies, self).prepare(batch, device)
        nodes = torch.tensor(self.samples.poisson, dtype=torch.float32, device=device)
        return {**batch, "log_omega": between(nodes, batch["log_omega"], batch["poisson"])}

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,): by how much its frequencies are too high, as mean logarithm."""
        return (model(batch) - batch["log_omega"]).mean(dim=-1)

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return logarithms (B, m) by points inside; where answers are asked for those of all materials (B, k, m).

        Answers come from the tetrahedra.
        """
        if not batch["answered"].all():
            return {"found": model(batch), "true": batch["log_omega"]}
        with exact(batch["places"].device):
            codes = model.codes(batch["places"], batch["scalars"])
            found = [
                self.on_tetrahedra(model, codes[number : number + 1], body)
                for number, body in enumerate(batch["body"].tolist())
            ]
        return {"found": torch.tensor(np.stack(found))}

    def on_tetrahedra(self, model: Subspace, codes: torch.Tensor, body: int) -> np.ndarray:
        """Return the logarithms (k, m) of a body's dimensionless frequencies in all materials."""
        points, cells, fields = self.samples.tetrahedra(body)
        operators = assemble(points, cells)
        _, values = numbers(points, fields)
        places = torch.tensor(at_nodes(operators, values), dtype=torch.float32, device=codes.device)
        space = model.at_nodes(codes, places)
        ratios = [one["poisson"] for one in self.samples.materials.values()]
        return spectra_on(operators, space, ratios, model.modes)

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return predicted and true frequencies (n, materials, m) of a side in Hz."""
        bodies = self.sides[side]
        said = predict(side, self.dataset(side, answered=True))
        found = [
            self.hertz(said["found"][:, number], bodies, number)
            for number in range(len(self.samples.materials))
        ]
        true = self.samples.rows("frequencies_hz", bodies)
        return {"found_hz": np.stack(found, axis=1), "true_hz": true}


def spectra_on(operators: Operators, space: np.ndarray, poisson, modes: int) -> np.ndarray:
    """Return the logarithms (k, m) of the dimensionless Ritz frequencies of fields (3N, n) at Poisson's ratios (k,).

    Raises :class:`ValueError` if fewer than ``modes`` independent elastic fields are left.
    """
    basis = elastic_basis(operators.mass, space, rigid_modes(operators.nodes))
    check_enough(space, basis, modes)
    k_lambda, k_mu, mass = (
        project(basis, one) for one in (operators.k_lambda, operators.k_mu, operators.mass)
    )
    found = []
    for ratio in poisson:
        lam, mu = lame(1.0, ratio)
        found.append(scipy.linalg.eigvalsh(lam * k_lambda + mu * k_mu, mass, driver="gvd")[:modes])
    return log_dimensionless(np.array(found), operators.volume)
