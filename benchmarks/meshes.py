"""Results of the geometry stages: rung, distances, elements, quality and CPU seconds, one line per body.

python benchmarks/meshes.py FILE|FOLDER...       your own meshes
python benchmarks/meshes.py --generated 200      this many generated objects, numbered from --first

Default options. Libraries are imported and loops compiled before the first measurement. For a refused mesh, the line
states the reason.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="*", help="mesh files, or folders of them")
    parser.add_argument("--generated", type=int, default=0, help="how many generated objects")
    parser.add_argument("--families", nargs="+", default=["parametric"], help="of which families, or groups")
    parser.add_argument("--first", type=int, default=1000, help="number of the first of each family")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the rows there")
    arguments = parser.parse_args()
    work = list(_work(arguments))
    if not work:
        parser.error("nothing to do: name mesh files, or --generated N")
    rows = []
    print(
        "| mesh | triangles | rung | body to source / source to body, % of diagonal | body | elements | volume, % "
        "| angle: least / 5 %, deg | layers | CPU s: clean, tets; grids, hollow, tets |"
    )
    print("|" + 10 * " --- |")
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for row in pool.imap(_measure, work):
            rows.append(row)
            print(*_lines(row), sep="\n", flush=True)
    print(_summary(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


def _work(arguments):
    from vibraverse.sources.families import named
    from vibraverse.sources.search import find

    for path in arguments.paths:
        yield from (("file", str(file)) for file in find(path).values())
    names = named(arguments.families)
    for i in range(arguments.generated):
        yield "generated", f"{names[i % len(names)]}-{arguments.first + i // len(names):04d}"


@cache
def _warm_up() -> None:
    """Import and compile everything once."""
    box = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                      [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip
    _chain(box, faces, "warm-up", {}, {})


def _measure(task: tuple[str, str]) -> dict:
    kind, name = task
    row: dict = {"name": Path(name).name if kind == "file" else name, "cpu": {}}
    try:
        _warm_up()
        if kind == "file":
            from vibraverse.files.meshes import read_mesh

            mesh = read_mesh(Path(name))
        else:
            from vibraverse.sources.families import generate

            mesh = generate(name)
        row["source_triangles"] = len(mesh.faces)
        _chain(mesh.vertices, mesh.faces, row["name"], row, row["cpu"])
    except Exception as error:
        row["refused"] = (
            f"{getattr(error, 'reason', type(error).__name__)}: {getattr(error, 'message', error)}"
        )
    row["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return row


def _chain(vertices, faces, name: str, row: dict, cpu: dict) -> None:
    from vibraverse.contract.seeds import rng
    from vibraverse.geometry import grids, surfaces
    from vibraverse.geometry.cleaning.clean import clean
    from vibraverse.geometry.hollow import hollow

    def timed(stage, function, *values):
        start = time.process_time()
        try:
            return function(*values)
        finally:
            cpu[stage] = time.process_time() - start

    body = timed("clean", clean, vertices, faces)
    row["rung"], row["triangles"] = body.rung, len(body.faces)
    row["invented"], row["lost"] = body.deviation.body_to_source, body.deviation.source_to_body
    outside = body.vertices, body.faces
    row["bodies"] = {}
    _tets("solid", outside, row, timed)
    distance = timed("grids", lambda: grids.Sampler(*outside).signed_distance(128))
    try:
        inside = timed("hollow", hollow, *outside, distance, float(rng(name, "hollow").uniform(0.3, 0.7)))
    except Exception as error:
        row["bodies"]["hollow"] = {"refused": getattr(error, "message", str(error))}
        return
    row["hollow_share"] = surfaces.volume(inside.vertices, inside.faces) / surfaces.volume(*outside)
    _tets("hollow", (inside.vertices, inside.faces), row, timed)


def _tets(solidity: str, surface, row: dict, timed) -> None:
    from vibraverse.geometry import surfaces
    from vibraverse.geometry.boundary import boundary
    from vibraverse.geometry.meshing import quality
    from vibraverse.geometry.meshing.tets import tetrahedralise

    try:
        mesh = timed(f"tets {solidity}", tetrahedralise, *surface)
    except Exception as error:
        row["bodies"][solidity] = {"refused": getattr(error, "message", str(error))}
        return
    volume = float(quality.volumes(mesh.points, mesh.cells).sum())
    row["bodies"][solidity] = {
        "vertices": len(mesh.points),
        "elements": len(mesh.cells),
        "surface_triangles": len(boundary(mesh.cells)[0]),
        "volume_change": volume / surfaces.volume(*surface) - 1,
        "quality": mesh.quality,
        "warnings": mesh.warnings,
    }


def _lines(row: dict) -> list[str]:
    head = f"| {row['name']} | {row.get('source_triangles', '')} "
    if "bodies" not in row:
        return [head + f"| refused | {row.get('refused', '')} | | | | | | |"]
    head += f"| {row['rung']} | {100 * row['invented']:.2f} / {100 * row['lost']:.2f} "
    lines, cpu = [], row["cpu"]
    for solidity, found in row["bodies"].items():
        if "refused" in found:
            lines.append(head + f"| {solidity} | refused: {found['refused']} | | | | |")
            continue
        angle, layers = found["quality"]["min_dihedral_deg"], found["quality"]["layers"]
        before = ("clean",) if solidity == "solid" else ("grids", "hollow")
        seconds = ", ".join(f"{cpu[stage]:.2f}" for stage in (*before, f"tets {solidity}"))
        lines.append(
            head + f"| {solidity} | {found['elements']} | {100 * found['volume_change']:.1g} "
            f"| {angle['min']:.2g} / {angle['p05']:.0f} | {layers['median']:.1f} | {seconds} |"
        )
        head = "| | | | "
    return lines


def _summary(rows: list[dict]) -> str:
    done = [row for row in rows if "bodies" in row]
    bodies = [(row, name, found) for row in done for name, found in row["bodies"].items()]
    good = [(row, name, found) for row, name, found in bodies if "refused" not in found]
    cost = [row["cpu"]["clean"] + row["cpu"][f"tets {name}"] for row, name, _ in good]
    whole = [sum(row["cpu"].values()) for row in done]
    elements = [found["elements"] for _, _, found in good]
    if not good:
        return f"\n{len(rows)} meshes, none became a body."
    return (
        f"\n{len(rows)} meshes, {len(rows) - len(done)} refused by clean; of {len(bodies)} bodies "
        f"{len(bodies) - len(good)} refused.\nclean + tets, CPU s a body: median {np.median(cost):.2f}, "
        f"95th percentile {np.percentile(cost, 95):.2f}, most {max(cost):.2f}; "
        f"all stages of an object, most {max(whole):.1f}.\n"
        f"elements: median {np.median(elements):.0f}, 95th percentile {np.percentile(elements, 95):.0f}; memory up to "
        f"{max(row['peak_mb'] for row in rows)} MB."
    )


if __name__ == "__main__":
    sys.exit(main())
