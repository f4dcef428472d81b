"""Features: the arrays that training reads, made from one shard of the dataset.

An epoch of training that read the shards would decompress megabytes for every body. Here each body is a row of a few
plain arrays, which are memory-mapped. A body has its surface as points, its spectrum over Poisson's ratio, a few
invariants and its frequencies in every named material; an object has its pictures, which both bodies share. Bodies
have different numbers of tetrahedra, so those of all stand one below the other, and each body says which are its own.
For the reconstruction of shapes a body has signed distances at places around it, and an object its coarse voxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import make_interp_spline

from vibraverse.contract.seeds import rng
from vibraverse.files.basis import read_basis
from vibraverse.geometry import surfaces
from vibraverse.learn import inside
from vibraverse.learn.baselines.polynomials import polynomial_spaces
from vibraverse.learn.baselines.splines import spline_modes, spline_space
from vibraverse.learn.invariants import invariants
from vibraverse.learn.sampling import distance_samples, farthest, sample_surface, voxel_cloud
from vibraverse.learn.scaling import log_dimensionless
from vibraverse.physics.modes import reduced_solve

if TYPE_CHECKING:
    from vibraverse.dataset.read.reader import Reader

#: Array -> what a row is, and its unit.
ARRAYS = {
    "points": "points on the surface (p, 6): position (normalised length), outward normal",
    "invariants": "scale-free invariants (5,) of the shape, see `vibraverse.learn.invariants`",
    "log_omega": "logarithm of the dimensionless frequencies (k, m) at Poisson's ratios `poisson`",
    "ritz": "the same (k, d, m) by polynomials of the degrees `ritz_degrees`, then by splines of `ritz_unknowns`",
    "frequencies_hz": "frequencies in Hz (n, m) in the named materials, corrected as in the dataset",
    "scales": "logarithms (1 + h,) of the torsion function's maximum and of the harmonics' eigenvalues, see `inside`",
    "mesh_rows": "first row in `mesh_points`, how many, first row in `mesh_cells`, how many (4,)",
    "volume_m3": "volume in m³",
    "size_m": "longest side in m",
    "thickness": "t of a hollow body's cavity, not a number for a solid one",
    "distance_places": "places (3, s, 3) in units of 2⁻¹⁵: even in [-1, 1]³, near the body's surface, on it",
    "distances": "signed distance (2, s) of the even places and of those near the surface (normalised length)",
    "object_row": "row of the body's object in the arrays of objects, which are the next three",
    "views": "pictures of an object (v, px, px, 3), 0 to 255",
    "voxels": "occupancy of an object's outside (n, n, n)",
    "farthest": "numbers (l,) of `voxel_points` points on its voxels, each farthest from those before",
    "mesh_points": "corners of all bodies' tetrahedra (3,) in the body's own frame, over V^(1/3)",
    "mesh_fields": "torsion function and harmonics (1 + h,) there, see `vibraverse.learn.inside`",
    "mesh_cells": "tetrahedra of all bodies (4,), as rows counted from the body's first",
}
#: Arrays with a row per vertex or tetrahedron: their names in the result of :func:`vibraverse.learn.inside.describe`.
MESH = {"mesh_points": "points", "mesh_fields": "fields", "mesh_cells": "cells"}
#: Poisson's ratios at which approximate spectra are computed, at most.
_RATIOS = 9


class Unusable(ValueError):
    """A dataset that training cannot use, in one sentence that says what to change."""


def write_features(reader: Reader, folder: Path, options) -> dict:
    """Write the arrays of a shard's bodies into a folder; return what describes their rows and columns.

    ``options`` are :class:`vibraverse.config.learn.Features`. A shard without bodies, whose objects are all refused,
    has no arrays. Raises :class:`Unusable` for bodies with different numbers of modes, or without the pictures or
    Poisson's ratios asked for.
    """
    bodies = _bodies(reader)
    materials = _materials(reader, bodies)
    objects = sorted({object_ for object_, _ in bodies})
    number = {name: row for row, name in enumerate(objects)}
    poisson = np.linspace(*options.poisson_range, options.poisson_nodes)
    arrays: dict[str, np.memmap] = {}
    meshes: list[dict] = []
    for row, (object_, solidity) in enumerate(bodies):
        values = _body(reader, object_, solidity, materials, poisson, options)
        meshes.append(_mesh(reader, object_, solidity))
        values |= {"object_row": np.int64(number[object_]), "scales": meshes[-1]["scales"]}
        _put(folder, arrays, row, len(bodies), values)
    arrays |= write_meshes(folder, meshes)
    for row, object_ in enumerate(objects):
        _put(folder, arrays, row, len(objects), _object(reader, object_, options))
    parameters = ("density_kg_m3", "young_pa", "poisson")
    return {
        "bodies": {
            "object": [object_ for object_, _ in bodies],
            "solidity": [solidity for _, solidity in bodies],
            **_origins(reader, bodies),
        },
        "objects": objects,
        "materials": {
            name: {one: float(reader.read(one, *bodies[0], material=name)) for one in parameters}
            for name in materials
        },
        "poisson": poisson.tolist(),
        "ritz_degrees": list(options.ritz_degrees),
        "ritz_unknowns": list(options.ritz_unknowns),
        "voxel_points": options.voxel_points,
        "arrays": {
            name: {"shape": array.shape, "dtype": str(array.dtype), "meaning": ARRAYS[name]}
            for name, array in arrays.items()
        },
    }


def _bodies(reader: Reader) -> list[tuple[str, str]]:
    """Return object and solidity of every body, sorted."""
    objects, solidities = (reader.items.column(name).tolist() for name in ("object", "solidity"))
    return sorted(set(zip(objects, solidities, strict=True)), key=lambda body: (body[0], body[1] == "hollow"))


def _materials(reader: Reader, bodies: list[tuple[str, str]]) -> list[str]:
    """Return the names of the materials, which all bodies of a dataset have."""
    return sorted(reader.group(bodies[0][0])[f"{bodies[0][1]}/materials"]) if bodies else []


def _origins(reader: Reader, bodies: list[tuple[str, str]]) -> dict[str, list[str]]:
    """Return origin and family of every body: of a generated one its shape family, else its category or its id."""
    columns = (reader.items.column(name).tolist() for name in ("object", "origin", "category"))
    known = {object_: (origin, category) for object_, origin, category in zip(*columns, strict=True)}
    family = {
        object_: object_.rpartition("-")[0] if origin == "generated" else category or object_
        for object_, (origin, category) in known.items()
    }
    return {
        "origin": [known[object_][0] for object_, _ in bodies],
        "family": [family[object_] for object_, _ in bodies],
    }


def _body(reader: Reader, object_: str, solidity: str, materials: list[str], poisson, options) -> dict:
    """Return the row of a body in every array."""
    place = {"object": object_, "solidity": solidity}
    prefix = "surface" if solidity == "solid" else "boundary"
    vertices, faces = (reader.read(f"{prefix}_{part}", **place) for part in ("vertices", "faces"))
    basis = read_basis(reader.group(object_)[f"{solidity}/basis"], surface=False)
    low, high = basis.poisson_range
    if not low <= poisson[0] <= poisson[-1] <= high:
        raise Unusable(
            f"the basis of {object_}, {solidity}, holds for Poisson's ratios {low:g} to {high:g}, not "
            f"{poisson[0]:g} to {poisson[-1]:g}; narrow learn.features.poisson_range"
        )
    frequencies = np.stack([reader.read("frequencies_hz", **place, material=name) for name in materials])
    cavity = reader.read("hollow", **place) if solidity == "hollow" else {"t": np.nan}
    around = distance_samples(vertices, faces, options.distance_samples, rng(object_, solidity, "distances"))
    return {
        **dict(zip(("distance_places", "distances"), around, strict=True)),
        **shape_arrays(vertices, faces, object_, solidity, frequencies.shape[1], options),
        "log_omega": spectrum(basis, poisson, frequencies.shape[1]).astype(np.float32),
        "frequencies_hz": frequencies,
        "volume_m3": np.float64(reader.read("volume_m3", **place, material=materials[0])),
        "size_m": np.float64(reader.read("size_m", **place)),
        "thickness": np.float64(cavity["t"]),
    }


def shape_arrays(
    vertices: np.ndarray,
    faces: np.ndarray,
    object_: str,
    solidity: str,
    modes: int,
    options,
    ritz: bool = True,
) -> dict[str, np.ndarray]:
    """Return the rows of a body in the arrays that follow from its closed surface, without a simulation.

    ``options`` are :class:`vibraverse.config.learn.Features`. What is random follows from the object's id and the
    solidity. Without ``ritz`` these spectra, which take seconds, are left out.
    """
    spectra = {}
    if ritz:
        poisson = np.linspace(*options.poisson_range, options.poisson_nodes)
        found = ritz_spectra(vertices, faces, poisson, modes, options.ritz_degrees, options.ritz_unknowns)
        spectra["ritz"] = found.astype(np.float32)
    return {
        **spectra,
        "points": sample_surface(vertices, faces, options.points, rng(object_, solidity, "points")),
        "invariants": invariants(vertices, faces).astype(np.float32),
    }


def _mesh(reader: Reader, object_: str, solidity: str) -> dict[str, np.ndarray]:
    """Return the tetrahedra of a body in its own frame, and what is known of them."""
    return inside.describe(*(reader.read(f"tet_{part}", object_, solidity) for part in ("points", "cells")))


def write_meshes(folder: Path, meshes: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Write the tetrahedra of bodies one below the other, and which rows are whose; return the arrays."""
    if not meshes:
        return {}
    counts = np.array([[len(mesh["points"]), len(mesh["cells"])] for mesh in meshes])
    firsts = np.cumsum(counts, axis=0) - counts
    arrays = {name: np.concatenate([mesh[part] for mesh in meshes]) for name, part in MESH.items()}
    arrays["mesh_rows"] = np.stack([firsts, counts], axis=2).reshape(-1, 4)
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    return arrays


def spectrum(basis, poisson, modes: int) -> np.ndarray:
    """Return the logarithm of the dimensionless frequencies (k, m) of a body at Poisson's ratios (k,)."""
    values = np.stack([reduced_solve(basis, float(nu), modes).values for nu in poisson])
    return log_dimensionless(values, basis.volume)


def ritz_spectra(
    vertices: np.ndarray, faces: np.ndarray, poisson, modes: int, degrees, unknowns=()
) -> np.ndarray:
    """Return what :func:`spectrum` does (k, d, m), by polynomials of total degrees, then by splines of some unknowns.

    ``vertices`` (V, 3) in any unit and ``faces`` (F, 3) are the closed surface of the body. Between some Poisson's
    ratios the logarithms are interpolated linearly, which changes them by less than 0.001.
    """
    solved = np.linspace(poisson[0], poisson[-1], min(len(poisson), _RATIOS))
    try:
        spaces = polynomial_spaces(vertices, faces, degrees)
        values = [np.array([space.modes(float(nu), modes)[0] for nu in solved]) for space in spaces]
    except ValueError as error:
        raise Unusable(f"learn.features.ritz_degrees: {error}") from None
    try:
        values += [spline_modes(spline_space(vertices, faces, size), solved, modes) for size in unknowns]
    except ValueError as error:
        raise Unusable(f"learn.features.ritz_unknowns: {error}") from None
    found = log_dimensionless(np.stack(values, axis=1), surfaces.volume(vertices, faces))
    return found if len(solved) == len(poisson) else make_interp_spline(solved, found, k=1)(poisson)


def _object(reader: Reader, object_: str, options) -> dict:
    """Return the row of an object in every array that its bodies share."""
    voxels = reader.read("occupancy", object_)
    return {
        "views": _pictures(reader, object_, options.look, options.view_px),
        **voxel_arrays(voxels, object_, options),
    }


def voxel_arrays(voxels: np.ndarray, object_: str, options) -> dict[str, np.ndarray]:
    """Return the rows of an object in the arrays that follow from its occupied cells (n, n, n)."""
    cloud = voxel_cloud(voxels, options.voxel_points, object_)
    return {
        "voxels": voxels.astype(np.uint8),
        "farthest": farthest(cloud[:, :3], options.farthest).astype(np.int32),
    }


def _pictures(reader: Reader, object_: str, look: str, size_px: int) -> np.ndarray:
    """Return the pictures (v, px, px, 3) of an object in one look."""
    from PIL import Image

    try:
        pictures = map(Image.fromarray, reader.read("views", object_, look=look))
    except KeyError as error:
        raise Unusable(f"learn.features.look: {error.args[0]}") from None
    return np.stack([np.asarray(one.resize((size_px, size_px), Image.Resampling.BOX)) for one in pictures])


def _put(folder: Path, arrays: dict[str, np.memmap], row: int, rows: int, values: dict) -> None:
    """Write the row of every array; the first one makes the files."""
    for name, value in values.items():
        value = np.asarray(value)
        if name not in arrays:
            arrays[name] = np.lib.format.open_memmap(
                folder / f"{name}.npy", "w+", value.dtype, (rows, *value.shape)
            )
        if value.shape != arrays[name].shape[1:]:
            raise Unusable(
                f"row {row} of {name} has the shape {value.shape}, the first {arrays[name].shape[1:]}; all bodies of a "
                "dataset need the same basis.modes, materials and images.views"
            )
        arrays[name][row] = value
