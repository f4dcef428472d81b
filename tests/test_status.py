"""``vibraverse status``: states of objects and jobs, from the products that exist."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from vibraverse.commands.status import _refused
from vibraverse.config import parse
from vibraverse.contract import journal
from vibraverse.contract.journal import Ended, Mark
from vibraverse.contract.refusal import Refusal
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import sounds, views
from vibraverse.upkeep import progress

CONFIG = """
sources: {generated: {count: 4, families: [bar]}, bundled: []}
materials: {steel: , wood: }
images: {views: 2, looks: [clay]}
"""
DONE, PARTLY, GONE, MISSING = (f"bar-000{number}" for number in range(4))
BEGUN = Path("results/journal/begun")
#: A process that there never is, and a machine.
NOBODY, ELSEWHERE = 2**22 + 1, "node17"


@pytest.fixture
def plan(tmp_path, monkeypatch) -> Plan:
    """Four objects: complete, hollow body refused, refused, without products."""
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
        note("basis", object_id, "solid", 30.0)
        note("audio", object_id, "solid", 60.0)
    return plan


def note(stage: str, object_id: str, solidity: str, wall_s: float, outcome: str = journal.DONE) -> None:
    """Add the line of a job that ended to the journal."""
    file = Path(f"results/journal/{object_id or stage}.jsonl")
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lines:
        one = Ended(stage, object_id, solidity, outcome, wall_s, wall_s, 100.0)
        lines.write(json.dumps(asdict(one)) + "\n")


@pytest.fixture
def mark():
    """Mark a job as working in this process, or as changed; an unused process number stands for a killed job."""
    marks = []

    def begin(stage: str, object_id: str, solidity: str = "", ago: float = 0.0, **changes) -> Mark:
        one = Mark(BEGUN, stage=stage, object=object_id, solidity=solidity)
        marks.append(one)
        changed = replace(one.worker, begun=time.time() - ago, **changes)
        one.file.write_text(json.dumps(asdict(changed)))
        if changed.process == NOBODY:
            one.release()
        return one

    yield begin
    for one in marks:
        one.file.unlink(missing_ok=True)


@pytest.fixture
def run(plan):
    """A run that works: this process."""
    one = Mark(journal.runs_folder("results"))
    yield one
    one.remove()


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
    found = progress.survey(plan)
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
    found = progress.survey(plan)
    assert found.objects == {"done": 1, "refused": 1, "missing": 1, "begun": 1}
    assert found.jobs["audio"] == {"done": 2, "refused": 3, "waiting": 3}


def test_running_and_stopped_jobs_are_told_by_their_marks(plan, mark):
    for product in ("tets.msh", "basis.h5", "modes.h5", "sounds/audio.json"):
        Path(f"results/objects/{DONE}/solid/{product}").unlink()
    log = f"results/logs/{DONE}/tets.solid.log"
    job = mark("tets", DONE, "solid", process=NOBODY)
    mark("basis", DONE, "solid", process=NOBODY)  # of an earlier time: its input is not even there
    mark("basis", PARTLY, "solid", process=NOBODY)  # made since by hand
    stopped = progress.survey(plan)
    assert stopped.stopped == [log]
    assert stopped.jobs["tets"]["stopped"] == 1
    assert stopped.jobs["basis"]["stopped"] == 0
    run = Mark(journal.runs_folder("results"))
    begins_anew = progress.survey(plan)
    assert (begins_anew.jobs["tets"]["waiting"], begins_anew.stopped) == (3, [])
    mark("tets", DONE, "solid", run=run.file.name)
    running = progress.survey(plan)
    assert (running.jobs["tets"]["running"], running.running, running.stopped) == (1, 1, [])
    run.remove()
    job.file.unlink()
    orphaned = progress.survey(plan)
    assert (orphaned.jobs["tets"]["running"], orphaned.running, orphaned.stopped) == (1, 0, [])


def test_time_left_comes_from_the_journal(plan):
    note("basis", DONE, "solid", 99.0, journal.FAILED)
    with open(f"results/journal/{DONE}.jsonl", "a") as lines:
        lines.write('{"stage": "basis", "obj')  # the power failed
    means = progress.mean_seconds(plan)
    assert means == {"basis": 30.0, "audio": 60.0}
    seconds, unknown = progress.seconds_left(progress.survey(plan), means)
    assert seconds == 2 * 30 + 2 * 60
    assert unknown == ["clean", "grids", "hollow", "images", "modes", "sources", "tets"]


def undo(stage: str) -> str:
    """Remove the products of a stage of the first object's solid body; return its log."""
    products = {"basis": ("basis.h5", "modes.h5", "sounds/audio.json"), "audio": ("sounds/audio.json",)}
    for product in products[stage]:
        Path(f"results/objects/{DONE}/solid/{product}").unlink()
    return f"results/logs/{DONE}/{stage}.solid.log"


@pytest.mark.parametrize(("ago", "rest"), [(10, 20), (500, 0)])
def test_the_time_that_running_jobs_have_taken_is_not_left(plan, run, mark, ago, rest):
    undo("basis")
    mark("basis", DONE, "solid", ago, run=run.file.name)
    now = time.time()
    found = progress.survey(plan)
    assert (found.running, found.left()["basis"]) == (1, 3)
    seconds, _ = progress.seconds_left(found, progress.mean_seconds(plan), now)
    assert seconds == pytest.approx(2 * 30 + rest + 3 * 60, abs=1)


def test_jobs_that_run_are_named_with_their_begin(plan, run, mark, vibraverse):
    log = undo("basis")
    begun = mark("basis", DONE, "solid", 500, run=run.file.name, host=ELSEWHERE, locked=False)
    mark("index", "", ago=400, run=run.file.name)
    mark("dataset", "00000", run=run.file.name)
    out = vibraverse("status")[1]
    assert (
        "A run works, on 1 job of objects. Left: 4 min for one job at a time; more, because 1 job already"
        in out
    )
    since = time.strftime("%H:%M", time.localtime(json.loads(begun.file.read_text())["begun"]))
    lines = out.splitlines()
    place = lines.index("running, the longest first:")
    expected = rf".* {since} \(8 min \d+ s, 30 s on average\), on {ELSEWHERE}: {re.escape(log)}"
    assert re.fullmatch(expected, lines[place + 1])
    assert lines[place + 2].startswith("    index since ")
    assert lines[place + 2].endswith(": results/logs/index.log")
    assert lines[place + 3].endswith(": results/logs/00000/dataset.log")
    for name in (DONE, PARTLY, GONE):
        Path(f"results/journal/{name}.jsonl").unlink()
    assert vibraverse("status")[1].endswith(" No job has ended yet, so the time left is not known.\n")
    for product in ("source.mesh", "source.json"):
        write(f"results/objects/{MISSING}/{product}")
    note("sources", DONE, "", 3.0)
    assert vibraverse("status")[1].endswith(
        " No job of audio, basis, clean, grids, hollow, images, modes, tets has ended yet, "
        "so the time left is not known.\n"
    )


def test_only_some_of_many_running_jobs_are_named(plan, run, vibraverse, monkeypatch):
    begun = [replace(run.worker, stage="tets", begun=time.time() - number) for number in range(9)]
    works = [progress.Work(worker, run.file, f"{number}.log") for number, worker in enumerate(begun)]
    found = progress.Survey(works=works)
    monkeypatch.setattr("vibraverse.commands.status.survey", lambda *_: found)
    out = vibraverse("status")[1]
    assert out.count(".log") == 5
    assert ": 8.log\n" in out
    assert "    and 4 more\n" in out


#: A job that works until it is killed.
JOB = """
from pathlib import Path
from vibraverse.contract.journal import Mark
facts = {"run": "gone", "stage": "basis", "object": "bar-0000", "solidity": "solid"}
print(Mark(Path("results/journal/begun"), **facts).file, flush=True)
input()
"""


@pytest.mark.parametrize("slurm_job", ["", "17"])
@pytest.mark.parametrize("other_run", [False, True])
def test_a_job_that_a_killed_run_left_is_seen(plan, vibraverse, slurm_job, other_run):
    log = undo("basis")
    run = Mark(journal.runs_folder("results")) if other_run else None  # one that has not come to this job
    with subprocess.Popen(
        [sys.executable, "-c", JOB],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "SLURM_JOB_ID": slurm_job},
    ) as job:
        assert job.stdout.readline()
        found = progress.survey(plan)
        assert [(work.log, work.worker.process, work.orphaned) for work in found.works] == [
            (log, job.pid, True)
        ]
        assert (found.jobs["basis"]["running"], found.running, found.stopped) == (1, 0, [])
        out = vibraverse("status")[1]
        assert f", process {job.pid} of a run that is gone: {log}\n" in out
        assert (
            f"{'A run works, on 0 jobs of objects.' if run else 'No run works.'} 1 job of a run that is gone "
            "still computes: before the next run wait for its end, or end it with "
            f"`{f'scancel {slurm_job}' if slurm_job else f'kill {job.pid}'}`. Left: "
        ) in out
        job.kill()
    if run:
        run.remove()
    assert progress.survey(plan).stopped == [log]


def test_without_locks_an_orphan_of_another_machine_counts_until_its_file_is_deleted(plan, mark, vibraverse):
    undo("basis")
    job = mark("basis", DONE, "solid", host=ELSEWHERE, process=12, locked=False)
    out = vibraverse("status")[1]
    assert f", process 12 on {ELSEWHERE} of a run that is gone: " in out
    assert (
        f"`kill 12` on {ELSEWHERE}; where it is gone already, `rm {job.file}` (no locks tell of other machines)"
        in out
    )
    job.file.unlink()
    assert "of a run that is gone" not in vibraverse("status")[1]


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
    found = progress.survey(plan)
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
        "No run works. Left: 3 min for one job at a time; not counting clean, grids, hollow, images, modes, sources, "
        "tets, where no job has ended yet.\n"
    )


def test_a_folder_may_be_named_in_any_way(plan, vibraverse, monkeypatch):
    expected = vibraverse("status")[1]
    for name in ("results/", "./results", "./results//", Path("results").resolve()):
        status, out, _ = vibraverse("status", "--results", name)
        assert (status, out.replace(f"{Path.cwd()}/", "")) == (0, expected)
    monkeypatch.chdir("results")
    assert vibraverse("status", "--config", "../config.yaml", "--results", ".")[:2] == (0, expected)


def test_a_run_that_works_is_noticed_by_its_lock(plan, vibraverse):
    assert "No run works." in vibraverse("status")[1]
    program = (
        "from vibraverse.machine.locks import only_run; only_run('results'); print(1, flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as run:
        assert run.stdout.readline()
        assert [worker.process for worker in journal.working_runs("results").values()] == [run.pid]
        assert "A run works, on 0 jobs of objects." in vibraverse("status")[1]
        run.kill()
        run.wait()
        assert "No run works." in vibraverse("status")[1]


def test_a_wrong_configuration_is_one_sentence(plan, vibraverse):
    status, _, errors = vibraverse("status", "--config", "none.yaml")
    assert (status, errors) == (
        2,
        "vibraverse: the configuration file none.yaml does not exist; create it, or name another one\n",
    )
