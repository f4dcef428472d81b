"""Base class of the shape families: a frozen dataclass of parameters with ranges, and a builder."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import ClassVar

import numpy as np

from vibraverse.contract.seeds import rng

#: Coordinates are rounded to a nanometre, so that processors with different rounding give the same bytes.
_DIGITS = 9


def between(low, high):
    """Return the field of a parameter drawn uniformly from [low, high]; an integer if both ends are."""
    return field(metadata={"between": (low, high)})


def one_of(*values):
    """Return the field of a parameter drawn from ``values``."""
    return field(metadata={"one_of": values})


@dataclass(frozen=True)
class Shape:
    """Base of all families. Lengths are relative to the shape unless the name of the field says metres.

    Every family has ``size_m``, the natural length of its longest side in metres, drawn log-uniformly.
    """

    size_m: float

    size_range_m: ClassVar[tuple[float, float]]

    def build(self):
        """Return ``(vertices, faces)`` in the family's own units, closed and oriented outwards."""
        raise NotImplementedError


def draw(family: type[Shape], object_: str) -> Shape:
    """Draw the parameters of a family; each has its own seed, so a new parameter changes no other."""
    values = {}
    for parameter in fields(family):
        random = rng(object_, "shape", parameter.name)
        if parameter.name == "size_m":
            low, high = np.log(family.size_range_m)
            values["size_m"] = _short(np.exp(random.uniform(low, high)))
        elif "one_of" in parameter.metadata:
            choices = parameter.metadata["one_of"]
            values[parameter.name] = choices[random.integers(len(choices))]
        else:
            low, high = parameter.metadata["between"]
            whole = isinstance(low, int) and isinstance(high, int)
            values[parameter.name] = (
                int(random.integers(low, high + 1)) if whole else _short(random.uniform(low, high))
            )
    return family(**values)


def in_metres(vertices: np.ndarray, size_m: float) -> np.ndarray:
    """Return points (N, 3) centred at the origin, their longest side ``size_m``, rounded to a nanometre."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2) * (size_m / (high - low).max())
    return np.round(vertices, _DIGITS) + 0.0  # no negative zeros


def _short(value: float) -> float:
    """Return a number rounded to four digits, so that the record states exactly what was built."""
    return float(f"{value:.4g}")
