"""Suggested memory, time and group sizes, on measurements that are made up."""

from __future__ import annotations

import h5py
import pytest
import yaml

from vibraverse.commands.resources import snippet
from vibraverse.flow.paths import Paths
from vibraverse.upkeep import measured

HEADER = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"


def note(folder, name: str, seconds, memory) -> None:
    """Write a measurement as Snakemake does."""
    path = folder / "benchmarks" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HEADER + f"{seconds}\t0:00:01\t{memory}\t-\t-\t-\t0\t0\t0\t1\n")


@pytest.fixture
def results(tmp_path):
    """Three jobs of ``tets``, and four of ``basis`` whose memory is 200 MB and 50 MB per 1,000 unknowns."""
    for number, (seconds, memory) in enumerate([(10, 400), (30, 900), (20, "NA")]):
        note(tmp_path, f"o{number}/tets.solid.tsv", seconds, memory)
    for number, size in enumerate([4000, 8000, 12000, 30000]):
        note(tmp_path, f"o{number}/basis.hollow.tsv", 5 + number, 200 + 50 * size / 1000)
        body = tmp_path / f"objects/o{number}/hollow"
        body.mkdir(parents=True)
        with h5py.File(body / "basis.h5", "w") as h5:
            h5.attrs["n_unknowns"] = size
    (tmp_path / "objects/o9/solid").mkdir(parents=True)
    (tmp_path / "objects/o9/solid/basis.h5").write_text('{"vibraverse_refusal": 1}')
    note(tmp_path, "index.tsv", 0.2, "-")
    (tmp_path / "benchmarks/o0/empty.tsv").write_text("")
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


def test_the_larger_of_sample_and_log_counts(results):
    log = results / "logs/o0/tets.solid.log"
    log.parent.mkdir(parents=True)
    for said, most in ((1234, 1234), (17, 900)):  # Snakemake noted 400 of this job and 900 of another
        log.write_text(
            f"vibraverse tets\nwrote x\ntets: done in 9.8 s, 12.5 s of CPU, at most {said} MB\n8 tetrahedra\n"
        )
        assert measured.suggest(measured.read(Paths(results)), 30)["tets"].most_mb == most
    found = measured.read(Paths(results))["tets", "o0/tets.solid.tsv"]
    assert (found.cpu_s, found.memory_mb) == (12.5, 400)
    log.write_text("tets: done in 9.8 s, at most 700 MB\n")  # as earlier versions wrote it
    assert measured.read(Paths(results))["tets", "o0/tets.solid.tsv"].memory_mb == 700


def test_memory_grows_with_the_unknowns(results):
    paths = Paths(results)
    jobs, sizes = measured.read(paths), measured.unknowns(paths)
    assert sorted(sizes.values()) == [4000, 8000, 12000, 30000]
    pairs = [(size, jobs[job].memory_mb) for job, size in sizes.items()]
    assert measured.growth(pairs) == pytest.approx((200, 50))
    assert measured.growth([(4000, 400.0), (4100, 410.0), (4200, 420.0)]) is None
    assert measured.growth([(4000, 400.0), (40000, None), (50000, None)]) is None


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
    assert "holds no measurements; run the workflow first" in err
    status, _, err = vibraverse("resources", "--results", tmp_path, "--group-minutes", 0)
    assert "--group-minutes must be more than 0" in err
