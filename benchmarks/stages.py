"""Where a run's time went: CPU and wall seconds and memory by stage, from the files Snakemake wrote.

python benchmarks/stages.py [results]
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from pathlib import Path


def main() -> None:
    results = Path(sys.argv[1] if len(sys.argv) > 1 else "results")
    rows = defaultdict(list)
    for path in sorted((results / "benchmarks").rglob("*.tsv")):
        with open(path) as file:
            for row in csv.DictReader(file, delimiter="\t"):
                rows[path.name.split(".")[0]].append(
                    [
                        float(row[key]) if row[key] not in ("NA", "-") else 0.0
                        for key in ("s", "cpu_time", "max_rss")
                    ]
                )
    if not rows:
        sys.exit(f"{results}/benchmarks holds no benchmark files; run the workflow first.")
    print(f"{'stage':<10}{'jobs':>6}{'wall s':>10}{'per job':>10}{'CPU s':>10}{'most MB':>10}")
    total = [0, 0.0, 0.0]
    for stage, values in sorted(rows.items(), key=lambda item: -sum(v[0] for v in item[1])):
        wall, cpu, memory = sum(v[0] for v in values), sum(v[1] for v in values), max(v[2] for v in values)
        print(
            f"{stage:<10}{len(values):>6}{wall:>10.1f}{wall / len(values):>10.1f}{cpu:>10.1f}{memory:>10.0f}"
        )
        total = [total[0] + len(values), total[1] + wall, total[2] + cpu]
    print(f"{'all':<10}{total[0]:>6}{total[1]:>10.1f}{total[1] / total[0]:>10.1f}{total[2]:>10.1f}")


if __name__ == "__main__":
    main()
