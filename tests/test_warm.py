"""Jobs forked from a warm process: products, logs, exit statuses and limits of jobs that start by themselves."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

import shapes
from vibraverse.contract import journal
from vibraverse.files.meshes import write_ply
from vibraverse.machine import locks, warm
from vibraverse.machine.threads import asked_threads

COMMANDS = Path(sys.executable).parent


#: What a run does before its first job, and its end.
PROGRAM = """
import os
from vibraverse.machine import warm, warm_process
warm_process.keep_warm({"": 9, "other.sif": 9})
assert warm.VARIABLE not in os.environ
warm_process.keep_warm({"": 10, "other.sif": 9})
print(os.environ[warm.VARIABLE], flush=True)
input()
"""


#: Repeats commands in forks of a warm process, limited children as plain calls, and tells what each had to import.
IMPORTS = """
import json, os, sys
from vibraverse import cli
from vibraverse.contract import limits
from vibraverse.machine import warm_process
limits.run_limited = lambda function, *arguments, **_: function(*arguments)
for step in warm_process.preparation():
    step()
print(json.dumps({"threads": len(os.listdir("/proc/self/task"))}), flush=True)
for command in json.load(sys.stdin):
    if os.fork() == 0:
        had = set(sys.modules)
        status = cli.main(command)
        print(json.dumps({"stage": command[0], "status": status, "new": sorted(set(sys.modules) - had)}), flush=True)
        os._exit(0)
    os.wait()
"""


class Running(NamedTuple):
    """Address and process number of a warm process."""

    address: str
    process: int


def wait_for(what):
    """Return ``what()`` as soon as it is true."""
    for _ in range(1200):
        found = what()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError("waited a minute in vain")


class Parent:
    """A program that keeps a warm process until it ends: its address, and the environment of commands."""

    def __init__(self, folder: Path):
        (folder / "numpy.py").write_text("raise SystemExit('what lies in the working folder is no module')")
        pipe = subprocess.PIPE
        self.program = subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM], cwd=folder, stdin=pipe, stdout=pipe, text=True
        )
        address = self.program.stdout.readline().strip()
        (number,) = children(self.program.pid)
        self.running = Running(address, int(number))
        path = f"{COMMANDS}{os.pathsep}{os.environ['PATH']}"
        self.environment = {**os.environ, "PATH": path, warm.VARIABLE: address}

    def wait(self) -> None:
        """Wait until the warm process has imported."""
        wait_for(lambda: warm.ask(self.running.address, ["sources"]) == 2)  # it misses arguments


@pytest.fixture(scope="module")
def process(tmp_path_factory):
    """A warm process that has imported, and the environment of commands that use it."""
    parent = Parent(tmp_path_factory.mktemp("warm"))
    parent.wait()
    yield parent.running, parent.environment
    parent.program.communicate("\n")


def sources(folder: Path, environment: dict, *more: str) -> subprocess.CompletedProcess:
    """Make a bar's mesh in a folder."""
    folder.mkdir(exist_ok=True)
    command = [
        "vibraverse", "sources", "--object", "bar-0000", "--mesh", "source.mesh", "--record", "source.json", *more
    ]  # fmt: skip
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def clean(*more: str) -> list[str]:
    return [
        "vibraverse", "clean", "--object", "bar-0000", "--mesh", "source.mesh", "--source-record", "source.json",
        "--surface", "surface.ply", "--record", "clean.json", *more,
    ]  # fmt: skip


def children(process: int) -> list[str]:
    return Path(f"/proc/{process}/task/{process}/children").read_text().split()


def test_a_job_gives_the_same_bytes_and_log(process, tmp_path):
    _, environment = process
    cold = {key: value for key, value in environment.items() if key != warm.VARIABLE}
    said = {}
    for name, where in (("warm", environment), ("cold", cold)):
        done = sources(tmp_path / name, where)
        assert done.returncode == 0, done.stderr
        again = subprocess.run(clean(), cwd=tmp_path / name, env=where, capture_output=True, text=True)
        assert again.returncode == 0, again.stderr
        said[name] = (done.stderr + again.stderr).splitlines()
    for product in ("source.mesh", "source.json", "surface.ply", "clean.json"):
        assert (tmp_path / "warm" / product).read_bytes() == (tmp_path / "cold" / product).read_bytes()
    assert said["warm"][0].startswith("vibraverse sources --object bar-0000")
    assert [line for line in said["warm"] if "done in" not in line] == [
        line for line in said["cold"] if "done in" not in line
    ]


def test_a_job_notes_itself_in_the_journal_of_its_run(process, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with locks.only_run("results") as run:
        assert sources(tmp_path, {**process[1], journal.RUN: str(run.file)}).returncode == 0
    (line,) = Path("results/journal/bar-0000.jsonl").read_text().splitlines()
    noted = json.loads(line)
    assert (noted["stage"], noted["outcome"], noted["run"]) == ("sources", "done", run.file.name)
    assert noted["wall_s"] < 60  # since the fork, not since the warm process began
    assert noted["begun"] > run.file.parent.stat().st_ctime - 60
    assert list(journal.begun("results")) == []


def test_a_failure_keeps_its_exit_status_and_words(process, tmp_path):
    done = sources(tmp_path, process[1], "--options", "{not json")
    assert done.returncode == 2
    assert "--options is not valid JSON" in done.stderr
    done = sources(tmp_path, process[1], "--nonsense")
    assert done.returncode == 2
    assert "unrecognized arguments: --nonsense" in done.stderr


def test_a_job_that_cannot_print_its_failure_fails(process, tmp_path):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [str(COMMANDS / "vibraverse"), "sources", "--nonsense"], cwd=tmp_path, env=process[1], stderr=full
        )
    assert done.returncode != 0


def test_threads_are_read_in_either_form():
    assert asked_threads(["sources", "--threads", "4"]) == "4"
    assert asked_threads(["sources", "--threads=4"]) == "4"
    assert asked_threads(["sources", "--object", "--threads"]) == ""
    assert asked_threads(["sources"]) == "1"


def test_the_limits_of_a_child_hold(process, tmp_path):
    assert sources(tmp_path, process[1]).returncode == 0
    write_ply(tmp_path / "source.mesh", *shapes.ball(subdivisions=7))
    options = json.dumps({"limits": {"memory_mb": 10}})
    done = subprocess.run(
        clean("--options", options), cwd=tmp_path, env=process[1], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "refused (limit): Reading and repairing the mesh needed more than 10 MB" in done.stderr


def test_a_command_with_more_threads_or_of_another_installation_works_by_itself(
    process, tmp_path, monkeypatch
):
    running, _ = process
    assert warm.ask(running.address, ["sources", "--threads", "2"]) is None
    assert warm.ask(running.address, ["train", "--threads", "1"]) is None
    monkeypatch.setattr(sys, "prefix", "/somewhere/else")
    assert warm.ask(running.address, ["sources"]) is None
    assert warm.ask(str(tmp_path / "nothing"), ["sources"]) is None


def test_where_nothing_listens_the_job_is_done(tmp_path, process):
    done = sources(tmp_path, {**process[1], warm.VARIABLE: str(tmp_path / "nothing")})
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "source.mesh").is_file()


def test_a_job_dies_with_its_command(process, tmp_path):
    running, environment = process
    assert sources(tmp_path, environment).returncode == 0  # the warm process has imported
    wait_for(lambda: not children(running.process))
    command = subprocess.Popen(clean(), cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
    job = wait_for(lambda: children(running.process))[0]
    os.kill(int(job), signal.SIGSTOP)  # so that it cannot end by itself
    command.kill()
    command.wait()
    wait_for(lambda: not children(running.process))
    assert not Path("/proc", job).exists()
    assert not (tmp_path / "surface.ply").exists()


def test_a_command_that_comes_early_works_by_itself(tmp_path):
    parent = Parent(tmp_path)
    os.kill(parent.running.process, signal.SIGSTOP)
    assert sources(tmp_path, parent.environment).returncode == 0
    os.kill(parent.running.process, signal.SIGCONT)
    parent.program.communicate("\n")
    wait_for(lambda: not Path(f"/proc/{parent.running.process}").exists())


def test_a_job_outlives_the_run_and_the_warm_process_goes_with_it(tmp_path):
    parent = Parent(tmp_path)
    parent.wait()
    address, number = parent.running
    assert sources(tmp_path, parent.environment).returncode == 0
    wait_for(lambda: not children(number))
    command = subprocess.Popen(clean(), cwd=tmp_path, env=parent.environment, stderr=subprocess.DEVNULL)
    job = int(wait_for(lambda: children(number))[0])
    os.kill(job, signal.SIGSTOP)
    parent.program.kill()
    parent.program.wait()
    wait_for(lambda: warm.ask(address, ["sources"]) is None)  # nobody is taken any more
    os.kill(job, signal.SIGCONT)
    assert command.wait() == 0
    assert (tmp_path / "surface.ply").is_file()
    wait_for(lambda: not Path(f"/proc/{number}").exists())


def test_jobs_import_nothing_that_the_warm_process_could_have(finished, tmp_path):
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    logs = [log for log in folder.glob("results/logs/*/*.log") if log.parent.name == "bar-0000"]
    commands = {
        log.name.split(".")[0]: shlex.split(log.read_text().splitlines()[0])[1:] for log in sorted(logs)
    }
    assert set(commands) >= {
        "sources",
        "clean",
        "grids",
        "hollow",
        "tets",
        "basis",
        "modes",
        "audio",
        "images",
    }
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS], input=json.dumps(list(commands.values())), cwd=folder,
        env=finished.environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    threads, *jobs = (json.loads(line) for line in done.stdout.splitlines() if line.startswith("{"))
    assert threads == {"threads": 1}  # a fork would wait for the others
    assert {job["stage"]: job["status"] for job in jobs} == dict.fromkeys(commands, 0)
    for job in jobs:
        assert job["new"] == [], f"{job['stage']}: add these to `imports` of its step in flow/steps.py"


def test_requests_survive_the_round_trip(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ODD", "a=b\nc\udcff")
    argv = ["sources", "", "--options", '{"a": "é"}', "a=b"]
    identity, folder, mask, asked, environment = warm.parse(warm.request(warm.identity(), argv))
    assert (identity, folder, asked) == (warm.identity(), str(tmp_path), argv)
    assert environment == dict(os.environ)
    assert mask == os.umask(mask)
