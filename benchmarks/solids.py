"""CPU seconds and memory of meshes from file to sound, solid and hollow: ``vibraverse strike`` with 64 modes.

python benchmarks/solids.py FILE|FOLDER...

Each body is a process of its own with one thread, so imports count. A hollow body's wall reaches half of the way to the
deepest point. The aims are 60 CPU seconds and 2048 MB for each body; lines above one are marked.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

#: The aims: CPU seconds and peak memory in MB of a body.
AIM_S, AIM_MB = 60.0, 2048
MODES, HOLLOW = 64, 0.5


def main() -> None:
    from vibraverse.sources.search import find

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="+", help="mesh files, or folders of them")
    parser.add_argument("--json", type=Path, help="also write the rows there, one a line, as they come")
    arguments = parser.parse_args()
    rows = []
    print("| mesh | body | tetrahedra | recipe | surface to mesh, % of diagonal | volume, % | CPU s | MB | |")
    print("|" + 9 * " --- |")
    for path in (file for given in arguments.paths for file in find(given).values()):
        for solidity in ("solid", "hollow"):
            rows.append(measured(path, solidity))
            print(line(rows[-1]), flush=True)
            if arguments.json:
                with arguments.json.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(rows[-1]) + "\n")
            if "refused" in rows[-1] and rows[-1]["stage"] == "mesh":
                break
    print(summary(rows))


def measured(path: Path, solidity: str) -> dict:
    """Strike one body; return its cost, and its facts or why it was refused."""
    with tempfile.TemporaryDirectory() as folder:
        facts, errors = Path(folder) / "facts.json", Path(folder) / "errors.txt"
        command = ["vibraverse", "strike", str(path), "--modes", str(MODES), "--json", str(facts)]
        command += ["-o", f"{folder}/a.wav", *(["--hollow", str(HOLLOW)] if solidity == "hollow" else [])]
        with errors.open("w") as said:
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
            _, status, usage = os.wait4(process.pid, 0)
        row = {
            "mesh": path.name,
            "body": solidity,
            "cpu_s": usage.ru_utime + usage.ru_stime,
            "mb": usage.ru_maxrss // 1024,
        }
        if status == 0:
            found = json.loads(facts.read_text())
            keys = ("tetrahedra", "meshing", "repairs", "warnings", "frequencies_hz", "discretisation_error")
            return row | {key: found[key] for key in keys}
        words = errors.read_text().strip().splitlines()[-1]
        stage = "mesh" if solidity == "solid" else "body"
        return row | {"refused": words.removeprefix("vibraverse: "), "stage": stage}


def line(row: dict) -> str:
    """Return the table's line of a body."""
    above = " ".join(["s"] * (row["cpu_s"] > AIM_S) + ["MB"] * (row["mb"] > AIM_MB))
    cost = f"{row['cpu_s']:.1f} | {row['mb']} | {f'above {above}' if above else ''} |"
    head = f"| {row['mesh']} | {row['body']} |"
    if "refused" in row:
        return f"{head} refused: {row['refused']} | | | | {cost}"
    meshing = row["meshing"]
    recipe = meshing["algorithm"] + (", wrapped" if "wrap" in meshing else "")
    lost, change = meshing["accuracy"]["surface_to_mesh"], meshing["accuracy"]["volume_change"]
    return f"{head} {row['tetrahedra']} | {recipe} | {100 * lost:.2f} | {100 * change:.1g} | {cost}"


def summary(rows: list[dict]) -> str:
    """Return the sentence below the table."""
    made = [row for row in rows if "refused" not in row]
    if not made:
        return f"\n{len(rows)} bodies, all refused."
    seconds, most = np.array([row["cpu_s"] for row in rows]), max(row["mb"] for row in rows)
    within = sum(row["cpu_s"] <= AIM_S and row["mb"] <= AIM_MB for row in rows)
    return (
        f"\n{len(rows)} bodies, {len(rows) - len(made)} refused. CPU s: median {np.median(seconds):.1f}, most "
        f"{seconds.max():.1f}. Memory: most {most} MB. {within} of {len(rows)} within {AIM_S:g} s and {AIM_MB} MB."
    )


if __name__ == "__main__":
    sys.exit(main())
