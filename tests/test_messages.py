"""Messages: each kind is provoked and says what is wrong, why, and what to do.

The literal texts in the source are checked as well."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

import make_products
import shapes
from machine_messages import MACHINES
from messages import JOINED, SAID, Said, avoided_in, complaints, misformed, remedied, said_in_the_source
from vibraverse.config import ConfigError, load
from vibraverse.contract.errors import NotStored, NotThere, Refused, UsageError
from vibraverse.contract.limits import run_limited
from vibraverse.contract.refusal import REASONS
from vibraverse.files.meshes import read_mesh
from vibraverse.flow.plan import Plan
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.meshing.tets import tetrahedralise
from vibraverse.machine import gpus
from vibraverse.physics.basis import build_basis
from vibraverse.sources.families import generate

#: Literal text of a message: shorter ones cannot have three parts.
SHORTEST = 25
SOURCE = list(said_in_the_source())


# The source


def test_the_source_is_read():
    assert len(SOURCE) > 150
    assert {said.kind for said in SOURCE} == set(SAID)


@pytest.mark.parametrize("said", SOURCE, ids=lambda said: said.place)
def test_a_message_in_the_source(said: Said):
    """Computed parts (``str(error)``, ``unknown(…)``) are checked below, where they are provoked."""
    wrong = []
    if said.kind == "Refused":
        joined = said.place.partition(":")[0] in JOINED
        wrong += [] if said.advice or joined else ["has no advice"]
        if said.advice and said.advice != "{}":
            wrong += misformed(said.advice, refusal=True) + avoided_in(said.advice)
            wrong += [] if remedied(said.advice) else ["the advice does not say what to do"]
        if said.text and not joined:
            wrong += misformed(said.text, refusal=True)
    elif said.text and re.search(r"[a-z]{3} [a-z]", said.text):
        wrong += misformed(said.text, refusal=False)
        own = said.text.replace("{}", "")
        wrong += ["is short"] if len(own) < SHORTEST and not said.text.endswith((": {}", " {} {}")) else []
        # What ends with a value may end with the sentence of another, which has the remedy.
        wrong += (
            [] if remedied(said.text) or said.text.endswith(("{}", "{})")) else ["does not say what to do"]
        )
    wrong += avoided_in(said.text or "")
    assert not wrong, said


# The rules themselves


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("the file a.yaml does not exist", "does not say what to do"),
        ("there is no file a.yaml; name another one", "'there is no': say 'does not exist'"),
        ("a.yaml; name another one", "does not say why"),
        ("the file does not exist; name another one", "does not name 'a.yaml'"),
        ("a.yaml is no table; name another one", "'is no t': say 'is not a'"),
        ("a.yaml was remade; name another one", "'remade': say 'retried, refined, remeshed'"),
    ],
)
def test_what_a_message_lacks_is_noticed(text, complaint):
    assert complaints(text, ("a.yaml",)) == [complaint]
    assert not complaints("the file a.yaml does not exist; name another one", ("a.yaml",))


def test_form():
    assert misformed("The mesh is flat.", refusal=True) == []
    assert misformed("the mesh is flat", refusal=True) == ["has no stop", "begins small"]
    assert misformed("--modes must be 1, not 0", refusal=False) == []
    assert misformed("Give modes.", refusal=False) == ["has a stop", "begins with a capital"]


# Refusals


def _file(tmp_path, name: str, text: str):
    (tmp_path / name).write_text(text)
    return read_mesh(tmp_path / name)


def _plate(tmp_path):
    """Hollow a plate that is thinner than a sample of its distance grid."""
    vertices, faces = shapes.box((1.8, 1.8, 0.001))
    return hollow(vertices, faces, np.full((16, 16, 16), 0.1), 0.5)


def _tangle(tmp_path):
    """Clean triangles that hang together nowhere and enclose nothing, in all directions."""
    points = np.random.default_rng(0).normal(size=(60, 3))
    return clean(points, np.arange(60).reshape(-1, 3), max_dropped=0.0)


def _boxes(tmp_path):
    return clean(*shapes.together(shapes.box(), shapes.box(centre=(4, 0, 0)), shapes.box(centre=(0, 4, 0))))


def _one_tetrahedron(tmp_path):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return build_basis(corners, np.array([[0, 1, 2, 3]]), rng=np.random.default_rng(0), order=1, modes=20)


_CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"

#: Reason: how to provoke it, what the message names, why it says, what its advice names.
REFUSALS: dict[str, tuple[Callable, tuple[str, ...], str, str]] = {
    "unreadable": (
        lambda at: _file(at, "a.obj", _CUBE + "f 1 2 9\n"), ("a.obj", "vertex 8"), "its vertices are 0 to 3", "Export",
    ),
    "empty": (lambda at: _file(at, "a.stl", ""), ("a.stl", "0 bytes"), "is empty", "Export it again"),
    "not_finite": (
        lambda at: _file(at, "a.obj", _CUBE + "v nan 0 0\nf 1 2 3\n"), ("a.obj", "1 of 5"), "not a finite number",
        "Remove",
    ),
    "not_a_solid": (lambda at: clean(*shapes.sheet()), ("mesh",), "is an open sheet", "clean.open_sheets"),
    "too_large": (
        lambda at: clean(*shapes.box(), max_triangles=3), ("12 triangles",), "the limit is 3", "clean.max_triangles",
    ),
    "not_repairable": (_tangle, ("surface",), "No repair made", "Close its holes"),
    "separate_bodies": (_boxes, ("2 further bodies", "66.7 %"), "at most 50 %", "clean.max_dropped"),
    "too_thin": (_plate, ("The body",), "holds no sample of the distance grid", "grids.fine"),
    "meshing_failed": (
        lambda at: tetrahedralise(*shapes.cylinder(0.5, 1.8), 300, min_dihedral_deg=45.0),
        ("surface",), "degrees between two faces", "tets.target_elements",
    ),
    "solve_failed": (_one_tetrahedron, ("12 unknowns",), "too few for 20 elastic", "basis.modes"),
    "unavailable": (lambda at: generate("mug-0000"), ("mug-0000",), "No shape family makes", "`vibraverse objects"),
    "limit": (
        lambda at: run_limited(time.sleep, 60, seconds=3, memory_mb=500, key="tets.limits", what="The mesher"),
        ("The mesher", "3 s"), "was stopped when it had stood still", "tets.limits.seconds",
    ),
}  # fmt: skip


@pytest.mark.parametrize("reason", REASONS)
def test_a_refusal(reason, tmp_path):
    provoke, wrong, why, remedy = REFUSALS[reason]
    with pytest.raises(Refused) as found:
        provoke(tmp_path)
    refused = found.value
    assert refused.reason == reason
    assert not complaints(str(refused), wrong, why)
    assert remedy in refused.advice
    for text in (refused.message, refused.advice):
        assert not misformed(text, refusal=True), text


# The configuration


#: Kind: the configuration's text, what the message names, why it says.
CONFIGURATIONS = {
    "unknown key": ("tets: {target_element: 3}", ("'tets.target_element'", "'target_elements'"), "unknown key"),
    "wrong type": ("tets: {target_elements: many}", ("tets.target_elements", '"many"'), "must be a whole number"),
    "list for keys": ("materials: [steel]", ("materials", '["steel"]'), "must hold keys and values"),
    "out of range": ("basis: {max_error: 2}", ("basis.max_error", "2"), "must be at most 0.01"),
    "not one of": ("basis: {order: 3}", ("basis.order", "3"), "must be 1 or 2"),
    "missing key": ("materials: {tin: {poisson: 0.3}}", ("materials.tin.young_pa",), "is missing"),
    "unknown name": ("sources: {bundled: [nutt]}", ("sources.bundled", "'nutt'", "'nut'"), "unknown bundled model"),
    "unknown family": ("sources: {generated: {families: [bel]}}", ("'bel'", "'bell'"), "unknown family"),
    "unknown material": ("materials: {stell: }", ("'stell'", "'steel'"), "unknown material"),
    "unknown solidity": ("solidities: [holow]", ("solidities", "'holow'", "'hollow'"), "unknown solidity"),
    "unknown look": ("images: {looks: [cly]}", ("images.looks", "'cly'", "'clay'"), "unknown look"),
    "reserved name": (
        "materials: {sampled-0001: {density_kg_m3: 900, young_pa: 1.0e9, poisson: 0.3, alpha_per_s: 1, beta_s: 1.e-7}}",
        ("'sampled-0001'",), "is reserved for sampled materials",
    ),
    "another unit": (
        "materials: {tin: {density_kg_m3: 7.3, young_pa: 5.0, poisson: 0.3, alpha_per_s: 1, beta_s: 1.0e-7}}",
        ("materials.tin", "5"), "is softer than any solid",
    ),
    "two keys": ("audio: {sampled: 3}", ("audio.sampled", "3"), "must be at most sampled.count"),
    "size of nothing": ("sources: {sizes_m: {mug: 0.1}}", ("sources.sizes_m", "'mug'"), "unknown object"),
    "missing path": ("sources: {files: [{path: nowhere}]}", ("sources.files[0].path", "nowhere"), "does not exist"),
    "no objects": ("sources: {generated: {count: 0}, bundled: []}", ("sources",), "no object is named"),
    "bad UID": ("sources: {objaverse: {uids: [a/b]}}", ("sources.objaverse.uids", "'a/b'"), "is not a UID"),
    "shares": ("dataset: {splits: {train: 0.5}}", ("dataset.splits", "0.5"), "must add up to 1"),
    "slices": ("slice: 9/4", ("slice", "'9/4'"), "is not a slice"),
    "too many slices": ("slice: 1/99\ndataset: {shards: 4}", ("slice", "dataset.shards", "4"), "makes whole shards"),
    "kept splits": ("dataset: {keep_splits: nowhere.tsv}", ("dataset.keep_splits", "nowhere.tsv"), "does not exist"),
    "bad YAML": ("a: [1, 2\nb: 3", ("mine.yaml", "line 2, column 2"), "is not valid YAML"),
    "no keys": ("# nothing\n", ("mine.yaml",), "holds no keys"),
    "a list": ("- tets\n", ("mine.yaml", '["tets"]'), "must hold keys and values"),
}  # fmt: skip


def _planned(path: str) -> dict:
    """Return the objects of a configuration, which are looked for when they are asked for."""
    return Plan(load(path).model_dump()).objects


@pytest.mark.parametrize("kind", CONFIGURATIONS)
def test_a_mistake_in_the_configuration(kind, tmp_path, monkeypatch):
    text, wrong, why = CONFIGURATIONS[kind]
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(text)
    with pytest.raises(ConfigError) as found:
        _planned("mine.yaml")
    said = str(found.value)
    if len(found.value.mistakes) > 1:
        said = next(mistake for mistake in found.value.mistakes if wrong[0] in mistake)
    assert not complaints(said, wrong, why), said
    assert not misformed(said, refusal=False), said


# Commands


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A finished run of made-up products."""
    return make_products.build(tmp_path_factory.mktemp("messages") / "results")


_STRIKE = ("strike", "{mesh}")
_EXPORT = ("export", "{dataset}", "--format", "huggingface")
_STAGE = ("tets", "--object", "a", "--solidity", "solid", "--tets", "t.msh", "--record", "t.json")
#: Arguments of a command, what the message names, why it says.
COMMANDS = [
    (("clea",), ("'clea'", "'clean'"), "unknown command"),
    ((*_STAGE, "--surface", "gone.ply"), ("tets", "gone.ply"), "does not exist"),
    ((*_STAGE, "--surface", "."), ("tets: the input .",), "is a folder"),
    ((*_STAGE, "--surface", "{mesh}", "--options", "{{"), ("--options",), "is not valid JSON"),
    ((*_STAGE, "--surface", "{mesh}", "--options", '{{"target": 1}}'), ("'tets.target'", "known"), "unknown key"),
    (("strike", "gone.obj"), ("gone.obj",), "does not exist"),
    (("strike", "."), ("the mesh file .",), "is a folder"),
    (("strike", "{text}"), ("notes.txt",), "is not a mesh file"),
    ((*_STRIKE, "--material", "stell"), ("'stell'", "'steel'"), "unknown material"),
    ((*_STRIKE, "--poisson", "0.5"), ("--poisson", "0.5"), "must be less than 0.5"),
    ((*_STRIKE, "--modes", "0"), ("--modes", "0"), "must be greater than 0"),
    ((*_STRIKE, "--threads", "0"), ("--threads", "0"), "must be at least 1"),
    ((*_STRIKE, "--hollow", "2"), ("--hollow", "2"), "must lie between 0 and 1"),
    ((*_STRIKE, "--at", "1,2"), ("--at", "'1,2'"), "takes three numbers"),
    ((*_STRIKE, "--at", "9,9,9"), ("--at 9,9,9",), "is not on the mesh"),
    ((*_STRIKE, "-o", "gone/a.wav"), ("gone/a.wav",), "does not exist"),
    ((*_STRIKE, "-o", "."), (". is a folder",), "is a folder"),
    (("refusals", "--results", "gone"), ("gone/objects", "--results"), "holds no objects"),
    (("refusals", "--record", "gone/dataset.json"), ("gone/dataset.json",), "does not exist"),
    (("refusals", "--results", "{results}", "--retry", "to_thin"), ("'to_thin'", "'too_thin'"), "unknown reason"),
    (("repair", "--results", "gone"), ("gone", "--results"), "holds no objects"),
    (("resources", "--results", "{results}"), ("/journal",), "holds no job that ended"),
    (("provenance", "gone.ply"), ("gone.ply",), "does not exist"),
    (("provenance", "{text}"), ("notes.txt",), "is not in a results folder"),
    (("provenance", "{results}/dataset/index.tsv", "--object", "mug"), ("'mug'", "--object"), "holds no object"),
    (("validation", "--record", "gone.json"), ("gone.json",), "does not exist"),
    ((*_EXPORT, "-o", "{results}"), ("/results",), "is not empty"),
    ((*_EXPORT, "-o", "new", "--max-mb", "0"), ("--max-mb", "0"), "must be greater than 0"),
    ((*_EXPORT, "-o", "new", "--where", "steel"), ("--where", "'steel'"), "takes COLUMN=VALUE"),
    ((*_EXPORT, "-o", "new", "--where", "modes=many"), ("--where modes", "'many'"), "must be a number"),
    ((*_EXPORT, "-o", "new", "--where", "material=stell"), ("'stell'", "'steel'"), "unknown material"),
    ((*_EXPORT, "-o", "new", "--where", "modes=3"), ("modes", "3"), "in no item"),
    ((*_EXPORT, "-o", "new", "--where", "metal=steel"), ("'metal'", "'material'"), "unknown column"),
    (
        (*_EXPORT, "-o", "new", "--where", "object=ball-0000", "solidity=hollow"),
        ("object=ball-0000 solidity=hollow",), "matches --where",
    ),
    (("gpus", "true"), ("GPUs",), "does not say how many"),
    (("gpus", "--claim", "-1", "true"), ("--claim",), "must be 0 or more"),
    (("submit", "--slices", "0", "--configfile", "{config}"), ("--slices", "0"), "must be at least 1"),
    (("submit", "--slices", "2", "--configfile", "{config}", "--profile", "gone"), ("gone",), "is not a profile"),
    (("submit", "--slices", "2", "--configfile", "gone.yaml"), ("gone.yaml",), "does not exist"),
]  # fmt: skip


@pytest.fixture
def asked(results, tmp_path, monkeypatch, vibraverse):
    """Run a command in a folder with a mesh, a text and a configuration; return what it says before it ends."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(gpus.VISIBLE, raising=False)
    Path("cube.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    Path("notes.txt").write_text("no mesh")
    Path("mine.yaml").write_text(yaml.safe_dump({"dataset": {"shards": 2}}))
    places = {
        "mesh": "cube.obj", "text": "notes.txt", "config": "mine.yaml",
        "results": results.results, "dataset": f"{results.results}/dataset",
    }  # fmt: skip

    def run(arguments) -> tuple[int, str]:
        status, _, err = vibraverse(*(argument.format(**places) for argument in arguments))
        said = [line for line in err.splitlines() if line.startswith("vibraverse: ")]
        return status, said[-1].removeprefix("vibraverse: ") if said else err

    return run


@pytest.mark.parametrize(
    ("arguments", "wrong", "why"), COMMANDS, ids=lambda one: " ".join(one) if isinstance(one, tuple) else one
)
def test_a_mistake_in_a_command(asked, arguments, wrong, why):
    status, said = asked(arguments)
    assert status == 2, said
    assert not complaints(said, wrong, why), said
    assert not misformed(said, refusal=False), said


# Machines


def test_what_cannot_be_stored(asked):
    """Linux lets nobody, root included, create a file in /sys."""
    if not Path("/sys/kernel").is_dir():
        pytest.skip("this system has no /sys")
    status, said = asked(
        ("sources", "--object", "bar-0000", "--mesh", "/sys/source.ply", "--record", "source.json",
         "--options", json.dumps({"origin": "generated"}).replace("{", "{{").replace("}", "}}"))
    )  # fmt: skip
    assert status == 1
    assert not complaints(said, ("sources", "/sys/source.ply"), "cannot be written"), said
    assert not misformed(said, refusal=False), said


@pytest.mark.parametrize("kind", MACHINES)
def test_what_a_machine_lacks(kind, bin_, tmp_path, monkeypatch):
    provoke, wrong, why = MACHINES[kind]
    with pytest.raises(NotThere) as found:
        provoke(bin_, tmp_path, monkeypatch)
    said = str(found.value)
    assert not complaints(said, wrong, why), said
    assert not misformed(said, refusal=False), said


# The table is complete


def test_every_class_of_message_has_an_example():
    shown = {
        "Refused": REFUSALS,
        "ConfigError": CONFIGURATIONS,
        "NoMeshes": [kind for kind in CONFIGURATIONS if kind == "missing path"],
        "UsageError": COMMANDS,
        "CannotExport": [test_an_export_that_this_environment_cannot_make],
        "NotThere": MACHINES,
        "NoGPU": [kind for kind in MACHINES if "GPU" in kind],
        "NotStored": [test_what_cannot_be_stored],
    }
    assert {said.kind for said in SOURCE} == {kind for kind, examples in shown.items() if examples}
    assert (
        {said.reason for said in SOURCE if said.kind == "Refused" and said.reason}
        <= set(REFUSALS)
        == set(REASONS)
    )
    assert issubclass(ConfigError, UsageError)
    assert not issubclass(NotStored, UsageError)


def test_an_export_that_this_environment_cannot_make(asked, monkeypatch):
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    status, said = asked((*_EXPORT, "-o", "new"))
    assert status == 2
    assert not complaints(said, ("Parquet", "pyarrow"), "this environment lacks"), said
