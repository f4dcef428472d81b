"""A long stage resumes after a kill: its work folder, and leftovers of it beside other stages' products."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import make_products
from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.flow.paths import Paths

#: Counts to ten, a file in its work folder for each number, and is killed or refuses where it is told.
COUNT = """
import json, os, signal, sys
from pathlib import Path
from pydantic import BaseModel
from vibraverse.contract import products
from vibraverse.contract.errors import Refused
from vibraverse.contract.stage import Job, run
from vibraverse.contract.step import OBJECT, Input, Output, Step

class Options(BaseModel):
    factor: int

STEP = Step(
    name="count", version=int(os.environ.get("VERSION", "1")), help="", per=OBJECT, family="fem",
    inputs={"first": Input("", "")}, outputs={"sum": Output("", "", ""), "squares": Output("", "", "")},
)

def count(job):
    first = int(job.inputs["first"].read_text())
    for number in range(10):
        kept = job.work / f"{number}.txt"
        if number == int(os.environ.get("KILL_AT", "-1")):
            (job.work / f".{number}.txt").write_text("half a num")
            os.kill(os.getpid(), signal.SIGKILL)
        if number == int(os.environ.get("REFUSE_AT", "-1")):
            raise Refused("limit", "No more.")
        if not kept.exists():
            print(number, flush=True)
            products.write_text(kept, str(first + job.options.factor * number))
    numbers = [int((job.work / f"{number}.txt").read_text()) for number in range(10)]
    job.outputs["sum"].write_text(str(sum(numbers)))
    job.outputs["squares"].write_text(json.dumps([number**2 for number in numbers]))

final = {"sum": Path("out/sum.txt"), "squares": Path("out/squares.txt")}
job = Job(STEP, "thing", "", {"first": Path("first.txt")}, final, Options(factor=int(sys.argv[1])))
run(job, count, ["count"])
"""
WORK = Path("out/.work.sum.txt")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The working folder, with the input."""
    monkeypatch.chdir(tmp_path)
    Path("first.txt").write_text("3")
    return tmp_path


def count(factor: int = 2, **variables) -> tuple[int, list[int]]:
    """Run the counting stage; return its exit status and the numbers that it counted."""
    environment = {**os.environ, **{name: str(value) for name, value in variables.items()}}
    done = subprocess.run(
        [sys.executable, "-c", COUNT, str(factor)], env=environment, stdout=subprocess.PIPE, text=True
    )
    return done.returncode, [int(line) for line in done.stdout.split()]


def out() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path("out").iterdir()}


def test_a_killed_stage_goes_on_where_it_was(tmp_path):
    assert count() == (0, list(range(10)))
    undisturbed = out()
    assert undisturbed.keys() == {"sum.txt", "squares.txt"}  # and no work folder
    assert undisturbed["sum.txt"] == b"120"
    for path in Path("out").iterdir():
        path.unlink()
    assert count(KILL_AT=5) == (-signal.SIGKILL, [0, 1, 2, 3, 4])
    assert WORK.is_dir()
    assert not Path("out/sum.txt").exists()
    assert count(KILL_AT=7) == (-signal.SIGKILL, [5, 6])
    assert count() == (0, [7, 8, 9])
    assert out() == undisturbed


def test_other_options_inputs_or_versions_begin_anew():
    everything = list(range(10))
    assert count(KILL_AT=5)[1] == everything[:5]
    assert count(factor=3, KILL_AT=5)[1] == everything[:5]
    assert count(factor=2, KILL_AT=5)[1] == everything[:5]
    Path("first.txt").write_text("4")
    assert count(factor=2, KILL_AT=5)[1] == everything[:5]
    assert count(factor=2, VERSION=2) == (0, everything)
    assert json.loads(Path("out/squares.txt").read_text())[:2] == [16, 36]


def test_a_refusal_removes_the_work():
    assert count(KILL_AT=5)[0] == -signal.SIGKILL
    assert count(REFUSE_AT=6) == (0, [5])
    assert read_refusal(Path("out/sum.txt")).message == "No more."
    assert out().keys() == {"sum.txt", "squares.txt"}
    assert count() == (0, list(range(10)))


def test_a_refused_input_removes_the_work():
    assert count(KILL_AT=5)[0] == -signal.SIGKILL
    Path("first.txt").write_text(Refusal("thing", "clean", "not_a_solid", "No.").to_text())
    assert count() == (0, [])
    assert out().keys() == {"sum.txt", "squares.txt"}


def test_a_work_folder_that_is_left_over_is_no_mess(tmp_path, vibraverse):
    """Beside products of every kind: of an object, of a body, a folder, a shard, the index."""
    results = tmp_path / "results"
    Path("config.yaml").write_text("sources: {generated: {count: 1, families: [bar]}, bundled: []}\n")
    paths: Paths = make_products.build(results)
    body = {"object": "bar-0000", "solidity": "solid"}
    names = ("source_mesh", "surface", "grids", "basis", "modes", "sounds", "views", "index")
    left = [paths.named(name, **body) for name in names] + [paths.at(paths.shard, shard="0")]

    def said() -> list[tuple[int, str, str]]:
        found = [vibraverse(command, "--results", results) for command in ("status", "repair", "refusals")]
        return [*found, vibraverse("check", results / "dataset")]

    said()  # takes with it what was said before
    before = said()
    for path in left:
        work = products.work_folder(path)
        work.mkdir(parents=True)
        (work / "made-of.json").write_text("{}")
        (work / "0.h5").write_bytes(b"half")
    assert said() == before
    assert [status for status, *_ in before] == [0, 0, 0, 0]
