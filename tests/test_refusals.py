"""``vibraverse refusals``: listing by reason, retries, and the limit on the share."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import make_products
import vibraverse.dataset
from vibraverse.contract import products
from vibraverse.contract.refusal import read_refusal


@pytest.fixture
def results(tmp_path) -> Path:
    # The listing looks at refusals and at what exists, so most products may be absent.
    for object_id in ("bar-0000", "cup-0000"):
        path = tmp_path / "objects" / object_id / "source.json"
        path.parent.mkdir(parents=True)
        path.write_text("{}")
    make_products.make(tmp_path, objects=("leaf",))
    make_products.refuse(
        make_products.Paths(tmp_path), "ball-0000", "hollow", "too_thin", "The wall is too thin."
    )
    return tmp_path


def refused_files(results: Path) -> set[str]:
    return {str(path.relative_to(results)) for path in results.rglob("*") if read_refusal(path)}


def test_listing_by_reason(results, vibraverse):
    status, out, _ = vibraverse("refusals", "--results", results)
    assert status == 0
    assert out.startswith("1 of 4 objects refused, 1 more in part.")
    assert "not_a_solid (1): the shape bounds no volume" in out
    assert "leaf, at clean: leaf.obj is flat: it bounds no volume.\n      Use a closed mesh" in out
    assert "ball-0000 (hollow), at hollow: The wall is too thin." in out


def test_a_run_is_known_by_its_configuration(results, vibraverse, monkeypatch):
    monkeypatch.chdir(results)
    Path("mine.yaml").write_text(f"results: {results}\n")
    assert vibraverse("refusals", "--config", "mine.yaml")[1].startswith("1 of 4 objects refused")
    Path("mine.yaml").rename("config.yaml")
    assert vibraverse("refusals")[1].startswith("1 of 4 objects refused")
    status, _, errors = vibraverse("refusals", "--config", "yours.yaml")
    assert (status, errors) == (
        2, "vibraverse: the configuration file yours.yaml does not exist; create it, or name another one\n",
    )  # fmt: skip


def test_only_configured_bodies_count(results, vibraverse, monkeypatch):
    monkeypatch.chdir(results)
    Path("config.yaml").write_text(f"results: {results}\nsolidities: [hollow]\n")
    assert vibraverse("refusals")[1].startswith("2 of 4 objects refused, 0 more in part.")
    assert vibraverse("refusals", "--solidities", "solid")[1].startswith("1 of 4 objects refused")
    Path("config.yaml").unlink()
    assert vibraverse("refusals", "--results", ".")[1].startswith("1 of 4 objects refused, 1 more in part.")


def test_nothing_refused(results, vibraverse):
    _, out, _ = vibraverse("refusals", "--results", results, "--objects", "bar-0000", "cup-0000")
    assert out == "0 of 2 objects refused, 0 more in part.\n"


def test_a_body_counts_when_it_is_the_only_one(results, vibraverse):
    _, out, _ = vibraverse("refusals", "--results", results, "--solidities", "hollow")
    assert out.startswith("2 of 4 objects refused, 0 more in part.")


@pytest.mark.parametrize(("limit", "expected"), [("0.25", 0), ("0.2", 1), ("1", 0), ("0", 1)])
def test_check(results, vibraverse, limit, expected):
    status, out, _ = vibraverse("refusals", "--results", results, "--check", limit)
    assert status == expected
    assert ("Too much is refused: 1 of 4 objects (25%)" in out) == bool(expected)


def test_a_finished_dataset_s_own_count(tmp_path, vibraverse):
    paths = make_products.build(tmp_path)
    (tmp_path / "objects/left-over-0000").mkdir()  # an object of an earlier configuration does not count
    verdict = tmp_path / "verdict.json"
    arguments = ("refusals", "--record", paths.dataset_record, "--verdict", verdict, "--check")
    vibraverse()  # forget what the stages said
    status, out, _ = vibraverse(*arguments, "0.4")
    assert status == 0
    assert out.startswith("1 of 3 objects refused, 1 more in part.")
    assert "ball-0000 (hollow), at hollow: The wall of ball-0000 would be too thin." in out
    assert products.read_json(verdict) == {
        "accepted": True,
        "objects": 3,
        "refused_objects": 1,
        "refused_share": 1 / 3,
        "max_refused_share": 0.4,
        "refusals_by_reason": {"not_a_solid": 1, "too_thin": 1},
    }
    status, out, _ = vibraverse(*arguments, "0.3")
    assert status == 1
    assert out.endswith(
        "Too much is refused: 1 of 3 objects (33%), and at most 30% is accepted (dataset.max_refused_share).\n"
    )
    assert products.read_json(verdict)["accepted"] is False
    assert vibraverse("refusals", "--record", tmp_path / "none.json")[0] == 2
    assert vibraverse("refusals", "--record", paths.dataset_record, "--retry")[0] == 2


def test_a_reader_says_where_and_why(tmp_path):
    make_products.build(tmp_path)
    body = (
        r"^.the hollow body of 'ball-0000' was refused at hollow \(too_thin\): The wall of ball-0000 would be"
    )
    whole = r"^.the object 'leaf' was refused at clean \(not_a_solid\): leaf.obj is flat"
    with vibraverse.dataset.open(tmp_path / "dataset") as reader:
        for material in ("steel", "sampled-0000"):
            with pytest.raises(KeyError, match=body):
                reader.read("frequencies_hz", "ball-0000", "hollow", material)
        for field in ("frequencies_hz", "occupancy"):
            with pytest.raises(KeyError, match=whole):
                reader.read(field, "leaf", "solid", "steel")
        with pytest.raises(KeyError, match=r"unknown look 'tin' \(known: ceramic, clay, glass, steel, wood"):
            reader.read("views", "ball-0000", "hollow", look="tin")


def test_retry_all_deletes_refused_products_and_nothing_else(results, vibraverse):
    before = {path for path in results.rglob("*") if path.is_file()}
    refused = refused_files(results)
    assert "objects/leaf/solid/modes.h5" in refused
    status, out, _ = vibraverse("refusals", "--results", results, "--retry")
    assert status == 0
    assert out == f"Deleted {len(refused)} refused products of 2 objects; the next run makes them again.\n"
    assert refused_files(results) == set()
    after = {path for path in results.rglob("*") if path.is_file()}
    assert {str(path.relative_to(results)) for path in before - after} == refused
    assert vibraverse("refusals", "--results", results, "--retry")[1] == "Nothing to retry.\n"


@pytest.mark.parametrize("name", ["too_thin", "ball-0000"])
def test_retry_some(results, vibraverse, name):
    vibraverse("refusals", "--results", results, "--retry", name)
    left = refused_files(results)
    assert left
    assert all(path.startswith("objects/leaf/") for path in left)


def test_a_retry_begins_with_the_last_products(tmp_path, vibraverse, monkeypatch):
    """Stopped anywhere, it leaves a run that makes the refused products again, or refusals to retry."""
    paths = make_products.build(tmp_path)
    products.write_text(paths.report, "")
    deleted = []
    monkeypatch.setattr(Path, "unlink", lambda path, missing_ok=False: deleted.append(str(path)))
    assert vibraverse("refusals", "--results", tmp_path, "--retry", "leaf")[0] == 0
    deleted = [name for name in deleted if "/journal/" not in name]
    kinds = [name.removeprefix(f"{tmp_path}/").partition("/")[0] for name in deleted]
    assert kinds == sorted(kinds, key=["report", "dataset", "objects"].index)
    last = deleted[kinds.index("objects") - 1]
    assert last == paths.at(paths.shard, shard="0")
    assert str(paths.at(paths.shard, shard="1")) not in deleted


def test_a_retry_is_refused_while_a_run_works(results, vibraverse):
    program = (
        "from vibraverse.machine.locks import only_run; "
        f"only_run({str(results)!r}); print(1, flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as run:
        assert run.stdout.readline()
        status, _, errors = vibraverse("refusals", "--results", results, "--retry")
        run.communicate(b"\n")
    assert status == 1
    assert "is working in" in errors
    assert refused_files(results)


def test_mistakes_are_one_sentence(results, vibraverse):
    for arguments, words in (
        (("--retry", "to_thin"), "unknown reason or object 'to_thin'; did you mean 'too_thin'?"),
        (("--objects", "leaff"), "unknown object 'leaff'; did you mean 'leaf'?"),
        (("--check", "1.5"), "a share lies between 0 and 1, not '1.5'"),
    ):
        status, out, errors = vibraverse("refusals", "--results", results, *arguments)
        assert status == 2
        assert words in errors
        assert out == ""
    assert refused_files(results)
    status, _, errors = vibraverse("refusals", "--results", results / "nowhere")
    assert status == 2
    assert "holds no objects" in errors
