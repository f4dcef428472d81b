"""``vibraverse status``: states of objects and jobs, by the products that there are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from vibraverse.commands.status import _refused
from vibraverse.config import parse
from vibraverse.contract.refusal import Refusal
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import sounds, views
from vibraverse.machine import locks
from vibraverse.upkeep import progress

CONFIG = """
sources: {generated: {count: 4, families: [bar]}, bundled: []}
materials: {steel: , wood: }
images: {views: 2, looks: [clay]}
"""
DONE, PARTLY, GONE, MISSING = (f"bar-000{number}" for number in range(4))


@pytest.fixture
def plan(tmp_path, monkeypatch) -> Plan:
    """Four objects: all there, the hollow body refused, all refused, nothing there."""
    monkeypatch.chdir(tmp_path)
    Path("config.yaml").write_text(CONFIG)
    plan = Plan(parse({
        "sources": {"generated": {"count": 4, "families": ["bar"]}, "bundled": []},
        "materials": {"steel": None, "wood": None}, "images": {"views": 2, "looks": ["clay"]},
    }))  # fmt: skip
    for object_id in (DONE, PARTLY, GONE):
        for path in [f"results/objects/{object_id}/source.mesh", *object_products(plan, object_id)]:
            refused = object_id == GONE or (object_id == PARTLY and "/hollow/" in path)
            stage = "clean" if object_id == GONE else "hollow"
            refusal = Refusal(
                object_id, stage, "not_a_solid" if object_id == GONE else "too_thin", "No."
            ).to_text()
            write(path, refusal if refused and "source" not in path else "a product")
        write(f"results/benchmarks/{object_id}/basis.solid.tsv", "s\th:m:s\n30.0\t0:00:30\n")
        write(f"results/benchmarks/{object_id}/audio.solid.tsv", "s\th:m:s\n60.0\t0:01:00\n")
    return plan


def object_products(plan: Plan, object_id: str) -> list[str]:
    """Return every product of one object."""
    paths = plan.paths
    of_object = [paths.source_record, paths.surface, paths.clean_record, paths.grids, paths.coarse]
    of_object += [*views(plan), paths.hollow_surface, paths.hollow_record]
    of_body = [paths.tets, paths.tets_record, paths.basis, paths.modes, *sounds(plan)]
    return [paths.at(pattern, object=object_id) for pattern in of_object] + [
        paths.at(pattern, object=object_id, solidity=solidity)
        for solidity in ("solid", "hollow")
        for pattern in of_body
    ]


def write(path: str, text: str = "") -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def test_objects_and_jobs_are_counted_by_state(plan):
    found = progress.survey(plan, None)
    assert found.objects == {"done": 2, "refused": 1, "missing": 1}
    assert found.in_part == 1
    assert found.jobs["sources"] == {"done": 3, "waiting": 1}
    assert found.jobs["clean"] == {"done": 2, "refused": 1, "waiting": 1}
    assert found.jobs["hollow"] == {"done": 1, "refused": 2, "waiting": 1}
    assert found.jobs["modes"] == {"done": 3, "refused": 3, "waiting": 2}
    assert found.left() == {
        stage: 2 if stage in ("tets", "basis", "modes", "audio") else 1 for stage in found.jobs
    }
    assert {(row["object"], row["stage"], row["reason"]) for row in found.refusals} == {
        (PARTLY, "hollow", "too_thin"), (GONE, "clean", "not_a_solid"),
    }  # fmt: skip


def test_a_job_is_done_when_all_its_products_are_there(plan):
    Path(f"results/objects/{DONE}/solid/sounds/wood.wav").unlink()
    found = progress.survey(plan, None)
    assert found.objects == {"done": 1, "refused": 1, "missing": 1, "begun": 1}
    assert found.jobs["audio"] == {"done": 2, "refused": 3, "waiting": 3}


def test_running_and_stopped_jobs_are_told_by_their_logs(plan):
    for product in ("tets.msh", "basis.h5", "modes.h5", "sounds/audio.json"):
        Path(f"results/objects/{DONE}/solid/{product}").unlink()
    log = f"results/logs/{DONE}/tets.solid.log"
    later = f"results/logs/{DONE}/basis.solid.log"  # of an earlier time: its input is not even there
    write(log, "vibraverse tets\n")
    write(later, "vibraverse basis\n")
    os.utime(log, (1000, 1000))
    stopped = progress.survey(plan, None)
    assert stopped.stopped == [log]
    assert stopped.jobs["tets"]["stopped"] == 1
    assert stopped.jobs["basis"]["stopped"] == 0
    assert progress.survey(plan, 900.0).jobs["tets"]["running"] == 1
    benchmark = f"results/benchmarks/{DONE}/tets.solid.tsv"  # it ended, and its products were deleted
    write(benchmark, "s\th:m:s\n30.0\t0:00:30\n")
    os.utime(benchmark, (1001, 1001))
    ended = progress.survey(plan, None)
    assert (ended.stopped, ended.jobs["tets"]["waiting"]) == ([], 3)
    os.utime(benchmark, (999, 999))  # of the time before
    assert progress.survey(plan, None).stopped == [log]
    waiting = progress.survey(plan, 1100.0)
    assert (waiting.running, waiting.jobs["tets"]["waiting"], waiting.stopped) == (0, 3, [])


def test_time_left_comes_from_the_benchmarks(plan):
    means = progress.mean_seconds(plan)
    assert means == {"basis": 30.0, "audio": 60.0}
    seconds, unknown = progress.seconds_left(progress.survey(plan, None), means)
    assert seconds == 2 * 30 + 2 * 60
    assert unknown == ["clean", "grids", "hollow", "images", "modes", "sources", "tets"]


def begin(plan: Plan, stage: str, ago: float) -> str:
    """Take the products of a stage of the first object's solid body away, and let its log be written some time ago."""
    for product in {"basis": ("basis.h5", "modes.h5", "sounds/audio.json"), "audio": ("sounds/audio.json",)}[
        stage
    ]:
        Path(f"results/objects/{DONE}/solid/{product}").unlink()
    Path(f"results/benchmarks/{DONE}/{stage}.solid.tsv").rename(
        f"results/benchmarks/{PARTLY}/{stage}.hollow.tsv"
    )
    log = f"results/logs/{DONE}/{stage}.solid.log"
    write(log, f"vibraverse {stage}\n")
    os.utime(log, (time.time() - ago,) * 2)
    return log


@pytest.mark.parametrize(("ago", "rest"), [(10, 20), (500, 0)])
def test_what_running_jobs_have_behind_them_is_not_left(plan, ago, rest):
    begin(plan, "basis", ago)
    now = time.time()
    found = progress.survey(plan, now - 1000)
    assert (found.running, found.left()["basis"]) == (1, 3)
    seconds, _ = progress.seconds_left(found, progress.mean_seconds(plan), now)
    assert seconds == pytest.approx(2 * 30 + rest + 3 * 60, abs=1)


def test_jobs_that_run_are_named_with_their_begin(plan, vibraverse, monkeypatch):
    log = begin(plan, "basis", 500)
    for name in ("index", "dataset/00000"):
        write(f"results/logs/{name}.log", "vibraverse\n")
    monkeypatch.setattr(locks, "run_since", lambda _: time.time() - 1000)
    out = vibraverse("status")[1]
    assert (
        "A run works, on 1 job of objects. Left: 4 min for one job at a time; more, because 1 job already"
        in out
    )
    since = time.strftime("%H:%M", time.localtime(os.stat(log).st_mtime))
    lines = out.splitlines()
    place = lines.index("running, the longest first:")
    assert lines[place + 1].endswith(f"{since} (8 min, 30 s on average): {log}")
    assert lines[place + 2].startswith("    index since ")
    for name in (DONE, PARTLY, GONE):
        shutil.rmtree(f"results/benchmarks/{name}")
    assert vibraverse("status")[1].endswith(" No job has ended yet, so the time left is not known.\n")
    write(f"results/benchmarks/{DONE}/dataset.00000.tsv", "s\th:m:s\n3.0\t0:00:03\n")
    assert vibraverse("status")[1].endswith(
        " No job of audio, basis, clean, grids, hollow, images, modes, sources, tets has ended yet, "
        "so the time left is not known.\n"
    )


def test_only_some_of_many_running_jobs_are_named(plan, vibraverse, monkeypatch):
    works = [progress.Work("tets", f"{number}.log", time.time() - number) for number in range(9)]
    found = progress.Survey(works=works)
    monkeypatch.setattr("vibraverse.commands.status.survey", lambda *_: found)
    out = vibraverse("status")[1]
    assert out.count(".log") == 5
    assert ": 8.log\n" in out
    assert "    … and 4 more\n" in out


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not tell")
@pytest.mark.parametrize("slurm_job", [None, "17"])
def test_a_job_that_a_killed_run_left_is_seen(plan, vibraverse, slurm_job):
    log = begin(plan, "basis", 500)
    inside = {**os.environ, "SLURM_JOB_ID": slurm_job} if slurm_job else None
    with (
        open(log, "a") as file,
        subprocess.Popen(["sleep", "20"], stdout=file, stderr=file, env=inside) as job,
    ):
        for started in (None, time.time()):  # no run, or one that has not come to this job
            found = progress.survey(plan, started)
            assert [(work.log, work.orphan) for work in found.works] == [(log, job.pid)]
            assert (found.jobs["basis"]["running"], found.running, found.stopped) == (1, 0, [])
        out = vibraverse("status")[1]
        assert f", process {job.pid} of a run that is gone: {log}\n" in out
        assert (
            "No run works. 1 job of a run that is gone still computes: before the next run wait for its end, or end "
            f"it with `{f'scancel {slurm_job}' if slurm_job else f'kill {job.pid}'}`. Left: "
        ) in out
        job.kill()
    assert progress.survey(plan, None).stopped == [log]


@pytest.mark.parametrize(
    ("survey", "line"),
    [
        ({"objects": {"refused": 3}, "body_by_body": 1}, "3 objects whole (1 of them body by body)"),
        ({"in_part": 2}, "one of the two bodies of 2 objects, which go on with the rest"),
        (
            {"objects": {"refused": 1}, "in_part": 2},
            "1 object whole, and one of the two bodies of 2 others, which go on with the rest",
        ),
    ],
)
def test_refusals_of_bodies_and_objects_add_up(survey, line):
    found = progress.Survey(**{**survey, "objects": Counter(survey.get("objects", {}))})
    assert _refused(found) == f"refused: {line}"


def test_an_object_whose_bodies_are_all_refused_counts_once(plan):
    for path in object_products(plan, PARTLY):
        if "/solid/" in path:
            write(path, Refusal(PARTLY, "tets", "meshing_failed", "No.").to_text())
    found = progress.survey(plan, None)
    assert found.objects == {"done": 1, "refused": 2, "missing": 1}
    assert (found.in_part, found.body_by_body, len(found.refusals)) == (0, 1, 3)


def test_the_command_says_it_all(plan, vibraverse):
    write("results/objects/cup-0000/source.json", "{}")
    status, out, _ = vibraverse("status")
    assert status == 0
    assert out.startswith(
        "4 objects: 2 done, 0 begun, 1 not begun, 1 refused\n"
        "refused: 1 object whole, and one of the two bodies of 1 other, which goes on with the rest\n"
    )
    assert "    refused at clean: not_a_solid, 1 object\n" in out
    assert "    refused at hollow: too_thin, 1 body\n" in out
    assert "    1 more in results/objects, which the configuration does not name\n" in out
    assert "modes             3        3        0        0        2\n" in out
    assert "dataset: 0 of 3 shards, index missing, report missing\n" in out
    assert out.endswith(
        "No run works. Left: 3 min for one job at a time; without clean, grids, hollow, images, modes, sources, tets, "
        "of which none has ended yet.\n"
    )


def test_a_folder_may_be_named_in_any_way(plan, vibraverse, monkeypatch):
    expected = vibraverse("status")[1]
    for name in ("results/", "./results", "./results//", Path("results").resolve()):
        status, out, _ = vibraverse("status", "--results", name)
        assert (status, out.replace(f"{Path.cwd()}/", "")) == (0, expected)
    monkeypatch.chdir("results")
    assert vibraverse("status", "--config", "../config.yaml", "--results", ".")[:2] == (0, expected)


def test_a_run_that_works_is_noticed_by_its_lock(plan, vibraverse):
    assert locks.run_since("results") is None
    program = (
        "from vibraverse.machine.locks import only_run; only_run('results'); print(1, flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as run:
        assert run.stdout.readline()
        assert locks.run_since("results") == pytest.approx(os.stat("results/.run.lock").st_mtime)
        assert "A run works, on 0 jobs of objects." in vibraverse("status")[1]
        run.communicate(b"\n")
    assert locks.run_since("results") is None


def test_a_wrong_configuration_is_one_sentence(plan, vibraverse):
    status, _, errors = vibraverse("status", "--config", "none.yaml")
    assert (status, errors) == (
        2,
        "vibraverse: the configuration file none.yaml does not exist; create it, or name another one\n",
    )
