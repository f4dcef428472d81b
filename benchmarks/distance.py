"""Distance to a surface on the 128³ grid: this project's loops against Open3D's point queries, in the same run.

    python benchmarks/distance.py [--cells 128] results/objects/*/surface.ply

Prints CPU seconds on one thread, their ratio and the largest difference (Open3D computes in single precision).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from vibraverse.machine.threads import set_threads

set_threads(1)

import numpy as np  # noqa: E402
from open3d.t.geometry import RaycastingScene  # noqa: E402

from vibraverse.files import meshes  # noqa: E402
from vibraverse.geometry.distance.field import grid_distance  # noqa: E402
from vibraverse.geometry.voxels import cell_centres  # noqa: E402


def timed(function):
    start = time.process_time()
    result = function()
    return result, time.process_time() - start


def open3d_distance(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    scene = RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    return scene.compute_distance(points, nthreads=1).numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("surfaces", nargs="+", type=Path, metavar="SURFACE.ply")
    parser.add_argument("--cells", type=int, default=128, help="cells along each axis")
    arguments = parser.parse_args()
    x = cell_centres(arguments.cells)
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).astype(np.float32)
    # The first call compiles, which happens once per installation.
    grid_distance(np.eye(3), np.array([[0, 1, 2]]), *[x[:2]] * 3)
    print(f"{'object':<20} {'triangles':>9} {'ours':>7} {'Open3D':>7} {'ratio':>6}  difference")
    for path in arguments.surfaces:
        vertices, faces = meshes.read_ply(path)
        ours, mine = timed(lambda v=vertices, f=faces: grid_distance(v, f, x, x, x))
        theirs, usual = timed(lambda v=vertices, f=faces: open3d_distance(v, f, points))
        row = f"{path.parent.name:<20} {len(faces):>9} {mine:>6.2f}s {usual:>6.2f}s {usual / mine:>6.1f}"
        print(f"{row}  {np.abs(ours - theirs).max():.1e}", flush=True)


if __name__ == "__main__":
    main()
