"""The journal of jobs: what each leaves, however it ends and however many write at once."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vibraverse.contract import journal
from vibraverse.contract.journal import Mark
from vibraverse.machine import locks

COMMANDS = Path(sys.executable).parent
#: A process that there never is.
NOBODY = 2**22 + 1


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run in ``results``: this process."""
    monkeypatch.chdir(tmp_path)
    with locks.only_run("results") as hold:
        monkeypatch.setenv(journal.RUN, str(hold.file))
        yield hold


def sources(*more: str) -> subprocess.CompletedProcess:
    command = [
        str(COMMANDS / "vibraverse"), "sources", "--object", "bar-0000", "--mesh", "source.mesh",
        "--record", "source.json", *more,
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True)


def clean(mesh: str) -> subprocess.CompletedProcess:
    command = [
        str(COMMANDS / "vibraverse"), "clean", "--object", "bar-0000", "--mesh", mesh,
        "--source-record", "source.json", "--surface", "surface.ply", "--record", "clean.json",
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True)


def lines(name: str = "bar-0000") -> list[dict]:
    return [json.loads(line) for line in Path(f"results/journal/{name}.jsonl").read_text().splitlines()]


def test_a_job_by_hand_writes_no_journal(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(journal.RUN, raising=False)
    assert sources().returncode == 0
    assert sorted(os.listdir()) == ["source.json", "source.mesh"]


def test_every_end_is_a_line(run):
    large = bytearray(b"x") * 700_000_000  # the memory of the starting process is not the job's
    before = time.time()
    assert sources().returncode == 0
    del large
    Path("empty.mesh").write_bytes(b"")
    assert clean("empty.mesh").returncode == 0
    Path("refused.mesh").write_bytes(Path("surface.ply").read_bytes())
    assert clean("refused.mesh").returncode == 0
    assert clean("nowhere.mesh").returncode == 2
    found = lines()
    assert [(line["stage"], line["outcome"]) for line in found] == [
        ("sources", "done"), ("clean", "refused"), ("clean", "passed on"), ("clean", "failed"),
    ]  # fmt: skip
    first = found[0]
    assert (first["object"], first["solidity"], first["host"]) == ("bar-0000", "", os.uname().nodename)
    assert first["run"] == run.file.name
    assert before - 0.1 < first["begun"] < first["ended"] < time.time()
    assert first["wall_s"] == pytest.approx(first["ended"] - first["begun"], abs=0.05)
    assert 0.05 < first["cpu_s"] < 60
    assert 20 < first["memory_mb"] < 600
    ((_, failed),) = journal.begun("results")
    assert failed.job == ("clean", "bar-0000", "")
    assert {job: one.outcome for job, one in journal.ended("results", "bar-0000").items()} == {
        ("sources", "bar-0000", ""): "done", ("clean", "bar-0000", ""): "passed on",
    }  # fmt: skip


#: Ends as many jobs of one object as it is told.
MANY = """
import sys
from vibraverse.contract import journal
for number in range(int(sys.argv[1])):
    mark = journal.begin("tets", "bar-0000", f"{sys.argv[2]}-{number}" + "x" * 200)
    journal.end(mark, journal.DONE, 1.0, 100)
"""


def test_many_jobs_at_once_lose_no_line(run):
    writers = [subprocess.Popen([sys.executable, "-c", MANY, "100", str(number)]) for number in range(6)]
    assert [writer.wait() for writer in writers] == [0] * 6
    assert len(lines()) == 600
    assert len({line["solidity"] for line in lines()}) == 600
    assert list(journal.begun("results")) == []


#: A job that works until it is told to end, or is killed.
WORKING = """
from vibraverse.contract import journal
mark = journal.begin("tets", "bar-0000", "solid")
print(mark.file, flush=True)
input()
journal.end(mark, journal.DONE, 1.0, 100)
"""


@pytest.fixture
def job(run):
    process = subprocess.Popen(
        [sys.executable, "-c", WORKING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline()
    yield process
    process.kill()
    process.communicate()


def test_a_killed_job_leaves_its_begin_and_no_lock(run, job):
    ((file, worker),) = journal.begun("results")
    assert (worker.job, worker.process, worker.locked) == (("tets", "bar-0000", "solid"), job.pid, True)
    assert worker.run in journal.working_runs("results")
    assert journal.works(file, worker)
    os.kill(job.pid, signal.SIGKILL)
    job.wait()
    assert list(journal.begun("results")) == [(file, worker)]
    assert not journal.works(file, worker)
    assert journal.names("results") == set()


def test_a_lock_is_believed_and_not_the_number_of_a_process(run, job):
    """Another process may have that number, on this machine or another."""
    ((file, worker),) = journal.begun("results")
    job.kill()
    job.wait()
    text = file.read_text().replace(f'"process": {job.pid}', f'"process": {os.getppid()}')
    file.write_text(text)
    ((file, worker),) = journal.begun("results")
    assert (worker.process, journal.works(file, worker)) == (os.getppid(), False)


def test_an_orphan_is_waited_for_and_what_the_dead_left_is_cleared(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with locks.only_run("results") as killed:
        monkeypatch.setenv(journal.RUN, str(killed.file))
    process = subprocess.Popen(
        [sys.executable, "-c", WORKING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline()
    dead = Mark(Path("results/journal/begun"), stage="basis", object="bar-0000", run="gone")
    dead.file.write_text(dead.file.read_text().replace(f'"process": {os.getpid()}', f'"process": {NOBODY}'))
    dead.release()
    with locks.only_run("results"):
        assert locks.orphans("results", ["bar-0001"]) == []
        assert dead.file.exists()
        ((file, worker),) = left = locks.orphans("results", ["bar-0000"])
        assert worker.process == process.pid
        assert not dead.file.exists()
        process.stdin.write("\n")
        process.stdin.flush()
        locks.wait_for(left)
        assert not file.exists()
    process.communicate()
    said = capsys.readouterr().err
    assert f"tets of bar-0000 is still computed by process {process.pid}, whose run was killed" in said
    assert f"To end it: `kill {process.pid}`" in said
    assert len(lines()) == 1


# A file system without locks


@pytest.fixture(params=[errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def without_locks(request, tmp_path, monkeypatch):
    """Let locking fail in this process; return the system's message."""
    monkeypatch.chdir(tmp_path)

    def refuse(*_):
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr(fcntl, "lockf", refuse)
    monkeypatch.setattr(fcntl, "fcntl", refuse)
    return os.strerror(request.param)


def other(shards: list[int] | None, host: str, process: int) -> Path:
    """Let another run have marked its shards, without a lock; return its file."""
    mark = Mark(journal.runs_folder("results"), shards=shards)
    facts = {**json.loads(mark.file.read_text()), "host": host, "process": process}
    mark.file.write_text(json.dumps(facts))
    mark.release()
    return mark.file


HERE = os.uname().nodename


@pytest.mark.parametrize(
    ("held", "asked", "refused"),
    [([0, 2], [1, 3], False), ([0, 2], [2, 4], True), ([0, 2], None, True), (None, [3], True)],
)
def test_without_locks_runs_exclude_each_other_by_files(without_locks, capsys, held, asked, refused):
    file = other(held, HERE, os.getppid())
    if refused:
        with pytest.raises(SystemExit) as end:
            locks.only_run("results", asked)
        assert end.value.code == 1
        said = capsys.readouterr().err
        assert f"another run (process {os.getppid()}) is working in results" in said
        assert (
            f"This file system has no locks ({without_locks}): if that run is gone already, delete {file}"
            in said
        )
        assert os.listdir("results/journal/runs") == [file.name]
        return
    with locks.only_run("results", asked) as hold:
        assert set(journal.working_runs("results")) == {file.name, hold.file.name}
    assert f"results is on a file system without locks ({without_locks})" in capsys.readouterr().err
    assert os.listdir("results/journal/runs") == [file.name]


def test_without_locks_a_run_of_this_machine_that_is_gone_is_no_hindrance(without_locks):
    file = other(None, HERE, NOBODY)
    with locks.only_run("results"):
        locks.orphans("results")
        assert not file.exists()


def test_without_locks_a_run_of_another_machine_is_asked_about(without_locks, capsys):
    file = other(None, "node17", NOBODY)
    with pytest.raises(SystemExit):
        locks.only_run("results")
    said = capsys.readouterr().err
    assert f"another run (process {NOBODY} on node17) is working in results" in said
    assert f"delete {file}" in said
    file.unlink()
    locks.only_run("results").close()


def test_without_locks_a_job_is_told_by_its_process(without_locks):
    mark = Mark(Path("results/journal/begun"), stage="tets", object="bar-0000")
    worker = mark.worker
    assert not worker.locked
    for host, process, works in ((HERE, os.getppid(), True), (HERE, NOBODY, False), ("node17", NOBODY, True)):
        mark.file.write_text(json.dumps({**worker.__dict__, "host": host, "process": process}))
        ((file, found),) = journal.begun("results")
        assert journal.works(file, found) == works
    mark.remove()


def test_a_process_that_reads_its_own_file_keeps_its_lock(run):
    program = (
        "from vibraverse.contract import journal;"
        "print(*[one.process for one in journal.working_runs('results').values()])"
    )
    for _ in range(2):
        assert [*journal.working_runs("results")] == [run.file.name]
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout == f"{os.getpid()}\n"


def test_a_run_takes_its_file_away_when_its_process_ends(tmp_path):
    program = "from vibraverse.machine.locks import only_run; only_run('results')"
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    assert os.listdir(tmp_path / "results/journal/runs") == []
