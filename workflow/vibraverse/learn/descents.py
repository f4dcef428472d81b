"""Tested bodies of task ``reconstruction`` by :mod:`vibraverse.learn.diffsound`, one after the other.

Linear tetrahedra on a coarse lattice ring far too high. So a body is sought twice: from the spectrum that its own shape
has on the lattice, and from its true one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from vibraverse.contract.seeds import stable_hash
from vibraverse.geometry.voxels import cell_centres
from vibraverse.learn.baselines.voxels import smoothed
from vibraverse.learn.diffsound import EmptyLevelSetError, Settings, eigenvalues, search
from vibraverse.learn.reconstructions import Field
from vibraverse.learn.sampling import EVEN, NEAR, ON, UNIT
from vibraverse.learn.sides import TEST

#: The spectra from which a body is sought, in the order of the arrays.
TARGETS = ("lattice", "true")
#: Deepest places of known distance, which tell the winding number inside; places whose winding number is found at once.
_DEEPEST, _TOGETHER = 16, 512
#: Measures of the search itself, beside those of the reconstruction: first and least loss of the spectrum, its time.
SEARCH = ("loss_first", "loss_least", "search_seconds")


def chosen(task, bodies: int, part: int = 0, parts: int = 1) -> np.ndarray:
    """Return the numbers of a part of the tested bodies: the first ones in an order that follows from their names."""
    tested = task.sides[TEST]
    order = np.argsort([stable_hash(task.samples.ids[body], "diffsound") for body in tested], kind="stable")
    return tested[order[:bodies]][part::parts]


def sought(task, body: int, settings: Settings) -> dict[str, np.ndarray]:
    """Return the measures of a body sought from both spectra, each array by target."""
    samples = task.samples
    (poisson,) = task.poisson(np.array([body]))
    voxels = samples.row("voxels", body)
    first, known = smoothed(voxels), sides(voxels)
    modes = samples.row("log_omega", body).shape[-1]
    spectra = {
        "lattice": eigenvalues(true_distance(samples, body), settings.cells, poisson, modes),
        "true": np.exp(2 * task.heard(body).astype(float)),
    }
    rows = []
    for target in TARGETS:
        seed = stable_hash(samples.ids[body], target) % 2**31
        try:
            found = search(spectra[target], poisson, first, known, settings, seed)
        except EmptyLevelSetError:
            nothing = dict.fromkeys(SEARCH, np.nan)
            rows.append({**task.measured(lambda at: np.ones(len(at)), body, poisson), **nothing})
            continue
        about = found.spectrum[0], np.nanmin(found.spectrum), found.seconds
        field = on_lattice(found.distance, settings.cells)
        rows.append({**task.measured(field, body, poisson), **dict(zip(SEARCH, about, strict=True))})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def sides(voxels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of cells (k, 3) whose side is known, and the sides (k,): -1 inside, 1 outside.

    A cell outside is known. One inside is if it has a neighbour outside: what lies deeper may be a cavity.
    """
    occupied = np.pad(voxels > 0, 1)
    deep = occupied.copy()
    for axis in range(3):
        for step in (-1, 1):
            deep &= np.roll(occupied, step, axis=axis)
    occupied, deep = (grid[1:-1, 1:-1, 1:-1] for grid in (occupied, deep))
    axis = cell_centres(len(voxels))
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return centres[~deep], np.where(occupied, -1.0, 1.0)[~deep]


def true_distance(samples, body: int) -> Field:
    """Return about the signed distance of a body, from points on its surface.

    The side of a place is told by how much of its surroundings the points cover, seen from within or from without (the
    winding number); places of known distance tell how much is half.
    """
    places, distances = UNIT * samples.row("distance_places", body), samples.row("distances", body)
    points = samples.row("points", body).astype(float)
    on = cKDTree(np.concatenate([places[ON], points[:, :3]]))
    deepest = np.argsort(distances.ravel(), kind="stable")[:_DEEPEST]
    half = 0.5 * np.median(_covered(points, places[[EVEN, NEAR]].reshape(-1, 3)[deepest]))

    def field(at: np.ndarray) -> np.ndarray:
        return np.where(_covered(points, at) > half, -1.0, 1.0) * on.query(at)[0]

    return field


def _covered(points: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the winding number at places (n, 3), but for a factor, of points with normals (p, 6)."""
    found = np.empty(len(at))
    for start in range(0, len(at), _TOGETHER):
        away = points[:, :3] - at[start : start + _TOGETHER, None]
        cubes = np.maximum(np.einsum("npk,npk->np", away, away), 1e-8) ** 1.5
        found[start : start + _TOGETHER] = (np.einsum("npk,pk->np", away, points[:, 3:]) / cubes).mean(axis=1)
    return found


def on_lattice(distance: np.ndarray, cells: int) -> Field:
    """Return distances at a lattice's points as a field, linear in between."""
    axis = np.linspace(-1.0, 1.0, cells + 1)
    return RegularGridInterpolator(
        (axis,) * 3, distance.reshape((cells + 1,) * 3), bounds_error=False, fill_value=1.0
    )


def read(path: Path) -> dict[str, np.ndarray]:
    """Return a part of what was found, as :func:`all_sought` gives it."""
    with np.load(path) as arrays:
        return dict(arrays)


def joined(task, parts: list[dict]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return sides that hold the bodies of all parts alone, as tested, and their answers (n, target, …)."""
    parts = [part for part in parts if len(part["body"])]
    found = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    numbers = {name: number for number, name in enumerate(task.samples.ids)}
    bodies = np.array([numbers[name] for name in found.pop("body")])
    return {side: bodies if side == TEST else bodies[:0] for side in task.sides}, found


def all_sought(task, bodies: np.ndarray, settings: Settings, work: Path) -> dict[str, np.ndarray]:
    """Return what :func:`sought` does for bodies (n,), each array (n, target, …), and their names ``body`` (n,).

    A body that is done lies in the folder ``work``, so an interrupted search goes on with the next.
    """
    rows = []
    for body in bodies:
        done = work / f"{task.samples.ids[body].replace(' ', '-')}.npz"
        if not done.exists():
            found = sought(task, int(body), settings)
            partial = done.with_suffix(".partial.npz")
            np.savez(partial, **found)
            partial.replace(done)
            print(
                f"{task.samples.ids[body]}: loss of the spectrum {found['loss_first'][0]:.3g} to "
                f"{found['loss_least'][0]:.3g} in {found['search_seconds'][0]:.0f} s",
                flush=True,
            )
        with np.load(done) as arrays:
            rows.append(dict(arrays))
    names = np.array([task.samples.ids[body] for body in bodies], dtype=str)
    return {
        "body": names,
        **({name: np.stack([row[name] for row in rows]) for name in rows[0]} if rows else {}),
    }
