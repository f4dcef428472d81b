"""Where objects come from: bundled models, the catalogue of a configuration, the stage and ``vibraverse objects``."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from mesh_bytes import TRIANGLE, make
from mesh_bytes import run_sources as run_stage
from vibraverse.config import ConfigError, parse
from vibraverse.contract.errors import Refused
from vibraverse.contract.products import read_json
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.seeds import rng
from vibraverse.files.meshes import read_mesh
from vibraverse.sources.bundled import BUNDLED, locate
from vibraverse.sources.catalogue import catalogue, generated_ids
from vibraverse.sources.families import FAMILIES, GROUPS, generate


@pytest.mark.parametrize(("name", "faces"), [("nut", 1046), ("airplane", 2452), ("ant", 912)])
def test_bundled(name, faces):
    assert len(read_mesh(locate(name)).faces) == faces
    assert BUNDLED[name].licence.startswith("MIT")


def test_bundled_without_the_package(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(Refused, match="pyvista"):
        locate("nut")


def ids(**sources) -> list[str]:
    return list(catalogue(parse({"sources": {"bundled": [], **sources}})))


def test_generated_objects_take_turns_and_keep_their_ids():
    two = {"families": ["bowl", "bell"]}
    assert ids(generated={"count": 3, **two}) == ["bowl-0000", "bell-0000", "bowl-0001"]
    assert ids(generated={"count": 2, "first": 7, **two}) == ["bowl-0007", "bell-0007"]
    assert ids(generated={"count": 2, "families": ["bell", "open-ended", "tree"]}) == [
        "bell-0000",
        "tree-0000",
    ]
    few, many = (ids(generated={"count": n}) for n in (8, 90))
    assert many[:8] == few
    assert len(set(many)) == 90
    assert generated_ids(0, []) == []


def test_objects_of_one_shape_differ_in_their_cavities_alone():
    two = {"count": 2, "families": ["bowl", "bell"], "cavities": 3}
    expected = [f"{shape}{end}" for shape in ("bowl-0000", "bell-0000") for end in ("", "_2", "_3")]
    assert ids(generated=two) == expected
    one, other = generate("bowl-0000"), generate("bowl-0000_3")
    np.testing.assert_array_equal(one.vertices, other.vertices)
    np.testing.assert_array_equal(one.faces, other.faces)
    assert (one.size_m, one.family) == (other.size_m, other.family)
    drawn = [rng(object_, "hollow").uniform(0.3, 0.7) for object_ in expected[:3]]
    assert len(set(drawn)) == 3
    with pytest.raises(Refused):
        generate("bowl-0000_b")


def test_the_words_for_families():
    parametric, everything = (
        ids(generated={"count": n, "families": word}) for n, word in ((31, "parametric"), (37, "all"))
    )
    assert parametric == ids(generated={"count": 31})
    assert parametric[0] == "bowl-0000"
    assert parametric[29:] == ["knot-0000", "bowl-0001"]
    opened = ids(generated={"count": 7, "families": "open-ended"})
    assert everything == parametric[:30] + opened
    assert set(GROUPS["all"]) == set(FAMILIES)


def test_order_and_sizes(tmp_path):
    make(tmp_path, "mug.obj")
    config = {
        "generated": {"count": 1},
        "bundled": ["nut"],
        "files": [{"path": str(tmp_path), "size_m": 0.2, "licence": "CC0-1.0"}],
        "objaverse": {"uids": ["ABC123"], "cache": "~/x"},
        "sizes_m": {"nut": 0.5},
    }
    entries = catalogue(parse({"sources": config}))
    assert list(entries) == ["bowl-0000", "nut", "mug", "objaverse-abc123"]
    assert [entry.size_m for entry in entries.values()] == [None, 0.5, 0.2, None]
    assert entries["mug"].input == tmp_path / "mug.obj"
    assert entries["mug"].options == {"origin": "files", "licence": "CC0-1.0"}
    assert entries["objaverse-abc123"].options["uid"] == "ABC123"


@pytest.mark.parametrize(
    ("sources", "said"),
    [
        ({"generated": {"families": ["bowll"]}}, "did you mean 'bowl'"),
        ({"bundled": ["nutt"]}, "did you mean 'nut'"),
        ({"sizes_m": {"nutt": 0.1}}, "sources.sizes_m: unknown object 'nutt'; did you mean 'nut'"),
        ({"objaverse": {"uids": ["../x"]}}, "not a UID"),
    ],
)
def test_mistakes_are_one_sentence(sources, said):
    with pytest.raises(ConfigError) as error:
        catalogue(parse({"sources": sources}))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_one_id_twice_names_both(tmp_path):
    make(tmp_path, "a/cup.obj", "b/cup.obj", "c/nut.ply")
    folders = [{"path": str(tmp_path / "a")}, {"path": str(tmp_path / "b")}]
    with pytest.raises(ConfigError, match=r"a/cup\.obj and .*b/cup\.obj"):
        ids(files=folders)
    with pytest.raises(ConfigError, match=r"bundled nut and .*c/nut\.ply"):
        ids(bundled=["nut"], files=[{"path": str(tmp_path / "c")}])


def test_the_catalogue_loads_no_numerical_library():
    program = (
        "import sys; from vibraverse.config import Config; from vibraverse.sources.catalogue import catalogue;"
        "catalogue(Config()); import vibraverse.stages.sources; print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_stage_generated(tmp_path, vibraverse):
    assert run_stage(vibraverse, tmp_path, "star-0002")[0] == 0
    record, mesh = read_json(tmp_path / "source.json"), read_mesh(tmp_path / "source.mesh", "ply")
    assert (record["origin"], record["format"], record["unit_m"], record["family"]) == (
        "generated",
        "ply",
        1.0,
        "star",
    )
    assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(record["size_m"], abs=2e-9)
    assert record["parameters"]["points"] in range(5, 9)
    first = (tmp_path / "source.mesh").read_bytes(), (tmp_path / "source.json").read_bytes()
    run_stage(vibraverse, tmp_path, "star-0002")
    assert first == ((tmp_path / "source.mesh").read_bytes(), (tmp_path / "source.json").read_bytes())


def test_stage_bundled(tmp_path, vibraverse):
    assert run_stage(vibraverse, tmp_path, "nut", '{"origin": "bundled"}')[0] == 0
    assert (tmp_path / "source.mesh").read_bytes() == locate("nut").read_bytes()
    assert read_json(tmp_path / "source.json")["size_m"] == 0.12


@pytest.mark.parametrize("content", [TRIANGLE, "", "not a mesh"])
def test_stage_keeps_a_file_as_it_came(tmp_path, vibraverse, content):
    file = tmp_path / "Mein Krug.OBJ"
    file.write_text(content)
    options = '{"origin": "files", "licence": "CC0-1.0"}'
    assert run_stage(vibraverse, tmp_path, "mein-krug", options, "--file", file)[0] == 0
    assert (tmp_path / "source.mesh").read_text() == content
    text = (tmp_path / "source.json").read_text()
    record = json.loads(text)
    assert (record["format"], record["file"], record["licence"]) == ("obj", "Mein Krug.OBJ", "CC0-1.0")
    assert record["provenance"]["input_sha256"]["file"] == hashlib.sha256(content.encode()).hexdigest()
    assert str(tmp_path) not in text


def test_stage_mistakes(tmp_path, vibraverse):
    status, _, said = run_stage(vibraverse, tmp_path, "cup", '{"origin": "file"}')
    assert status == 2
    assert "sources.origin" in said
    assert (
        run_stage(vibraverse, tmp_path, "cup", '{"origin": "files"}', "--file", tmp_path / "gone.obj")[0] == 2
    )
    assert not (tmp_path / "source.mesh").exists()
    for object_, options in (
        ("cup", '{"origin": "files"}'),
        ("cup", '{"origin": "bundled"}'),
        ("cupp-1", "{}"),
    ):
        assert run_stage(vibraverse, tmp_path, object_, options)[0] == 0
        assert read_refusal(tmp_path / "source.json").reason == "unavailable"


def test_objects_command(tmp_path, vibraverse):
    make(tmp_path, "mug.obj")
    config = tmp_path / "config.yaml"
    config.write_text(
        f"sources: {{generated: {{count: 1}}, bundled: [nut], files: [{{path: {tmp_path}}}]}}\n"
    )
    status, out, _ = vibraverse("objects", "--config", config)
    assert status == 0
    lines = [line.split() for line in out.splitlines()]
    assert lines[1][:2] == ["bowl-0000", "generated"]
    assert lines[2] == ["nut", "bundled", "0.12", "m"]
    assert lines[3][-1] == str(tmp_path / "mug.obj")
    status, out, _ = vibraverse("objects", "--families")
    assert status == 0
    assert len(out.splitlines()) == len(FAMILIES)
    config.write_text("sources: {bundled: [nutt]}\n")
    status, out, said = vibraverse("objects", "--config", config)
    assert (status, out) == (2, "")
    assert "did you mean 'nut'" in said


def test_objects_without_a_size_have_the_default(tmp_path, vibraverse):
    make(tmp_path, "a.obj", "b.STL", "c.ply", "d.off", "e.GLB", "f.gltf", "g.3mf")
    config = tmp_path / "config.yaml"
    config.write_text(
        f"sources: {{default_size_m: 0.2, generated: {{count: 0}}, bundled: [], files: [{{path: {tmp_path}}}], "
        "objaverse: {uids: [abc]}}\n"
    )
    lines = vibraverse("objects", "--config", config)[1].splitlines()[1:]
    assert [" ".join(line.split()[2:6]) for line in lines[:4]] == [
        f"0.2 m (default) {tmp_path}/{name}" for name in ("a.obj", "b.STL", "c.ply", "d.off")
    ]
    assert [" ".join(line.split()[2:6]) for line in lines[4:7]] == ["as in the file"] * 3
    # Uploads to Objaverse come in any scale, whatever the format says.
    assert " ".join(lines[7].split()) == "objaverse-abc objaverse 0.2 m (default)"


def test_a_pipe_is_not_waited_for(tmp_path, vibraverse):
    os.mkfifo(tmp_path / "pipe.stl")
    status, _, said = run_stage(
        vibraverse, tmp_path, "cup", '{"origin": "files"}', f"--file={tmp_path}/pipe.stl"
    )
    assert status == 2
    assert "pipe.stl is not a file" in said
    status, _, said = vibraverse("strike", tmp_path / "pipe.stl", "--material", "steel")
    assert status == 2
    assert "is not a file" in said


def test_a_file_that_may_not_be_read_is_refused(tmp_path, vibraverse, monkeypatch):
    make(tmp_path, "cup.obj")

    def forbidden(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("vibraverse.files.opening.open", forbidden, raising=False)
    status, _, _ = run_stage(vibraverse, tmp_path, "cup", '{"origin": "files"}', f"--file={tmp_path}/cup.obj")
    assert status == 0
    refusal = read_refusal(tmp_path / "source.json")
    assert (refusal.reason, refusal.message) == (
        "unreadable",
        "cup.obj cannot be opened (Permission denied).",
    )


def test_a_large_file_is_copied_in_pieces(tmp_path, vibraverse):
    """A stage with a limit of fifty megabytes copies two hundred."""
    import resource

    with open(tmp_path / "large.stl", "wb") as file:
        file.truncate(200_000_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    status, _, _ = run_stage(
        vibraverse, tmp_path, "large", '{"origin": "files"}', f"--file={tmp_path}/large.stl"
    )
    assert status == 0
    assert (tmp_path / "source.mesh").stat().st_size == 200_000_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000
