"""The lines of a hollow body as functions of Poisson's ratio and of its wall, from bodies with a few walls.

The sorted frequencies change smoothly with the wall, so a cubic spline through a few solved bodies predicts the ones
between. How far it is from a solved body when that one is left out tells its error.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline

from vibraverse.listening.resonances import Lines, Table

#: Steps in ν and in the wall between hypotheses.
_POISSON_STEP, _WALL_STEP = 0.02, 0.01
#: An interpolation error falls as the fourth power of the distance of the bodies, which doubles where one is left out.
_LEFT_OUT = 1 / 16


class Walls:
    """Lines by (ν, t), where t is the wall as a share of the depth of the deepest point; a searchable model."""

    def __init__(self, tables: Mapping[float, Table]):
        walls = np.array(sorted(tables))
        if len(walls) < 4:
            raise ValueError(f"a spline over the wall takes four bodies or more, not {len(walls)}")
        self._tables = [tables[wall] for wall in walls]
        self._weights = CubicSpline(walls, np.eye(len(walls)))
        self._slope = self._weights.derivative()
        self.bounds = np.vstack([self._tables[0].bounds, walls[[0, -1]]])
        middle = self.bounds[:1].mean(axis=1)
        solved = np.array([table.at(middle).log_omega for table in self._tables])
        self._error = np.hypot(
            _left_out(walls, solved), np.mean([one.at(middle).error for one in self._tables], 0)
        )

    def at(self, parameters: np.ndarray) -> Lines:
        """Return the lines at ``parameters`` (2,): ν and t."""
        poisson, wall = parameters
        weights, slopes = self._weights(wall), self._slope(wall)
        lines = [table.at(np.array([poisson])) for table in self._tables]
        values, along = (
            np.array([one.log_omega for one in lines]),
            np.array([one.slopes[:, 0] for one in lines]),
        )
        return Lines(weights @ values, np.column_stack([weights @ along, slopes @ values]), self._error)

    def grid(self, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return hypotheses (r, 2) within bounds (2, 2), and ``log ω̂`` (r, m) there."""
        poissons, walls = (
            np.linspace(low, high, 1 + int(np.ceil((high - low) / step)))
            for (low, high), step in zip(bounds, (_POISSON_STEP, _WALL_STEP), strict=True)
        )
        solved = np.array(
            [[table.at(np.array([one])).log_omega for one in poissons] for table in self._tables]
        )
        combs = np.einsum("wt,tpm->pwm", self._weights(walls), solved)
        places = np.stack(np.meshgrid(poissons, walls, indexing="ij"), axis=-1)
        return places.reshape(-1, 2), np.sort(combs.reshape(len(poissons) * len(walls), -1), axis=1)


def _left_out(walls: np.ndarray, solved: np.ndarray) -> np.ndarray:
    """Return the error (m,) of a spline through ``solved`` (t, m), from what it misses if it lacks an inner body."""
    missed = []
    for i in range(1, len(walls) - 1):
        others = np.delete(np.arange(len(walls)), i)
        missed.append(CubicSpline(walls[others], solved[others])(walls[i]) - solved[i])
    return _LEFT_OUT * np.sqrt(np.mean(np.square(missed), axis=0))
