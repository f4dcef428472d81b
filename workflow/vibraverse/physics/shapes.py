"""Mode shapes from their coefficients in the modal basis, with NumPy alone, for readers of a dataset."""

from __future__ import annotations

import numpy as np


def mode_shapes(surface: np.ndarray, corrections: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return mode shapes (m, V, 3) on the surface in kg^(-1/2), in the precision of ``surface``.

    ``surface`` (V, 3, r) and ``corrections`` (V, 3, c) are those of a
    :class:`vibraverse.physics.reduced.ModalBasis`, or a selection of their vertices. ``coefficients`` are (m, r), or
    (m, r + c) with corrections.
    """
    rank = surface.shape[2]
    shapes = _combined(surface, coefficients[:, :rank])
    if coefficients.shape[1] > rank:
        shapes += _combined(corrections, coefficients[:, rank:])
    return shapes


def _combined(fields: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    flat = fields.reshape(-1, fields.shape[2])
    return (coefficients.astype(flat.dtype) @ flat.T).reshape(-1, *fields.shape[:2])
