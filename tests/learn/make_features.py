"""Features of synthetic bodies, written without any stage: boxes and ellipsoids whose spectrum is a plain formula.

The dimensionless frequencies of a body grow like those of a box of waves, so they follow from the three sides; a
hollow body has lower first and higher last ones. So a network can learn them, and a test can say what it must reach.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import numpy as np

from vibraverse.config.learn import Features
from vibraverse.contract import products
from vibraverse.contract.seeds import rng
from vibraverse.geometry.voxels import cell_centres
from vibraverse.learn.features import shape_arrays, voxel_arrays, write_meshes
from vibraverse.learn.inside import describe
from vibraverse.learn.invariants import invariants
from vibraverse.learn.sampling import distance_samples, sample_surface
from vibraverse.learn.scaling import unit_hz

MATERIALS = {
    "steel": {"density_kg_m3": 7850.0, "young_pa": 2.0e11, "poisson": 0.29},
    "wood": {"density_kg_m3": 750.0, "young_pa": 1.1e10, "poisson": 0.25},
}
MODES = 24
OPTIONS = Features(
    points=512, poisson_nodes=5, ritz_degrees=[2, 3], ritz_unknowns=[300], view_px=32, voxel_points=1024, farthest=64,
    distance_samples=1024,
)  # fmt: skip


def sides_of(object_: str) -> np.ndarray:
    """Return the three sides (3,) of an object's box, longest first, 1.8 at most."""
    return np.sort(rng(object_, "sides").uniform(0.4, 1.8, size=3))[::-1] / 1.0


def mesh_of(object_: str):
    """Return the surface of an object's bodies, as trimesh makes it."""
    import trimesh

    return trimesh.creation.box(sides_of(object_)).subdivide()


def box_of(object_: str, solidity: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices and faces of an object's box, the same for both bodies."""
    mesh = mesh_of(object_)
    return mesh.vertices, mesh.faces


def voxels_of(object_: str) -> np.ndarray:
    """Return which cells (16, 16, 16) have their centre in an object's box."""
    half = sides_of(object_) / 2
    inside = np.abs(cell_centres(16)[:, None]) < half
    return (inside[:, None, None, 0] & inside[None, :, None, 1] & inside[None, None, :, 2]).astype(np.uint8)


def tetrahedra_of(sides: np.ndarray, cells=(3, 2, 2)) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) and positive tetrahedra (T, 4) of a box: six along the diagonal of each cell."""
    axes = [np.linspace(-0.5, 0.5, count + 1) * side for count, side in zip(cells, sides, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    paths = []
    for order in permutations(range(3)):
        corners = np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)])
        turned = np.linalg.det(np.eye(3)[list(order)]) < 0
        paths.append(corners[[0, 2, 1, 3]] if turned else corners)
    firsts = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    shape = np.array(cells) + 1
    return points, np.ravel_multi_index(tuple(np.moveaxis(firsts + np.array(paths), -1, 0)), shape).reshape(
        -1, 4
    )


def volume_of(object_: str) -> float:
    """Return the volume of an object's bodies in m³."""
    return 0.02 * float(np.prod(sides_of(object_))) / 1.8**3


def log_omega(sides: np.ndarray, solidity: str, poisson: np.ndarray, modes: int = MODES) -> np.ndarray:
    """Return the logarithms (k, m) of the lowest waves of a box of these sides, at Poisson's ratios (k,)."""
    numbers = np.stack(np.meshgrid(*[np.arange(6)] * 3), axis=-1).reshape(-1, 3)[1:]
    waves = np.sort(np.linalg.norm(np.pi * numbers / sides, axis=1) * np.cbrt(np.prod(sides)))[:modes]
    waves = waves * (np.linspace(0.6, 1.2, modes) if solidity == "hollow" else 1.0)
    return np.log(waves) + 0.1 * (0.25 - poisson)[:, None]


def write(
    folder: Path,
    objects: list[str],
    solidities=("solid", "hollow"),
    options: Features = OPTIONS,
    surface: Callable[[str, str], tuple[np.ndarray, np.ndarray]] = box_of,
    modes: int = MODES,
    invented_ritz: bool = False,
    reconstruction: bool = True,
) -> Path:
    """Write the features of one shard into a folder; ``surface`` makes vertices and faces of an object's body.

    Polynomial Ritz frequencies are those of the surface, or made up, which takes no time. Without ``reconstruction``
    that task's arrays, which take Numba, are left out.
    """
    folder.mkdir(parents=True)
    bodies = [(object_, solidity) for object_ in objects for solidity in solidities]
    poisson = np.linspace(*options.poisson_range, options.poisson_nodes)
    rows: dict[str, list] = {}
    meshes = []
    for object_, solidity in bodies:
        sides = sides_of(object_)
        meshes.append(describe(*tetrahedra_of(sides)))
        vertices, faces = surface(object_, solidity)
        values = log_omega(sides, solidity, poisson, modes)
        at = np.array(
            [[np.interp(one["poisson"], poisson, mode) for mode in values.T] for one in MATERIALS.values()]
        )
        stiff = [[one[name] for one in MATERIALS.values()] for name in ("young_pa", "density_kg_m3")]
        if invented_ritz:
            above = np.linspace(0.4, 0.1, len(options.ritz_degrees) + len(options.ritz_unknowns))[:, None]
            shape = {
                "points": sample_surface(vertices, faces, options.points, rng(object_, solidity)),
                "invariants": invariants(vertices, faces).astype(np.float32),
                "ritz": (values[:, None] + above).astype(np.float32),
            }
        else:
            shape = shape_arrays(vertices, faces, object_, solidity, modes, options)
        if reconstruction:
            around = distance_samples(vertices, faces, options.distance_samples, rng(object_, solidity))
            shape |= dict(zip(("distance_places", "distances"), around, strict=True))
        for name, value in {
            **shape,
            "log_omega": values.astype(np.float32),
            "frequencies_hz": np.exp(at) * unit_hz(volume_of(object_), *map(np.array, stiff))[:, None],
            "volume_m3": volume_of(object_),
            "scales": meshes[-1]["scales"],
            "size_m": 0.1,
            "thickness": rng(object_, "t").uniform(0.3, 0.7) if solidity == "hollow" else np.nan,
            "object_row": objects.index(object_),
        }.items():
            rows.setdefault(name, []).append(value)
    pictures = [
        rng(one, "view").integers(0, 256, (3, options.view_px, options.view_px, 3)) for one in objects
    ]
    arrays = {name: np.array(values) for name, values in rows.items()} | {
        "views": np.array(pictures, np.uint8)
    }
    if reconstruction:
        coarse = [voxel_arrays(voxels_of(one), one, options) for one in objects]
        arrays |= {name: np.array([one[name] for one in coarse]) for name in coarse[0]}
    write_meshes(folder, meshes)
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    record = {
        "bodies": {
            "object": [object_ for object_, _ in bodies],
            "solidity": [solidity for _, solidity in bodies],
            "origin": ["files" if object_.startswith("own") else "generated" for object_, _ in bodies],
            "family": [object_.rpartition("-")[0] for object_, _ in bodies],
        },
        "objects": objects,
        "materials": MATERIALS,
        "poisson": poisson.tolist(),
        "ritz_degrees": options.ritz_degrees,
        "ritz_unknowns": options.ritz_unknowns,
        "voxel_points": options.voxel_points,
    }
    products.write_text(folder / "features.json", json.dumps(record))
    return folder


def write_splits(path: Path, objects: list[str], copies: dict[str, str] | None = None) -> Path:
    """Write the splits of objects: of ten in a row, one is validated and two are tested."""
    names = ["train"] * 7 + ["validation"] + ["test"] * 2
    lines = [
        f"{one}\t{names[number % 10]}\t{(copies or {}).get(one, '')}" for number, one in enumerate(objects)
    ]
    path.write_text("object\tsplit\tcopy_of\n" + "\n".join(lines) + "\n")
    return path
