"""The samples of a dataset: the features of all its shards as one table of bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vibraverse.contract.products import read_json

#: Name of the record in a folder of features.
RECORD = "features.json"
#: Arrays with a row per object, which both its bodies share.
_OF_OBJECTS = ("views", "voxels", "farthest")


@dataclass(frozen=True)
class Layout:
    """What the features of a training were like: points of a body, modes of a spectrum, Poisson's ratios, materials."""

    points: int
    modes: int
    poisson_range: tuple[float, float]
    poisson_nodes: int
    ritz_degrees: list[int]
    ritz_unknowns: list[int]
    materials: dict[str, dict[str, float]]


class Samples:
    """The bodies of a dataset, sorted by object, the solid one first; arrays are memory-mapped.

    ``object``, ``solidity``, ``origin`` and ``family`` are arrays of texts (n,). ``original`` is the object that a
    body's object is a copy of, or that object itself; :meth:`know_copies` says which. ``materials`` maps names to their
    parameters, ``poisson`` (k,) are the ratios at which ``log_omega`` and ``ritz`` are known, ``ritz_degrees`` and
    ``ritz_unknowns`` the polynomials and splines in ``ritz``, one after the other. ``voxel_points`` is the number of
    points among which ``farthest`` were chosen. :meth:`rows` reads any array of
    :data:`vibraverse.learn.features.ARRAYS`.

    Raises :class:`ValueError` for features that do not belong together, or hold no body.
    """

    def __init__(self, folders: Sequence[str | Path]):
        records = {Path(folder): read_json(Path(folder) / RECORD) for folder in folders}
        records = {folder: record for folder, record in records.items() if record["objects"]}
        if not records:
            raise ValueError(
                "no object of the dataset has a body; `vibraverse refusals` says why all are refused"
            )
        self.folders, records = list(records), list(records.values())
        for folder, record in zip(self.folders, records, strict=True):
            for what in ("materials", "poisson", "ritz_degrees", "ritz_unknowns", "voxel_points"):
                if record[what] != records[0][what]:
                    raise ValueError(
                        f"{folder} holds other {what} than {self.folders[0]}; run the same command again, which makes "
                        "the features that are out of date"
                    )
        self.materials: dict[str, dict[str, float]] = records[0]["materials"]
        self.poisson = np.array(records[0]["poisson"])
        self.ritz_degrees: list[int] = records[0]["ritz_degrees"]
        self.ritz_unknowns: list[int] = records[0]["ritz_unknowns"]
        self.voxel_points: int = records[0]["voxel_points"]
        names = ("object", "solidity", "origin", "family")
        columns = {name: np.concatenate([one["bodies"][name] for one in records]) for name in names}
        counts = [len(one["bodies"]["object"]) for one in records]
        order = np.lexsort((columns["solidity"] == "hollow", columns["object"]))
        self.object, self.solidity, self.origin, self.family = (columns[name][order] for name in names)
        self.original = self.object
        self._shard = np.repeat(np.arange(len(counts)), counts)[order]
        self._row = np.concatenate([np.arange(count) for count in counts])[order]
        self._maps: dict[str, list[np.ndarray]] = {}

    def __len__(self) -> int:
        return len(self.object)

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_maps": {}}  # workers map the files themselves

    def know_copies(self, copy_of: Mapping[str, str]) -> None:
        """Learn which objects are copies of others; ``copy_of`` maps an object to its original, "" for none."""
        self.original = np.array([copy_of[one] or one for one in self.object.tolist()])

    def row(self, name: str, body: int) -> np.ndarray:
        """Return a body's row of an array, or that of its object."""
        shard, row = self._shard[body], self._row[body]
        if name in _OF_OBJECTS:
            row = self._map("object_row")[shard][row]
        return self._map(name)[shard][row]

    def rows(self, name: str, bodies: Sequence[int] | None = None) -> np.ndarray:
        """Return the rows of some bodies, or of all, in their order."""
        chosen = range(len(self)) if bodies is None else bodies
        return np.stack([self.row(name, int(body)) for body in chosen])

    def layout(self) -> Layout:
        """Return what the features of another body must be like for a network of these samples."""
        ratios, modes = self.poisson.tolist(), self.row("log_omega", 0).shape[-1]
        return Layout(
            points=len(self.row("points", 0)),
            modes=modes,
            poisson_range=(ratios[0], ratios[-1]),
            poisson_nodes=len(ratios),
            ritz_degrees=self.ritz_degrees,
            ritz_unknowns=self.ritz_unknowns,
            materials=self.materials,
        )

    def tetrahedra(self, body: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a body's tetrahedra, points (N, 3) and cells (T, 4), and what is known of the points (N, 1 + h).

        They stand in the body's own frame, see :mod:`vibraverse.learn.inside`.
        """
        shard = self._shard[body]
        first, points, cell, cells = self.row("mesh_rows", body)
        parts = {"mesh_points": (first, points), "mesh_cells": (cell, cells), "mesh_fields": (first, points)}
        found = [
            np.array(self._map(name)[shard][start : start + count]) for name, (start, count) in parts.items()
        ]
        return found[0], found[1], found[2]

    @cached_property
    def ids(self) -> list[str]:
        """The bodies' names for messages: ``mug-0003 hollow``."""
        return [f"{one} {body}" for one, body in zip(self.object, self.solidity, strict=True)]

    def _map(self, name: str) -> list[np.ndarray]:
        if name not in self._maps:
            maps = (np.load(folder / f"{name}.npy", mmap_mode="r") for folder in self.folders)
            # Rows of np.memmap itself take several times as long.
            self._maps[name] = [np.asarray(one) for one in maps]
        return self._maps[name]


class Unsimulated(Samples):
    """One body without a simulation: what follows from its shape, and not a number where a frequency would be.

    ``shape`` are its rows of :func:`vibraverse.learn.features.shape_arrays`.
    """

    def __init__(
        self,
        shape: Mapping[str, np.ndarray],
        volume_m3: float,
        layout: Layout,
        materials: Mapping[str, Mapping],
    ):
        self.materials = dict(materials)
        self.ritz_degrees, self.ritz_unknowns = layout.ritz_degrees, layout.ritz_unknowns
        self.poisson = np.linspace(*layout.poisson_range, layout.poisson_nodes)
        self.object = self.solidity = self.origin = self.family = np.array([""])
        self._rows = {
            **shape,
            "volume_m3": np.float64(volume_m3),
            "log_omega": np.full((layout.poisson_nodes, layout.modes), np.nan, dtype=np.float32),
            "frequencies_hz": np.full((len(materials), layout.modes), np.nan),
        }

    def row(self, name: str, body: int) -> np.ndarray:
        """Return the body's row of an array."""
        return self._rows[name]


def at(results: str | Path) -> Samples:
    """Return the samples of a results folder; raise :class:`FileNotFoundError` if it holds no features."""
    folders = sorted(path.parent for path in Path(results).glob(f"learn/features/*/{RECORD}"))
    if not folders:
        raise FileNotFoundError(
            f"{results} holds no features; make them with `snakemake learn` and the run's configuration"
        )
    return Samples(folders)
