"""What changes geometry in each format: a file for every row of the table of what is read, and what comes of it."""

from __future__ import annotations

import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import supported_3mf  # noqa: F401
import supported_gltf  # noqa: F401
import supported_texts  # noqa: F401
from supported import MAKERS, volume
from supported_3mf import NOTCHED
from test_fuzz_files import QUICK, check, damaged, damaged_json
from vibraverse.contract.errors import Refused
from vibraverse.files.meshes import read_mesh
from vibraverse.files.opening import as_one_file
from vibraverse.files.support import LEFT_OUT, READ, REFUSED, TABLE, WARNED


def test_every_row_has_its_files():
    assert set(MAKERS) == {(one.formats, one.feature) for one in TABLE}
    assert len(MAKERS) == len(TABLE)
    assert {one.treatment for one in TABLE} == {READ, LEFT_OUT, WARNED, REFUSED}


@pytest.mark.parametrize("one", TABLE, ids=lambda one: f"{one.formats}: {one.feature}")
def test_what_changes_geometry_is_read_or_named(tmp_path, one):
    """A row is read as said: a volume or a check of the mesh, and a note or warning; or a message and its advice."""
    treated = set()
    for number, (name, content, wanted, *more) in enumerate(MAKERS[one.formats, one.feature]()):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        path.write_bytes(content)
        if isinstance(wanted, str):
            with pytest.raises(Refused) as refused:
                read_mesh(path)
            assert wanted in refused.value.message
            assert more[0] in refused.value.advice
            treated.add(REFUSED)
            continue
        mesh = read_mesh(path)
        if callable(wanted):
            assert wanted(mesh), f"{name} {number}"
        else:
            assert volume(mesh) == pytest.approx(wanted, rel=1e-3), f"{name} {number}"
        said = " ".join([*mesh.notes, *mesh.warnings])
        assert (more[0] if more else "") in said
        treated.add(WARNED if mesh.warnings else READ)
        # The packed copy of a glTF, which the workflow keeps, is read the same.
        key, _ = as_one_file(path, tmp_path / str(number) / "source.mesh")
        copy = read_mesh(tmp_path / str(number) / "source.mesh", key)
        assert np.array_equal(copy.vertices, mesh.vertices)
        assert (copy.notes, copy.warnings) == (mesh.notes, mesh.warnings)
    assert (READ if one.treatment == LEFT_OUT else one.treatment) in treated


def test_the_table_is_in_the_documentation(root):
    text = (root / "docs/own-meshes.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (.+?) \| (.+?) \| (read|left out|warning|refused)(?:: (.+?))? \|$", text, re.MULTILINE
    )
    assert rows == [tuple(one) for one in TABLE]


def case(folder: Path, name: str):
    (path,) = (path for path in (folder / name).iterdir() if path.name != "EXPECTED.txt")
    return path


def test_cases_of_bug_reports_are_read_right(shared_cases):
    def extent(mesh) -> float:
        return float(np.ptp(mesh.vertices, axis=0).max())

    for name, long_m in (("gltf-skin-node-transform", 0.3), ("gltf-instancing-optional", 0.42)):
        assert extent(read_mesh(case(shared_cases, name))) == pytest.approx(long_m)
    for name, mm3 in (("3mf-support", 20_000), ("3mf-negative-volume", NOTCHED)):
        mesh = read_mesh(case(shared_cases, name))
        assert volume(mesh) == pytest.approx(mm3)
        assert extent(mesh) == pytest.approx(100)
    assert len(read_mesh(case(shared_cases, "obj-utf16")).faces) == 12


@pytest.mark.parametrize(
    ("name", "said", "advice"),
    [
        ("gltf-1.0", "it is glTF version 1.0, and only version 2 is read", "glTF 2.0"),
        ("gltf-draco", "compressed with KHR_draco_mesh_compression", "without mesh compression"),
        ("gltf-points", "8 points and no triangles", "reconstruct"),
        ("3mf-beam-lattice", "a beam lattice", "mesh of triangles"),
    ],
)
def test_cases_of_bug_reports_are_refused_with_fitting_advice(shared_cases, tmp_path, name, said, advice):
    path = case(shared_cases, name)
    with pytest.raises(Refused) as refused:
        read_mesh(path)
    assert said in refused.value.message
    assert advice in refused.value.advice

    def through_the_workflow():
        key, _ = as_one_file(path, tmp_path / "source.mesh")
        read_mesh(tmp_path / "source.mesh", key, path.name)

    with pytest.raises(Refused, match=re.escape(said)):
        through_the_workflow()


@pytest.fixture(scope="module")
def features() -> list[tuple[str, bytes]]:
    """The format and the content of every file of the table."""
    return [(name.partition(".")[2], content) for maker in MAKERS.values() for name, content, *_ in maker()]


@QUICK
@given(chance=st.randoms(use_true_random=False))
def test_damaged_files_of_every_feature(features, chance):
    format, data = chance.choice(features)
    if format == "gltf" and data[:1] == b"{" and chance.random() < 0.8:
        check(json.dumps(damaged_json(json.loads(data), chance)).encode(), format)
    elif format == "3mf":
        check(_damaged_package(data, chance), format)
    else:
        check(damaged(data, chance), format)


def _damaged_package(data: bytes, chance) -> bytes:
    """Return a package with one thing done to one of its parts."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(buffer, "w") as new:
        hit = chance.choice(old.namelist())
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, damaged(content, chance) if name == hit else content)
    return buffer.getvalue()
