"""The stage ``report``: what its page holds for all kinds of datasets, and that a page is always whole."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import make_products
from vibraverse.contract import journal, products
from vibraverse.geometry.cleaning import cautions as cleaning
from vibraverse.geometry.meshing import cautions as meshing
from vibraverse.physics import cautions as modal
from vibraverse.report import assembly
from vibraverse.stages import report
from vibraverse.stages.report import remove_others, write_assets


def folder_of(page: Path) -> Path:
    """Return the folder of the page's own files."""
    return page.parent / re.search(r'data-page="([^"]+)"', page.read_text(encoding="utf-8"))[1]


def data_of(page: Path) -> dict:
    """Return the index of a page."""
    return said_by(folder_of(page) / "index.js")


def said_by(script: Path) -> dict:
    """Return the argument of the one call that a script makes."""
    text = script.read_text(encoding="ascii")
    return json.loads(text[text.index("(") + 1 : text.rindex(")")])


def rows_of(page: Path) -> dict[str, dict]:
    """Return the rows of a page by object."""
    data = data_of(page)
    return {row[0]: dict(zip(data["columns"], row, strict=True)) for row in data["rows"]}


def copied(page: Path, folder: Path) -> Path:
    """Return a copy of the results of a page without the page."""
    shutil.copytree(page.parents[1], folder / "results")
    page = folder / "results/report/index.html"
    shutil.rmtree(page.parent / "page")
    page.unlink()
    return page


def test_the_page_names_nothing_outside_its_folder(report_page):
    text = report_page.read_text(encoding="utf-8")
    named = re.findall(r'(?:src|href)="([^"#]+)"', text)
    inside = [name for name in named if name.startswith(("page/", "data/"))]
    assert [name for name in named if name not in inside] == ["data:,"]
    assert all((report_page.parent / name).is_file() for name in inside)
    for path in folder_of(report_page).glob("*.[jc]s*"):
        written = path.read_text(encoding="utf-8")
        assert str(report_page.parents[1]) not in written
        assert not re.search(r"https?://(?!www\.w3\.org/(2000/svg|1999/xhtml))\w", written), path
    assert "<title>Things that ring</title>" in text


def test_every_object_has_a_row(report_page):
    rows = rows_of(report_page)
    assert list(rows) == ["ball-0000", "bar-0000", "leaf"]
    wood = make_products.MATERIAL_NAMES.index("wood")
    material = make_products.MATERIALS["wood"]
    for object_id, solidity in (("ball-0000", "solid"), ("bar-0000", "solid"), ("bar-0000", "hollow")):
        expected = make_products.frequencies(object_id, solidity, material)[0]
        assert rows[object_id][solidity][5 + wood] == pytest.approx(expected, rel=5e-4)
    assert rows["ball-0000"]["hollow"] == 0
    assert rows["ball-0000"]["refused"][0][3] == "The wall of ball-0000 would be too thin."
    assert rows["leaf"]["refused"][0][3] == "leaf.obj is flat: it bounds no volume."
    assert [row["thumb"] for row in rows.values()] == [0, 1, -1]
    assert (folder_of(report_page) / "thumbs-0.webp").is_file()


def test_an_object_without_data_of_the_page_is_listed_too(report_page, tmp_path):
    page = copied(report_page, tmp_path)
    (page.parent / "data/objects/bar-0000.json").unlink()
    make_products.report(page.parents[1])
    row = rows_of(page)["bar-0000"]
    assert (row["thumb"], row["version"]) == (-1, "")
    assert row["solid"][0] > 0


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("bar-0000.json", b"{", "bar-0000.json is damaged"),
        ("bar-0000.thumb.webp", None, "bar-0000.thumb.webp does not exist, and its record does"),
        ("bar-0000.thumb.webp", b"RIFF", "bar-0000.thumb.webp is not a picture"),
    ],
)
def test_damaged_data_of_the_page_are_named(report_page, tmp_path, vibraverse, file, content, said):
    page = copied(report_page, tmp_path)
    place = page.parent / "data/objects" / file
    place.unlink()
    if content is not None:
        place.write_bytes(content)
    dataset = page.parents[1] / "dataset"
    inputs = ("--index", dataset / "index.h5", "--record", dataset / "dataset.json")
    status, _, errors = vibraverse("report", *inputs, "--page", page, "--times", tmp_path / "t.js")
    assert status == 2
    assert said in errors
    assert "delete" in errors
    assert not page.exists()


def test_the_page_of_learning_is_linked_where_there_is_one(report_page, tmp_path):
    assert "Learning</a>" not in report_page.read_text(encoding="utf-8")
    page = copied(report_page, tmp_path)
    (page.parents[1] / "learn").mkdir()
    (page.parents[1] / "learn/index.html").write_text("anything")
    make_products.report(page.parents[1])
    assert '<a href="../learn/index.html">Learning</a>' in page.read_text(encoding="utf-8")


def test_an_empty_split_is_said(report_page):
    assert re.match(
        r"The splits? [a-z ]+ holds? no object: take more objects", data_of(report_page)["empty_splits"]
    )


def test_same_dataset_same_bytes(report_page, tmp_path):
    page = copied(report_page, tmp_path)
    make_products.report(page.parents[1], title="Things that ring")
    assert page.read_bytes() == report_page.read_bytes()
    assert {path.name: path.read_bytes() for path in folder_of(page).iterdir()} == {
        path.name: path.read_bytes() for path in folder_of(report_page).iterdir()
    }


def test_sampled_sounds_are_counted_apart(report_page, tmp_path):
    page = copied(report_page, tmp_path)
    shards = sorted((page.parents[1] / "dataset/shards").glob("*.h5"))
    with h5py.File(shards[1], "r+") as h5:
        sounds = h5["objects/bar-0000/solid/sounds"]
        for number in range(2):
            sounds.copy("steel", f"sampled-000{number}")
    make_products.index(page.parents[1], shards)
    counts = data_of(make_products.report(page.parents[1]))["counts"]
    assert (counts["sounds"], counts["sampled_sounds"]) == (14, 2)


def test_times_come_from_the_journal(report_page, tmp_path):
    page = copied(report_page, tmp_path)
    make_products.report(page.parents[1])
    before = page.read_bytes()
    folder = page.parents[1] / "journal"
    folder.mkdir()
    lines = [
        ("basis", "solid", journal.DONE, 12.0),
        ("basis", "hollow", journal.DONE, 4.0),
        ("tets", "solid", journal.DONE, 6.0),
        ("modes", "hollow", journal.PASSED_ON, 99.0),
        ("clean", "", journal.FAILED, 99.0),
    ]
    text = [
        {"stage": stage, "object": "bar-0000", "solidity": solidity, "outcome": outcome, "wall_s": 1.0, "cpu_s": cpu_s,
         "memory_mb": 1.0}
        for stage, solidity, outcome, cpu_s in lines
    ]  # fmt: skip
    (folder / "bar-0000.jsonl").write_text("\n".join(map(json.dumps, text)))
    (folder / "stranger.jsonl").write_text(json.dumps({**text[0], "object": "stranger"}))
    make_products.report(page.parents[1])
    assert page.read_bytes() == before  # times change, the page does not
    script = page.parent / "data/times.js"
    assert said_by(script) == {
        "stages": {"tets": [1, 6.0, 6.0], "basis": [1, 16.0, 16.0]},
        "objects": {"bar-0000": [22.0, "basis"]},
    }
    published = data_of(make_products.report(page.parents[1], kind="dataset"))
    assert said_by(script) == {"stages": {}, "objects": {}}
    assert published["publication"]["licences"] == ["CC0-1.0"]


def test_warnings_are_counted_in_the_dataset(tmp_path, vibraverse):
    paths = make_products.make(tmp_path)
    clean = Path(paths.at(paths.clean_record, object="ball-0000"))
    products.write_json(
        clean, {**products.read_json(clean), "deviation": {"invented": 0.05}, "repairs": ["wrapped"]}
    )
    record = Path(paths.at(paths.tets_record, object="bar-0000", solidity="hollow"))
    too_many, made = meshing.cautions(50_000, 5000), products.read_json(record)
    made["quality"] |= {"wrap": {"radius": 0.01}, "accuracy": {"volume_change": 0.02}}
    products.write_json(record, {**made, "warnings": too_many * 25})
    with h5py.File(paths.at(paths.modes, object="ball-0000", solidity="solid"), "r+") as h5:
        h5["materials/wood/discretisation_error"][3] = 0.031
    make_products.index(tmp_path, make_products.pack(tmp_path))
    stated = products.read_json(paths.dataset_record)["warnings_by_kind"]
    assert stated == {"changed_shape": 2, "inaccurate_modes": 1, "many_elements": 25}
    status, out, _ = vibraverse("refusals", "--record", paths.dataset_record)
    assert status == 0
    assert (
        "Warnings: changed shape (2), inaccurate modes (1), many elements (25); the report lists them." in out
    )


def test_common_findings_are_no_warnings():
    """The thresholds lie where the numbers of the default run part (docs/tets.md)."""
    assert not meshing.cautions(21_511, 5000)
    assert meshing.cautions(40_001, 5000)[0].startswith(
        "40001 tetrahedra, 8.0 times tets.target_elements (at most 8)"
    )
    assert not modal.cautions([np.array([0.001, 0.0192])])
    assert (
        "reaches 2.9 % in mode 2 (at most 2 %; above in 1 of 2"
        in modal.cautions([np.array([0.01, 0.005]), [0, 0.0293]])[0]
    )
    record = {"deviation": {"invented": 0.019}, "dropped": {"volume_share": 0.009}, "repairs": ["wrapped"]}
    assert not cleaning.cautions(record)
    (said,) = cleaning.cautions({**record, "dropped": {"volume_share": 0.127}})
    assert said.startswith("12.7 % of the volume is left out (at most 1 %)")


def test_a_dataset_of_refusals_alone_has_a_page(tmp_path):
    make_products.make(tmp_path, objects=("leaf",))
    make_products.index(tmp_path, make_products.pack(tmp_path, groups=(("leaf",),)))
    page = make_products.report(tmp_path)
    assert list(rows_of(page)) == ["leaf"]
    assert data_of(page)["counts"]["objects"] == 0


def test_a_file_that_is_no_index_is_named(report_page, tmp_path, vibraverse):
    (tmp_path / "index.h5").write_text("no")
    record = report_page.parents[1] / "dataset/dataset.json"
    status, _, errors = vibraverse(
        "report",
        "--index",
        tmp_path / "index.h5",
        "--record",
        record,
        "--page",
        tmp_path / "p",
        "--times",
        tmp_path / "t",
    )
    assert status == 2
    assert "index.h5 is not the index.h5 of a dataset" in errors


def test_a_title_cannot_break_the_page():
    text = assembly.html("</title><script>alert(1)</script>", "run", "page/x", [])
    assert "<script>alert" not in text
    assert text.count("</title>") == 1


def test_texts_stand_out_from_their_ground():
    """Contrast after WCAG 2.1, at least 4.5, in both themes."""

    def luminance(colour: str) -> float:
        shares = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
        linear = [one / 12.92 if one <= 0.03928 else ((one + 0.055) / 1.055) ** 2.4 for one in shares]
        return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))

    themes = re.findall(r":root[^{]*\{([^}]*)\}", assembly.shell.text("style.css"))
    assert len(themes) == 2
    for theme in themes:
        colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", theme))
        for ink in ("ink", "soft", "solid", "hollow", "warn"):
            for ground in ("paper", "sheet", "tint"):
                low, high = sorted((luminance(colours[ink]), luminance(colours[ground])))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, ground, colours)


def test_assets_of_another_page_stay_until_they_are_removed(tmp_path):
    first = write_assets(tmp_path, {"a/b.txt": b"1"})
    (tmp_path / ".1.partial").mkdir()
    second = write_assets(tmp_path, {"a/b.txt": b"2"})
    assert (tmp_path / first / "a/b.txt").read_bytes() == b"1"
    assert (tmp_path / second / "a/b.txt").read_bytes() == b"2"
    remove_others(tmp_path, second)
    assert [path.name for path in tmp_path.iterdir()] == [second]


def test_assets_that_are_there_are_kept_and_mended(tmp_path):
    first = write_assets(tmp_path, {"a/b.txt": b"1"})
    before = (tmp_path / first).stat().st_ino
    assert write_assets(tmp_path, {"a/b.txt": b"1"}) == first
    assert (tmp_path / first).stat().st_ino == before
    (tmp_path / first / "a/b.txt").write_bytes(b"")
    assert write_assets(tmp_path, {"a/b.txt": b"1"}) == first
    assert (tmp_path / first / "a/b.txt").read_bytes() == b"1"


def whole_page(page: Path) -> str:
    """Return a page's text, all of whose files are there."""
    text = page.read_text(encoding="utf-8")
    named = re.findall(r'(?:src|href)="(page/[^"]+)"', text)
    assert named
    assert all((page.parent / name).is_file() for name in named)
    assert (folder_of(page) / "index.js").is_file()
    return text


def test_a_page_is_whole_whenever_the_next_one_is_killed(report_page, tmp_path, monkeypatch):
    page = copied(report_page, tmp_path)
    results, own = page.parents[1], page.parent / "page"
    (page.parent / "assets/0123").mkdir(parents=True)  # as earlier versions had it
    make_products.report(results)
    assert not (page.parent / "assets").exists()
    before, folders = whole_page(page), set(own.iterdir())

    def kill(*_):
        raise KeyboardInterrupt

    def publish(partial: Path, final: Path, really=products.publish):
        kill() if final == page else really(partial, final)

    for where, name, instead in ((assembly, "html", kill), (products, "publish", publish)):
        with monkeypatch.context() as patched:
            patched.setattr(where, name, instead)
            with pytest.raises(AssertionError):  # exit status 130
                make_products.report(results, title="Another")
        assert whole_page(page) == before
    with monkeypatch.context() as patched:
        patched.setattr(report, "remove_others", kill)
        with pytest.raises(AssertionError):
            make_products.report(results, title="Another")
    after = whole_page(page)
    assert after != before
    assert folders < set(own.iterdir())
    make_products.report(results, title="Another")
    assert whole_page(page) == after
    assert len(list(own.iterdir())) == 1
