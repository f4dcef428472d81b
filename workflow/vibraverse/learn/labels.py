"""Exact spectra of many bodies at once, on any device: labels for materials drawn anew in every step.

The reduced operators of the modal bases are padded to one size and solved as a batch in float64, as
:func:`vibraverse.physics.modes.reduced_solve` solves those of one body. A body's padding is a stiff spring per row that
touches nothing else, so it changes no frequency below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from vibraverse.physics.materials import lame
from vibraverse.physics.reduced import GUARD, ModalBasis

#: Stiffness of a padding row, as a multiple of the largest entry of the operators.
_STIFF = 1e3


@dataclass(frozen=True)
class Operators:
    """The reduced operators of B bodies in float64, padded to r rows, with m corrections each.

    ``a_lambda``, ``a_mu`` (B, r, r); ``top_lambda``, ``top_mu``, ``mass`` (B, r, m) and ``own_lambda``, ``own_mu``
    (B, m, m) of the corrections; ``padding`` (B, r), the stiffness of the rows that a body lacks; ``volume`` (B,).
    """

    a_lambda: torch.Tensor
    a_mu: torch.Tensor
    top_lambda: torch.Tensor
    top_mu: torch.Tensor
    mass: torch.Tensor
    own_lambda: torch.Tensor
    own_mu: torch.Tensor
    padding: torch.Tensor
    volume: torch.Tensor

    def to(self, device) -> Operators:
        """Return the operators on a device."""
        return Operators(**{name: value.to(device) for name, value in vars(self).items()})

    def __getitem__(self, bodies: torch.Tensor) -> Operators:
        """Return those of some bodies, by number."""
        return Operators(**{name: value[bodies] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.volume)


def operators(bases: Sequence[ModalBasis]) -> Operators:
    """Return the operators of bases with equal numbers of modes; raise :class:`ValueError` otherwise."""
    modes = {len(basis.residuals) for basis in bases}
    if len(modes) != 1:
        raise ValueError(f"the bases have {sorted(modes)} modes; a batch needs as many of each")
    rows = max(len(basis.a_mu) for basis in bases)
    found: dict[str, list[np.ndarray]] = {}
    for basis in bases:
        rank = len(basis.a_mu)
        largest = max(np.abs(basis.a_lambda).max(), np.abs(basis.a_mu).max())
        padding = np.zeros(rows)
        padding[rank:] = _STIFF * largest
        for name, value in {
            "a_lambda": _padded(basis.a_lambda, rows, rows),
            "a_mu": _padded(basis.a_mu, rows, rows),
            "top_lambda": _padded(basis.correction_lambda[:rank], rows),
            "top_mu": _padded(basis.correction_mu[:rank], rows),
            "mass": _padded(basis.correction_mass, rows),
            "own_lambda": basis.correction_lambda[rank:],
            "own_mu": basis.correction_mu[rank:],
            "padding": padding,
            "volume": np.float64(basis.volume),
        }.items():
            found.setdefault(name, []).append(value)
    return Operators(**{name: torch.from_numpy(np.stack(values)) for name, values in found.items()})


def spectra(batch: Operators, poisson: torch.Tensor, modes: int, corrected: bool = True) -> torch.Tensor:
    """Return the dimensionless frequencies (B, m) of the bodies at Poisson's ratios (B,), in float64.

    They equal those of :func:`vibraverse.physics.modes.solve_material` for E = ρ = 1, times the cube root of the
    volume.
    """
    lam, mu = (one.to(torch.float64) for one in lame(1.0, poisson))
    lam, mu = lam[:, None, None], mu[:, None, None]
    stiffness = lam * batch.a_lambda + mu * batch.a_mu + torch.diag_embed(batch.padding)
    values, vectors = torch.linalg.eigh(stiffness)
    if corrected:
        kept = min(modes + GUARD, values.shape[-1])
        values = _corrected(batch, lam, mu, values[:, :kept], vectors[:, :, :kept])
    return values[:, :modes].sqrt() * batch.volume[:, None] ** (1 / 3)


def _corrected(batch: Operators, lam, mu, values: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Return ω̂² with the corrections, lowest first (see :func:`vibraverse.physics.reduced.solve_corrected`)."""
    side = vectors.mT @ (lam * batch.top_lambda + mu * batch.top_mu)
    link = vectors.mT @ batch.mass
    own = lam * batch.own_lambda + mu * batch.own_mu
    stiffness = torch.cat(
        [torch.cat([torch.diag_embed(values), side], -1), torch.cat([side.mT, own], -1)], -2
    )
    ones = [
        torch.eye(size, dtype=values.dtype, device=values.device)
        for size in (values.shape[-1], link.shape[-1])
    ]
    here, there = (one.expand(len(values), *one.shape) for one in ones)
    weight = torch.cat([torch.cat([here, link], -1), torch.cat([link.mT, there], -1)], -2)
    # S x = θ W x becomes an ordinary problem with the Cholesky factor of W.
    factor = torch.linalg.cholesky(weight)
    half = torch.linalg.solve_triangular(factor, stiffness, upper=False)
    ordinary = torch.linalg.solve_triangular(factor, half.mT, upper=False)
    return torch.linalg.eigvalsh(0.5 * (ordinary + ordinary.mT))


def _padded(matrix: np.ndarray, rows: int, columns: int | None = None) -> np.ndarray:
    """Return a matrix with zero rows, and zero columns, added at its end."""
    columns = matrix.shape[1] if columns is None else columns
    return np.pad(matrix, ((0, rows - matrix.shape[0]), (0, columns - matrix.shape[1])))
