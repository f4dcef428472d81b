"""Suggested memory, time and group sizes, from synthetic measurements."""

from __future__ import annotations

import json
from dataclasses import asdict

import h5py
import pytest
import yaml

from vibraverse.commands.resources import snippet
from vibraverse.contract import journal
from vibraverse.contract.journal import Ended
from vibraverse.flow.paths import Paths
from vibraverse.upkeep import measured


def note(folder, stage: str, name: str, solidity: str, wall_s, memory_mb, outcome=journal.DONE) -> None:
    """Add the line of a job that ended to the journal."""
    path = folder / f"journal/{name or stage}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as lines:
        one = Ended(stage, name, solidity, outcome, wall_s, wall_s / 2, memory_mb)
        lines.write(json.dumps(asdict(one)) + "\n")


@pytest.fixture
def results(tmp_path):
    """Three jobs of ``tets``, and four of ``basis`` whose memory is 200 MB and 50 MB per 1,000 unknowns."""
    for number, (seconds, memory) in enumerate([(10, 400), (30, 900), (20, 650)]):
        note(tmp_path, "tets", f"o{number}", "solid", seconds, memory)
    for number, size in enumerate([4000, 8000, 12000, 30000]):
        note(tmp_path, "basis", f"o{number}", "hollow", 5 + number, 200 + 50 * size / 1000)
        body = tmp_path / f"objects/o{number}/hollow"
        body.mkdir(parents=True)
        with h5py.File(body / "basis.h5", "w") as h5:
            h5.attrs["n_unknowns"] = size
    (tmp_path / "objects/o9/solid").mkdir(parents=True)
    (tmp_path / "objects/o9/solid/basis.h5").write_text('{"vibraverse_refusal": 1}')
    note(tmp_path, "index", "", "", 0.2, 80)
    return tmp_path


def test_suggestions_follow_the_largest_job(results):
    found = measured.suggest(measured.read(Paths(results)), group_minutes=30)
    assert set(found) == {"tets", "basis", "index"}
    tets = found["tets"]
    assert (tets.jobs, tets.total_s, tets.median_s, tets.most_s) == (3, 60, 20, 30)
    assert (tets.median_mb, tets.most_mb) == (650, 900)
    assert tets.mem_mb == 1500  # 1.5 × 900 + 150
    assert tets.runtime_min == 3  # 3 × 30 s, and a minute
    assert tets.group == 90  # of 20 s each in half an hour
    assert found["basis"].mem_mb == 3000  # 1.5 × 1700 + 150 = 2700
    assert (found["index"].mem_mb, found["index"].group) == (500, 9000)


def test_the_last_end_counts_and_a_failure_does_not(results):
    note(results, "tets", "o1", "solid", 300, 9000, journal.FAILED)
    note(results, "tets", "o0", "solid", 12, 1234)
    (results / "journal/o7.jsonl").write_text("\0\0\0\n{}\n[1]\n")
    found = measured.read(Paths(results))
    assert [job for job in found if job[0] == "tets"] == [
        ("tets", f"o{number}", "solid") for number in range(3)
    ]
    assert measured.suggest(found, 30)["tets"].most_mb == 1234
    assert (found["tets", "o0", "solid"].wall_s, found["tets", "o1", "solid"].memory_mb) == (12, 900)


def test_memory_grows_with_the_unknowns(results):
    paths = Paths(results)
    jobs, sizes = measured.read(paths), measured.unknowns(paths)
    assert sorted(sizes.values()) == [4000, 8000, 12000, 30000]
    pairs = [(size, jobs[job].memory_mb) for job, size in sizes.items()]
    assert measured.growth(pairs) == pytest.approx((200, 50))
    assert measured.growth([(4000, 400.0), (4100, 410.0), (4200, 420.0)]) is None
    assert measured.growth([(4000, 400.0), (40000, 800.0)]) is None


def test_the_command_prints_lines_for_a_profile(results, vibraverse):
    status, out, err = vibraverse("resources", "--results", results)
    assert status == 0, err
    assert "basis: about 200 MB + 50.0 MB per 1,000 unknowns (4 jobs)" in out
    profile = yaml.safe_load(out[out.index("set-resources:") :])
    asked = profile["set-resources"]["tets"]
    assert [eval(asked["mem_mb"], {"attempt": attempt}) for attempt in (1, 2)] == [1500, 3000]
    assert [eval(asked["runtime"], {"attempt": attempt}) for attempt in (1, 2)] == [3, 6]
    assert out.index("tets  ") < out.index("basis  ")  # the costliest first


def test_the_snippet_names_every_rule(results):
    found = measured.suggest(measured.read(Paths(results)), group_minutes=1)
    assert set(yaml.safe_load(snippet(found))["set-resources"]) == set(found)


def test_nothing_measured_is_one_sentence(tmp_path, vibraverse):
    status, _, err = vibraverse("resources", "--results", tmp_path)
    assert (status, len(err.splitlines())) == (2, 1)
    assert "journal holds no job that ended; run the workflow first" in err
    status, _, err = vibraverse("resources", "--results", tmp_path, "--group-minutes", 0)
    assert "--group-minutes must be more than 0" in err
