"""Objaverse: from the cache without a network, and refusals for what it lacks."""

from __future__ import annotations

import gzip
import json

import pytest
import trimesh

from mesh_bytes import run_sources as run_stage
from vibraverse.contract.errors import Refused
from vibraverse.contract.products import read_json
from vibraverse.contract.refusal import read_refusal
from vibraverse.files.meshes import read_mesh
from vibraverse.sources.objaverse import fetch

UID = "8476c4170df24cf5bbe6967222d1a42d"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A small stand-in for the cache of the objaverse package, and no network."""

    def offline(*_):
        raise OSError("no network in tests")

    monkeypatch.setattr("urllib.request.urlretrieve", offline)
    root = tmp_path / "cache" / "hf-objaverse-v1"
    (root / "metadata").mkdir(parents=True)
    (root / "glbs" / "000-023").mkdir(parents=True)
    paths = {UID: f"glbs/000-023/{UID}.glb", "far": "glbs/000-023/far.glb"}
    annotation = {
        "uri": f"https://api.sketchfab.com/v3/models/{UID}",
        "name": "Tea cup",
        "license": "by",
        "user": {"username": "potter", "displayName": "A Potter"},
        "categories": [{"name": "food-drink"}],
    }
    with gzip.open(root / "object-paths.json.gz", "wt") as file:
        json.dump(paths, file)
    with gzip.open(root / "metadata" / "000-023.json.gz", "wt") as file:
        json.dump({UID: annotation}, file)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    (root / "glbs" / "000-023" / f"{UID}.glb").write_bytes(mesh.export(file_type="glb"))
    return tmp_path / "cache"


def test_objaverse_from_the_cache(cache, tmp_path, vibraverse):
    model = fetch(UID, cache)
    assert (model.title, model.category, model.licence) == ("Tea cup", "food-drink", "CC-BY-4.0")
    assert model.attribution == f"A Potter https://api.sketchfab.com/v3/models/{UID}"

    options = json.dumps({"origin": "objaverse", "uid": UID, "cache": str(cache)})
    status, out, _ = run_stage(vibraverse, tmp_path, f"objaverse-{UID}", options)
    assert (status, out) == (0, "")
    record = read_json(tmp_path / "source.json")
    assert record["licence"] == "CC-BY-4.0"
    assert record["unit_m"] is None
    assert str(cache) not in (tmp_path / "source.json").read_text()
    assert len(read_mesh(tmp_path / "source.mesh", record["format"]).faces) == 80


@pytest.mark.parametrize(("uid", "said"), [("far", "no network"), ("unknown", "no object unknown")])
def test_objaverse_without_network_is_refused(cache, tmp_path, vibraverse, uid, said):
    options = json.dumps({"origin": "objaverse", "uid": uid, "cache": str(cache)})
    status, _, _ = run_stage(vibraverse, tmp_path, f"objaverse-{uid}", options)
    assert status == 0
    refusal = read_refusal(tmp_path / "source.mesh")
    assert refusal.reason == "unavailable"
    assert said in refusal.message
    assert refusal.advice


def test_a_damaged_cache_is_refused(cache):
    (cache / "hf-objaverse-v1" / "object-paths.json.gz").write_bytes(b"\x1f\x8b\x08 cut off")
    with pytest.raises(Refused, match="could not be fetched"):
        fetch(UID, cache)
