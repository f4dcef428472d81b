"""How long `vibraverse status` takes for many objects, all of them fake: files with names and nothing in them.

python benchmarks/status.py [objects]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vibraverse.config import parse
from vibraverse.contract.refusal import Refusal
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import sounds, views
from vibraverse.upkeep.lineage import jobs

ROW = "s\th:m:s\tmax_rss\n2.5\t0:00:02\t100\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", nargs="?", type=int, default=5000)
    count = parser.parse_args().objects
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        Path("config.yaml").write_text(f"sources: {{generated: {{count: {count}}}, bundled: []}}\n")
        plan = Plan(parse({"sources": {"generated": {"count": count}, "bundled": []}}))
        for number, object_id in enumerate(plan.objects):
            fake(plan, object_id, number)
        for state in ("after writing them", "again"):
            started, used = time.perf_counter(), os.times()
            done = subprocess.run(
                [sys.executable, "-m", "vibraverse", "status"], check=True, capture_output=True, text=True
            )
            wall, now = time.perf_counter() - started, os.times()
            cpu = now.children_user + now.children_system - used.children_user - used.children_system
            print(f"{count} objects, {state}: {wall:.2f} s, CPU {cpu:.2f} s")
        print(done.stdout)


def fake(plan: Plan, object_id: str, number: int) -> None:
    """Write an object: of ten, seven done, one refused, one half done, one missing."""
    kind = number % 10
    if kind == 9:
        return
    refusal = Refusal(object_id, "clean", "not_a_solid", "It is flat.").to_text() if kind == 8 else ""
    made_by = jobs(plan.paths, object_id)
    sources = made_by[0].places
    single = (
        made.place(name) for made in made_by for name in made.step.outputs if name not in made.step.folders
    )
    several = [plan.paths.at(view, object=object_id) for view in views(plan)]
    several += [
        plan.paths.at(sound, object=object_id, solidity=solidity)
        for solidity in plan.config.solidities
        for sound in sounds(plan)
    ]
    products = [*single, *several]
    for path in products[:12] if kind == 7 else products:
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "w") as file:
            file.write("" if path in sources else refusal)
    folder = Path(f"results/benchmarks/{object_id}")
    folder.mkdir(parents=True)
    for made in made_by:
        (folder / ".".join(part for part in (made.step.name, made.solidity, "tsv") if part)).write_text(ROW)


if __name__ == "__main__":
    main()
