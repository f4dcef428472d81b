"""Manifests: a table of meshes, one object per row; every mistake in it with line and column."""

from __future__ import annotations

import json
import os
import time

import pytest

from mesh_bytes import make, run_sources
from vibraverse.config import ConfigError
from vibraverse.contract.products import read_json
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import source_argument, source_file
from vibraverse.sources.manifest import COLUMNS, read_manifest
from vibraverse.sources.search import NoMeshes

TABLE = """path,id,size_m,category,licence
Cup 1.obj,,0.09,vessel,CC0-1.0
deep/gong.stl,my_gong,,,
"../out, side/bell.ply",,1.5e-1,instrument,
"""


@pytest.fixture
def folder(tmp_path):
    make(tmp_path, "in/Cup 1.obj", "in/deep/gong.stl", "out, side/bell.ply")
    return tmp_path / "in"


def config(folder, text=TABLE, name="shapes.csv", **entry) -> dict:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    files = [{"path": str(folder / name), **entry}]
    return {
        "sources": {"generated": {"count": 0}, "bundled": [], "files": files},
        "materials": {"steel": None},
    }


def test_a_row_is_an_object(folder):
    plan = Plan(config(folder, size_m=0.3, licence="CC-BY-4.0"))
    assert list(plan.objects) == ["cup-1", "my_gong", "out-side-bell"]
    assert [(e.size_m, e.size_origin) for e in plan.objects.values()] == [
        (0.09, "manifest"), (0.3, "configuration"), (0.15, "manifest"),
    ]  # fmt: skip
    assert [e.options.get("category") for e in plan.objects.values()] == ["vessel", None, "instrument"]
    assert [e.options["licence"] for e in plan.objects.values()] == ["CC0-1.0", "CC-BY-4.0", "CC-BY-4.0"]
    assert all(e.input.is_file() for e in plan.objects.values())
    sized = config(folder)
    sized["sources"]["sizes_m"] = {"cup-1": 2.0}
    entry = Plan(sized).objects["cup-1"]
    assert (entry.size_m, entry.size_origin) == (2.0, "configuration")


def test_size_is_said_to_modes_and_to_nothing_before(folder):
    plan = Plan(config(folder))
    assert "size" not in plan.options("sources", "cup-1")
    said = json.loads(plan.options("modes", "cup-1"))
    assert (said["size_m"], said["size_origin"]) == (0.09, "manifest")


def test_more_rows_change_nothing_of_the_others(folder):
    before = Plan(config(folder))
    make(folder, "new.obj")
    after = Plan(config(folder, TABLE.replace("deep", "new.obj,,7,,\ndeep")))
    assert set(after.objects) - set(before.objects) == {"new"}
    for object_, entry in before.objects.items():
        assert after.objects[object_] == entry
        for stage in ("sources", "clean", "modes"):
            assert after.options(stage, object_) == before.options(stage, object_)


def _with_column(text: str, cells: list) -> str:
    """Return a table with one more column, as ``pandas.to_csv`` puts the index in front."""
    return "".join(f"{cell},{line}\n" for cell, line in zip(cells, text.splitlines(), strict=True))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda text: b"\xef\xbb\xbf" + text.encode(), "a.csv"),
        (lambda text: text.replace("\n", "\r\n"), "a.csv"),
        (
            lambda text: text.replace("../out, side", "../out@ side").replace(",", ";").replace("@", ","),
            "a.CSV",
        ),
        (
            lambda text: text.replace("../out, side", "../out@ side").replace(",", "\t").replace("@", ","),
            "a.tsv",
        ),
        (
            lambda text: text.replace("Cup 1.obj,,0.09", "  Cup 1.obj , , 0.09 ").replace(
                "size_m", " Size_m"
            ),
            "a.csv",
        ),
        (lambda text: text.replace("\n", "\n\n") + ",,,,\n", "a.csv"),
        (lambda text: text.encode("utf-16"), "a.csv"),
        (lambda text: "sep=,\r\n" + text, "a.csv"),
        (lambda text: text.replace("deep/", "deep\\"), "a.csv"),
        (lambda text: text.replace("my_gong,,,", "my_gong,NaN,,NA"), "a.csv"),
        (lambda text: _with_column(text, ["", 0, 1, 2]), "a.csv"),
        (lambda text: _with_column(text, ["Unnamed: 0", 0, 1, 2]), "a.csv"),
        (lambda text: _with_column(_with_column(text, ["uid", *"abc"]), ["mass_kg", 0.1, "", 2]), "a.csv"),
        (lambda text: _with_column(text, ["category_id", 1, 2, 3]), "a.csv"),
    ],
    ids=[
        "BOM", "CRLF", "semicolons", "tabs", "spaces", "empty lines", "UTF-16", "sep=", "backslashes", "NaN",
        "index", "unnamed index", "own columns", "own column with a similar name",
    ],
)  # fmt: skip
def test_tables_as_programs_write_them(folder, change, name):
    expected = Plan(config(folder)).objects
    assert Plan(config(folder, change(TABLE), name)).objects == expected


def test_manifests_of_the_shared_cases(shared_cases, tmp_path):
    for name, ids in (("pandas.csv", ["x1", "x2"]), ("extra.csv", ["x1"])):
        text = (shared_cases / "manifest-pandas-index" / name).read_text()
        make(tmp_path, "a.stl", "b 1.stl")
        (tmp_path / name).write_text(text)
        assert [row.object for row in read_manifest(str(tmp_path / name))] == ids


def test_an_unknown_category_is_one_sentence_where_the_known_ones_are_listed(folder):
    known = ["vessel", "instrument"]
    assert len(Plan(config(folder, categories=known)).objects) == 3
    with pytest.raises(ConfigError) as error:
        Plan(config(folder, TABLE.replace("vessel", "vesel"), categories=known))
    assert (
        "line 2, column category: unknown category 'vesel'; did you mean 'vessel'? (known: vessel, inst"
        in str(error.value)
    )
    assert "\n" not in str(error.value)
    assert len(Plan(config(folder, TABLE.replace("vessel", "vesel"))).objects) == 3
    with pytest.raises(ConfigError, match=r"sources\.files\[0\]\.category: unknown category 'bell'"):
        Plan(config(folder, categories=known, category="bell"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "",
            "is empty; name the column path in its first line, and any of id, size_m, category, licence, then",
        ),
        ("\n , \n", "is empty"),
        ("id,size_m\n", "line 1: the column path is missing; add it (known columns: path, id,"),
        ("path\n", "lists no meshes"),
        ("path,categry\n", "unknown column 'categry'; did you mean 'category'?"),
        ("path,size\n", "unknown column 'size'; did you mean 'size_m'?"),
        ("path,size_mm\n", "unknown column 'size_mm'; did you mean 'size_m'?"),
        ("path,license\n", "line 1, column 2: unknown column 'license'; did you mean 'licence'?"),
        ("path,path\n", "the column path appears twice"),
        ("path,id\n,a\n", "line 2, column path: the cell is empty"),
        ("path\nnone.obj\n", "line 2, column path: none.obj does not exist"),
        ("path\ndeep\\bell.stl\n", "deep/bell.stl does not exist"),
        ("path\ndeep\n", "line 2, column path: deep is not a mesh in a known format; export it as one (3MF,"),
        ("path\ndeep.obj\n", "deep.obj is not a file"),
        ("path\npipe.obj\n", "pipe.obj is not a file"),
        ("path\nc{a}p.obj\n", "holds braces"),
        ("path\nc\0p.obj\n", "cannot be printed"),
        (
            "path,id\nCup 1.obj,Cup 1\n",
            "line 2, column id: 'Cup 1' is not an id of lower-case letters, digits, - and _",
        ),
        ("path,id\nCup 1.obj,-cup\n", "'cup' would be"),
        (f"path,id\nCup 1.obj,{'a' * 81}\n", "is not an id"),
        ("path\nCup 1.obj\nCup 1.obj\n", "line 3, column id: the id 'cup-1' is that of line 2 already"),
        (
            "path,size_m\nCup 1.obj,12 cm\n",
            "line 2, column size_m: '12 cm' is not a positive number of metres",
        ),
        ("path;size_m\nCup 1.obj;0,2\n", "'0,2' is not a positive number of metres; write a decimal point"),
        (
            "path,size_m\nCup 1.obj,200\n",
            "line 2, column size_m: 200 m is more than the 50 m that an object may have; write 0.2 for 200 mm",
        ),
        ("path,size_m\nCup 1.obj,-1\n", "'-1' is not a positive number"),
        ("path,size_m\nCup 1.obj,inf\n", "'inf' is not a positive number"),
        ("path,size_m\nCup, 1.obj,0.1\n", "line 2: 3 cells for 2 columns; put quotes"),
        ('path\n"Cup 1.obj\n', "close the quotation mark"),
        (b"path\nT\xf6pfe.obj\n", "line 2 is not UTF-8"),
    ],
)
def test_every_mistake_is_one_sentence(folder, text, said):
    make(folder, "deep.obj/x.obj")
    os.mkfifo(folder / "pipe.obj")
    with pytest.raises(ConfigError) as error:
        Plan(config(folder, text))
    message = str(error.value)
    assert said in message
    assert message.startswith(f"sources.files[0].path: the manifest {folder}/shapes.csv")
    assert "\n" not in message


def test_several_mistakes_are_listed(folder):
    rows = "".join(f"gone{k}.obj,x{k},zero\n" for k in range(8))
    with pytest.raises(ConfigError) as error:
        Plan(config(folder, "path,id,size_m\n" + rows + "Cup 1.obj,x,1\n"))
    first, *lines = str(error.value).splitlines()
    assert first.endswith("shapes.csv has 16 mistakes:")
    assert lines[:2] == [
        "  line 2, column path: gone0.obj does not exist",
        "  line 2, column size_m: 'zero' is not a positive number of metres",
    ]
    assert lines[-1] == "  and 6 more"


def test_manifests_that_are_not_there(tmp_path):
    for name, said in (("none.csv", "cannot be read"), ("folder.csv", "is not a file")):
        (tmp_path / "folder.csv").mkdir(exist_ok=True)
        with pytest.raises(NoMeshes, match=said):
            read_manifest(str(tmp_path / name))


def test_check_and_objects_read_it(folder, vibraverse):
    import yaml

    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(config(folder)))
    assert vibraverse("config", "check", path)[:2] == (0, f"{path} is valid and names 3 objects.\n")
    lines = vibraverse("objects", "--config", path)[1].splitlines()
    assert lines[1].split()[:4] == ["cup-1", "files", "0.09", "m"]
    (folder / "shapes.csv").write_text("path\nnone.obj\n")
    status, out, said = vibraverse("config", "check", path)
    assert (status, out) == (2, "")
    assert "line 2, column path: none.obj does not exist" in said


def test_category_and_licence_reach_the_record(folder, tmp_path, vibraverse):
    entry = Plan(config(folder)).objects["cup-1"]
    status, _, _ = run_sources(
        vibraverse, tmp_path, "cup-1", json.dumps(entry.options), f"--file={entry.input}"
    )
    assert status == 0
    record = read_json(tmp_path / "source.json")
    assert (record["category"], record["licence"], record["size_origin"]) == ("vessel", "CC0-1.0", None)


def test_fifty_thousand_rows_are_quick(folder):
    rows = "".join(f"Cup 1.obj,id-{k},0.{k + 1},vessel,CC0-1.0\n" for k in range(50_000))
    values = {**config(folder, ",".join(COLUMNS) + "\n" + rows), "dataset": {"shards": 500}}
    started = time.process_time()
    assert len(Plan(values).objects) == 50_000
    assert time.process_time() - started < 6


def test_a_file_that_may_not_be_read_is_no_input_of_the_rule(folder, monkeypatch):
    """Snakemake would stop at it; the stage gets its name and refuses that object."""
    plan = Plan(config(folder))
    argument = f"--file='{folder}/Cup 1.obj'"
    assert source_file(plan, "cup-1") == [f"{folder}/Cup 1.obj"]
    assert source_argument(plan, "cup-1") == argument
    monkeypatch.setattr("os.access", lambda path, mode: False)
    assert source_file(plan, "cup-1") == []
    assert source_argument(plan, "cup-1") == argument


def test_the_table_of_columns_is_in_the_documentation(root):
    text = (root / "docs/own-meshes.md").read_text(encoding="utf-8")
    for name, meaning in COLUMNS.items():
        assert f"| `{name}` | {meaning} |" in text
