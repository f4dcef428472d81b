"""Time of `vibraverse status` for many objects, made of empty files with the right names.

python benchmarks/status.py [objects]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from vibraverse.config import parse
from vibraverse.contract import journal
from vibraverse.contract.journal import Ended, Mark
from vibraverse.contract.refusal import Refusal
from vibraverse.flow.plan import Plan
from vibraverse.upkeep import progress
from vibraverse.upkeep.lineage import jobs

#: Numbers of working and killed jobs, and a process number above Linux's maximum.
WORKING, KILLED, GONE = 100, 100, 2**22 + 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", type=int, nargs="?", default=5000)
    count = parser.parse_args().objects
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("config.yaml").write_text(f"sources: {{generated: {{count: {count}}}, bundled: []}}\n")
        plan = Plan(parse({"sources": {"generated": {"count": count}, "bundled": []}}))
        for number, object_id in enumerate(plan.objects):
            fake(plan, object_id, number)
        marks = begin(plan)
        for state in ("after writing them", "again"):
            started, used = time.perf_counter(), os.times()
            done = subprocess.run(
                [sys.executable, "-m", "vibraverse", "status"], check=True, capture_output=True, text=True
            )
            wall, now = time.perf_counter() - started, os.times()
            cpu = now.children_user + now.children_system - used.children_user - used.children_system
            print(f"{count} objects, {state}: {wall:.2f} s, CPU {cpu:.2f} s")
        print(done.stdout)
        for mark in marks:
            mark.remove()


def fake(plan: Plan, object_id: str, number: int) -> None:
    """Write an object's files: of ten objects, seven are done, one is refused, one half done, one missing."""
    kind = number % 10
    if kind == 9:
        return
    refusal = Refusal(object_id, "clean", "not_a_solid", "It is flat.").to_text() if kind == 8 else ""
    files = [(one.stage, "/".join(file)) for one in progress.kinds_of(plan) for file in one.files]
    for stage, file in files[:12] if kind == 7 else files:
        path = f"results/objects/{object_id}/{file}"
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "w") as product:
            product.write("" if stage == "sources" else refusal)
    folder = Path(plan.paths.journal)
    folder.mkdir(exist_ok=True)
    ended = [
        Ended(made.step.name, object_id, made.solidity, "done", 2.5, 2.0, 100.0, "here", 1, "", "", 1.0, 3.5)
        for made in jobs(plan.paths, object_id)
    ]
    lines = "".join(f"{json.dumps(asdict(one))}\n" for one in ended)
    (folder / f"{object_id}.jsonl").write_text(lines)


def begin(plan: Plan) -> list[Mark]:
    """Make this process a run with working and killed jobs of missing objects."""
    run = Mark(journal.runs_folder("results"))
    begun = Path(plan.paths.journal, "begun")
    missing = list(plan.objects)[9::10][: WORKING + KILLED]
    marks = [Mark(begun, run=run.file.name, stage="sources", object=object_id) for object_id in missing]
    for mark in marks[WORKING:]:
        mark.file.write_text(json.dumps({**asdict(mark.worker), "process": GONE}))
        mark.release()
    return [run, *marks]


if __name__ == "__main__":
    main()
