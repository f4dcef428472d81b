"""``vibraverse predict``: the answers of the evaluation, exact physics, honest error bars, a sound, and mistakes."""

from __future__ import annotations

import importlib.metadata
import json
import re
import shlex
import shutil

import numpy as np
import pytest
import soundfile
import trimesh
from scipy.signal import find_peaks

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import MATERIALS, MODES, mesh_of, volume_of, write, write_splits  # noqa: E402

import documented  # noqa: E402
from vibraverse.cli import main  # noqa: E402
from vibraverse.config.learn import Learn  # noqa: E402
from vibraverse.contract import products  # noqa: E402
from vibraverse.flow.steps import VERSIONS  # noqa: E402
from vibraverse.learn.prediction import Predictor  # noqa: E402
from vibraverse.learn.trained import error_bars, read  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan", "rod") for number in range(4)]
PHYSICS = "results/learn/frequencies/object/physics/seed-0"
#: What makes a simulation small.
COARSE = ("--elements", 300, "--order", 1)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with trained models below results/, and a mesh."""
    folder = tmp_path_factory.mktemp("predict")
    shard = write(folder / "results/learn/features/00000", OBJECTS)
    splits = write_splits(folder / "splits.tsv", OBJECTS)
    for task, split, model in (
        ("frequencies", "object", "physics"), ("frequencies", "family-0", "physics"),
        ("frequencies", "object", "published"), ("solidity", "object", "sound"),
    ):  # fmt: skip
        asked = Learn(preset="tiny", **{task: {"training": {"steps": 6, "batch_size": 8}}})
        made = folder / f"results/learn/{task}/{split}/{model}/seed-0"
        made.mkdir(parents=True)
        given = (
            "--features", shard, "--splits", splits,
            "--options", asked.run(task, split, model, 0).model_dump_json(), "--model", made / "model.pt",
        )  # fmt: skip
        run("train", *given, "--curves", made / "curves.csv", "--record", made / "training.json")
        answers = ("--answers", made / "answers.npz", "--record", made / "metrics.json")
        run("evaluate", *given, "--training", made / "training.json", *answers)
    trimesh.creation.box((1.0, 0.6, 0.3)).export(folder / "mug.obj")
    return folder


def run(*arguments) -> None:
    assert main([str(argument) for argument in arguments]) == 0, arguments


@pytest.fixture
def here(place, tmp_path, monkeypatch):
    """A copy of that folder, as the working folder."""
    shutil.copytree(place, tmp_path / "here", ignore=shutil.ignore_patterns("features"))
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


@pytest.mark.parametrize("model", ["physics", "published"])
def test_a_prediction_is_the_answer_of_the_evaluation(place, model):
    """For the body's own id the points on its surface are the same, and so is the answer; no features are read."""
    folder = place / f"results/learn/frequencies/object/{model}/seed-0"
    predictor = Predictor(read(folder))
    with np.load(folder / "answers.npz") as answers:
        bodies, found = answers["test/body"].tolist(), answers["test/found_hz"]
    assert len(bodies) == 8
    for row in (0, 7):
        object_, solidity = bodies[row].split()
        mesh = mesh_of(object_)
        body = (mesh.vertices, mesh.faces, object_, solidity, volume_of(object_))
        np.testing.assert_allclose(predictor.frequencies(*body, MATERIALS), found[row], rtol=1e-5)


def test_stiffness_density_and_size_enter_exactly(place):
    predictor = Predictor(read(place / PHYSICS))
    mesh, steel = mesh_of("new-0000"), MATERIALS["steel"]
    body = (mesh.vertices, mesh.faces, "new-0000", "solid")
    materials = {
        "steel": steel,
        "stiff": {**steel, "young_pa": 4 * steel["young_pa"]},
        "heavy": {**steel, "density_kg_m3": 9 * steel["density_kg_m3"]},
    }
    once, stiff, heavy = predictor.frequencies(*body, 1e-3, materials)
    np.testing.assert_allclose(stiff, 2 * once, rtol=1e-12)
    np.testing.assert_allclose(heavy, once / 3, rtol=1e-12)
    np.testing.assert_allclose(predictor.frequencies(*body, 8e-3, materials)[0], once / 2, rtol=1e-12)


def test_error_bars_are_the_errors_on_unseen_bodies(place, here):
    """Those by family where there are some, else the model's own; none without answers."""
    solid = slice(0, None, 2)
    for split, bodies in (("family", 4), ("object", 4)):
        found = error_bars(read(here / PHYSICS), "solid")
        assert (found.split, found.trainings, found.bodies) == (split, 1, bodies)
        folder = here / f"results/learn/frequencies/{split.replace('family', 'family-0')}/physics/seed-0"
        with np.load(folder / "answers.npz") as answers:
            ratio = answers["test/true_hz"][solid] / answers["test/found_hz"][solid]
        inside = (ratio >= found.low) & (ratio <= found.high)
        assert (inside.sum(axis=(0, 1)) == 6).all()  # four bodies in two materials: all but the extremes
        shutil.rmtree(folder)
        if split == "object":
            shutil.copytree(place / PHYSICS, folder, ignore=shutil.ignore_patterns("answers.npz"))
    assert error_bars(read(here / PHYSICS), "solid") is None


def test_error_bars_of_other_options_are_not_taken(here):
    record = here / "results/learn/frequencies/family-0/physics/seed-0/metrics.json"
    products.write_json(record, {**products.read_json(record), "config_hash": "other"})
    assert error_bars(read(here / PHYSICS), "hollow").split == "object"


def test_the_commands_of_the_documentation(here, vibraverse):
    """Each runs; the table, the JSON and the sound agree, and a simulation is that of ``strike``."""
    shown = [
        shlex.split(command)[1:]
        for block in documented.blocks("")
        for command in documented.commands(block.text)
        if block.doc in ("README.md", "docs/predict.md") and command.startswith("vibraverse predict ")
    ]
    assert len(shown) >= 3
    for words in shown:
        status, out, err = vibraverse(*words, *COARSE)
        assert status == 0, err
        assert f"model: {PHYSICS} (physics, preset tiny, trained on 28 bodies)" in out
        assert len(re.findall(r"^ +\d+( +[\d.]+){3}", out, re.MULTILINE)) % MODES == 0
    assert sum("--check" in words for words in shown) == 1


def test_a_check_is_what_strike_gives(here, vibraverse):
    given = ("mug.obj", "--size", 0.2, *COARSE, "--material")
    status, out, err = vibraverse("predict", *given, "steel", "--check", "--json", "found.json")
    assert status == 0, err
    facts = json.loads((here / "found.json").read_text())
    row = facts["materials"]["steel"]
    status, _, err = vibraverse("strike", *given, "steel", "--modes", MODES, "--json", "strike.json")
    assert status == 0, err
    simulated = json.loads((here / "strike.json").read_text())
    assert row["simulated_hz"] == simulated["frequencies_hz"]
    assert row["parameters"] == simulated["material_parameters"]
    assert row["mass_kg"] == pytest.approx(simulated["mass_kg"], rel=1e-3)
    error = np.array(row["frequencies_hz"]) / row["simulated_hz"] - 1
    np.testing.assert_allclose(row["relative_error"], error, atol=1e-12)
    median = np.median(np.abs(error))
    assert (
        f"median error of {MODES} modes: {100 * median:.1f} %; {row['within_error_bars']} of them lie" in out
    )
    assert facts["size_m"] == 0.2
    assert set(facts["seconds"]) == {"loading", "cleaning", "predicting", "simulating"}


def test_several_materials_and_their_sounds(here, vibraverse):
    status, out, err = vibraverse(
        "predict", "mug.obj", "--size", 2, "--material", "steel", "8e11,7850,0.29,5,3e-8", "wood",
        "--sound", "mug.wav", "--json", "-",
    )  # fmt: skip
    assert status == 0, err
    rows = json.loads(out)["materials"]
    once, stiff = (np.array(rows[name]["frequencies_hz"]) for name in ("steel", "8e11,7850,0.29,5,3e-8"))
    np.testing.assert_allclose(stiff, 2 * once, rtol=1e-12)
    names = {
        "steel": "mug-steel.wav",
        "8e11,7850,0.29,5,3e-8": "mug-8e11_7850_0.29_5_3e-8.wav",
        "wood": "mug-wood.wav",
    }
    assert {name: sound["file"] for name, sound in json.loads(out)["sounds"].items()} == names
    assert not (here / "mug.wav").exists()
    samples, rate = soundfile.read(here / "mug-steel.wav")
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples))))
    peaks, _ = find_peaks(spectrum, prominence=2e-3 * spectrum.max())
    at_hz = peaks * rate / len(samples)
    assert len(at_hz) > MODES / 2
    assert np.abs(at_hz[:, None] - once).min(axis=1).max() < 2 * rate / len(samples)
    assert np.abs(at_hz[:, None] - once).min(axis=0)[:4].max() < 2 * rate / len(samples)
    assert spectrum[peaks].argmax() == 0  # amplitudes fall with the frequency


def test_a_hollow_body_is_hollowed_first(here, vibraverse):
    status, _, err = vibraverse(
        "predict", "mug.obj", "--size", 0.2, "--hollow", 0.5, "--material", "steel", "--json", "found.json"
    )
    assert status == 0, err
    facts = json.loads((here / "found.json").read_text())
    assert facts["solidity"] == "hollow"
    full = 0.2**3 * 0.6 * 0.3
    assert 0.5 * full < facts["volume_m3"] < 0.95 * full
    steel = facts["materials"]["steel"]
    bars = error_bars(read(here / PHYSICS), "hollow")
    np.testing.assert_allclose(steel["low_hz"], bars.low * steel["frequencies_hz"])
    assert (bars.low != error_bars(read(here / PHYSICS), "solid").low).all()


def test_the_best_model_of_the_results_is_taken(here, vibraverse):
    """Those trained on all families go before the others, whatever their validation says."""
    for split, median in (("object", 0.5), ("family-0", 0.001)):
        _validated(here / f"results/learn/frequencies/{split}/physics/seed-0", median)
    better = "results/learn/frequencies/object/physics/seed-1"
    shutil.copytree(here / PHYSICS, here / better)
    _validated(here / better, 0.01)
    (here / "results/learn/frequencies/object/published/seed-0/training.json").write_text("{")
    shutil.move("results", "elsewhere")
    status, out, err = vibraverse("predict", "mug.obj", "--results", "elsewhere")
    assert status == 0, err
    assert f"model: {better.replace('results', 'elsewhere')} (" in out


def _validated(folder, median: float) -> None:
    record = products.read_json(folder / "training.json")
    record["metrics"]["best"]["validation"]["median"] = median
    products.write_json(folder / "training.json", record)


def test_warnings_say_how_far_an_answer_can_be_believed(here, vibraverse):
    published = PHYSICS.replace("physics", "published")
    status, out, err = vibraverse("predict", "mug.obj", "--model", published, "--material", "2e9,1100,0.45")
    assert status == 0, err
    for sentence in (
        "model: Poisson's ratio of 2e9,1100,0.45, 0.45, lies outside 0.1 to 0.4, which the model was trained on",
        "model: the model 'published' is not told the size of a body, and has seen the materials steel, wood alone",
        "error bars: the tested bodies have siblings among those trained on",
        "error bars: they rest on 4 bodies (at least 20 are needed)",
        "size: the file states no unit; its longest side is taken as 0.15 m; give --size",
    ):
        assert f"warning: {sentence}" in out


def _older(folder) -> None:
    record = products.read_json(folder / "training.json")
    record["provenance"]["stage_version"] = 1
    products.write_json(folder / "training.json", record)


def _swapped(folder) -> None:
    """Weights of another network, and a record that knows them."""
    shutil.copy(folder.parents[1] / "published/seed-0/model.pt", folder / "model.pt")
    record = products.read_json(folder / "training.json")
    record["provenance"]["output_sha256"]["model"] = products.sha256(folder / "model.pt")
    products.write_json(folder / "training.json", record)


def _cut(folder) -> None:
    content = (folder / "model.pt").read_bytes()
    (folder / "model.pt").write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (_older, f"was written by version 1 of the stage train, and this is version {VERSIONS['train']}"),
        (_cut, "model.pt is not the file that its training wrote: it is damaged"),
        (_swapped, "model.pt does not fit the network of vibraverse"),
        (lambda folder: (folder / "model.pt").unlink(), "the weights of the model, "),
        (lambda folder: (folder / "training.json").write_text("{}"), "is not the record of a training"),
        (lambda folder: (folder / "training.json").unlink(), "does not exist; name the folder of a training"),
    ],
)  # fmt: skip
def test_a_model_that_cannot_be_used_is_one_sentence(here, vibraverse, damage, sentence):
    damage(here / PHYSICS)
    said = mistake(vibraverse, "mug.obj", "--model", PHYSICS)
    assert sentence in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("mug.obj", "--material", "stell"), "unknown material 'stell'; did you mean 'steel'?"),
        (("mug.obj", "--material", "2e11,7850"), "--material takes a name, or Young's modulus in Pa, density in kg/m³"),
        (("mug.obj", "--material", "2e11,7850,0.5"), "--material 2e11,7850,0.5: poisson must be less than 0.5"),
        (("mug.obj", "--material", "2e11,7850,nan"), "--material 2e11,7850,nan: poisson must be"),
        (("mug.obj", "--size", "0"), "--size must be greater than 0"),
        (("mug.obj", "--sound", "no/such/a.wav"), "the folder of no/such/a.wav does not exist"),
        (("mug.obj", "--json", ".."), ".. is a folder"),
        (("gone.obj",), "the mesh file gone.obj does not exist"),
        (("flat.obj",), "[not_a_solid]"),
        (("mug.obj", "--results", "empty"), "empty holds no trained model of the task 'frequencies'; train one with"),
        (
            ("mug.obj", "--model", "results/learn/solidity/object/sound/seed-0"),
            "holds a model of the task 'solidity', which gives no frequencies",
        ),
        (("mug.obj", "--model", "on-tets"), "the model 'subspace', which takes a body's tetrahedra; name another"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence(here, vibraverse, arguments, sentence):
    record = products.read_json(here / "results/learn/frequencies/object/physics/seed-0/training.json")
    record["provenance"]["options"]["model"] = "subspace"
    (here / "on-tets").mkdir(exist_ok=True)
    products.write_json(here / "on-tets/training.json", record)
    (here / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    assert sentence in mistake(vibraverse, *arguments)


def mistake(vibraverse, *arguments) -> str:
    status, out, err = vibraverse("predict", *arguments)
    assert (status, out) == (2, ""), err
    assert len(err.strip().splitlines()) == 1
    return err


@pytest.mark.parametrize(
    ("lacking", "more", "said"),
    [("torch", (), "predict needs"), ("gmsh", ("--check",), "predict --check needs")],
)
def test_an_environment_without_a_part_is_one_sentence(here, vibraverse, monkeypatch, lacking, more, said):
    version = importlib.metadata.version

    def without(name: str) -> str:
        if name == lacking:
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without)
    status, out, err = vibraverse("predict", "mug.obj", *more)
    assert (status, out) == (1, "")
    assert f"{said} the Python packages {lacking}, which this environment lacks; make one" in err
    assert "envs/env.sh .venv-learn learn workstation" in err
