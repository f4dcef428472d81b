"""Commands in an image with a warm process: they run in its container instead of starting another."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from stand_ins import stub
from test_warm import children, wait_for
from vibraverse.machine import warm

#: A container that is none: it says that it starts, and sets variables as an image does.
CONTAINER = """
echo "$@" >> {started}
[ "$1" = exec ] || {{ echo apptainer version 1.3.0; exit 0; }}
while [ "$1" != {image} ]; do shift; done
shift
export APPTAINER_CONTAINER={image} OWN=image
exec "$@"
"""
#: What a run does before its first job, and its end.
PROGRAM = """
import os
from vibraverse.machine import warm, warm_process
warm_process.keep_warm({os.environ["IMAGE"]: 10}, "--bind '/a b'")
print(*(os.environ[name] for name in ("PATH", warm.VARIABLE, warm.ENTRANCES)), sep="\\0", flush=True)
input()
"""

#: A run of twelve jobs in an image, which waits for its warm process.
SNAKEFILE = """
import os, shlex, sys, time
from vibraverse.machine import internals, warm, warm_process

image = os.environ["IMAGE"]

rule all:
    input: [f"out/{n}" for n in range(12)]

rule one:
    output: "out/{n}"
    container: image
    shell: "echo $OWN > {output}"

onstart:
    arguments = internals.container_arguments(workflow)
    warm_process.keep_warm({image: 12}, arguments)
    while warm.enter(["exec", "--home", os.getcwd(), *shlex.split(arguments), image, "true"]) is None:
        time.sleep(0.1)
"""


def stand_in(folder: Path) -> tuple[Path, dict[str, str]]:
    """Return an image, and an environment with commands that stand in for Apptainer and list what they start."""
    image, commands = folder / "one.sif", folder / "bin"
    image.touch()
    commands.mkdir()
    stub(commands, "apptainer", CONTAINER.format(started=folder / "started", image=image))
    os.symlink("apptainer", commands / "singularity")
    path = os.pathsep.join([str(commands), str(Path(sys.executable).parent), os.environ["PATH"]])
    return image, {**os.environ, "PATH": path, "IMAGE": str(image), "OWN": "run"}


class Run:
    """A run whose jobs work in an image: how its ``apptainer`` commands begin, and the containers it started."""

    def __init__(self, folder: Path):
        self.folder, self.started = folder, folder / "started"
        image, environment = stand_in(folder)
        pipe = subprocess.PIPE
        self.program = subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM], cwd=folder, stdin=pipe, stdout=pipe, text=True, env=environment
        )  # fmt: skip
        path, address, entrances = self.program.stdout.readline().rstrip("\n").split("\0")
        (self.process,) = map(int, children(self.program.pid))
        self.environment = {
            **os.environ, "PATH": path, "OWN": "run", "JOB": "1", warm.VARIABLE: address, warm.ENTRANCES: entrances
        }  # fmt: skip
        self.begin = ["exec", "--home", str(folder), "--bind", "/a b", str(image)]

    def start(self, *words: str, name: str = "apptainer") -> subprocess.Popen:
        """Start an ``apptainer`` command as a job does."""
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [name, *words], cwd=self.folder, env=self.environment, stdout=pipe, stderr=pipe, text=True
        )

    def shell(self, script: str, **more) -> subprocess.Popen:
        """Start a script in the image."""
        return self.start(*self.begin, "sh", "-c", script, **more)

    def containers(self) -> int:
        """Return how many containers the run has started."""
        return len(self.started.read_text().splitlines())


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose warm process has imported."""
    run = Run(tmp_path_factory.mktemp("entrance"))
    wait_for(lambda: run.shell("echo $PPID").communicate()[0].strip() == str(run.process))
    yield run
    run.program.communicate("\n")


@pytest.mark.parametrize("name", ["apptainer", "singularity"])
def test_a_command_runs_in_the_container_that_is_there(run, name):
    before = run.containers()
    job = run.shell("echo $OWN $JOB $PWD; echo wrong >&2; exit 7", name=name)
    assert job.communicate() == (f"image 1 {run.folder}\n", "wrong\n")
    assert (job.returncode, run.containers()) == (7, before)


@pytest.mark.parametrize(
    "words",
    [
        ["--version"],
        ["exec", "--home", "/elsewhere", "--bind", "/a b"],
        ["exec", "--nv", "--home", "{folder}", "--bind", "/a b"],
    ],
)
def test_what_has_no_warm_process_starts_apptainer_itself(run, words):
    before = run.containers()
    words = [word.format(folder=run.folder) for word in words]
    job = run.start(*words, run.begin[-1], "sh", "-c", "exit 5")
    job.communicate()
    assert (job.returncode, run.containers()) == (5 if words[0] == "exec" else 0, before + 1)


def test_signals_reach_the_command(run):
    job = run.shell("trap 'echo ended; exit 3' TERM; echo begun; while :; do sleep 0.05; done")
    assert job.stdout.readline() == "begun\n"
    job.send_signal(signal.SIGTERM)
    assert (job.stdout.read(), job.wait()) == ("ended\n", 3)


def test_a_scheduler_that_signals_all_processes_leaves_commands_the_time_they_need(run):
    job = run.shell("trap 'sleep 0.5; echo saved; exit 3' TERM; echo begun; while :; do sleep 0.05; done")
    assert job.stdout.readline() == "begun\n"
    for process in (job.pid, run.process):
        os.kill(process, signal.SIGTERM)
    assert (job.stdout.read(), job.wait()) == ("saved\n", 3)


def test_a_killed_command_takes_what_it_started_along(run):
    job = run.shell("sleep 300 & echo $!; wait")
    asleep = int(job.stdout.readline())
    job.kill()
    wait_for(
        lambda: not Path(f"/proc/{asleep}").exists() or "zombie" in Path(f"/proc/{asleep}/status").read_text()
    )
    wait_for(lambda: not children(run.process))


def test_without_its_warm_process_a_command_starts_apptainer(tmp_path):
    run = Run(tmp_path)
    run.program.communicate("\n")
    wait_for(lambda: not Path(f"/proc/{run.process}").exists())
    before = run.containers()
    job = run.shell("exit 4")
    job.communicate()
    assert (job.returncode, run.containers()) == (4, before + 1)


def test_snakemakes_jobs_share_one_container(tmp_path):
    _, environment = stand_in(tmp_path)
    (tmp_path / "Snakefile").write_text(SNAKEFILE)
    command = ["snakemake", "--cores", "1", "--sdm", "apptainer", "--apptainer-args", "--bind '/a b'"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {(tmp_path / f"out/{n}").read_text() for n in range(12)} == {"image\n"}
    started = (tmp_path / "started").read_text().splitlines()
    assert [line for line in started if line.startswith("exec")] == [
        line for line in started if warm.SUBCOMMAND in line
    ]
    assert "warm-process" in started[-1]
