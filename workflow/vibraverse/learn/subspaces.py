"""Rayleigh–Ritz at points inside bodies, in PyTorch: polynomials, strains, energies, and their derivatives.

Integrals are means over points that are uniform inside a body, times its volume, which cancels in all frequencies. The
unit of length is the cube root of the volume, and ``E = ρ = 1``, so the square roots of the values are dimensionless
frequencies ``ω̂``.
"""

from __future__ import annotations

import torch

from vibraverse.learn.baselines.polynomials import exponents
from vibraverse.physics.materials import lame

#: Rigid motions, which every space here holds.
RIGID = 6
#: Directions of less than this share of the largest are rounding errors of single precision, and are left out.
_ROUNDING_SHARE = 1e-9


def polynomials(places: torch.Tensor, degree: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return products ``P_i P_j P_k`` (…, s) with ``i + j + k <= degree`` at places (…, 3), and gradients (…, 3, s).

    The gradients are by the coordinates of the places, which should lie in [-1, 1]³.
    """
    values, slopes = [torch.ones_like(places), places], [torch.zeros_like(places), torch.ones_like(places)]
    for n in range(1, degree):
        values.append(((2 * n + 1) * places * values[n] - n * values[n - 1]) / (n + 1))
        slopes.append((2 * n + 1) * values[n] + slopes[n - 1])
    table, sloped = torch.stack(values, dim=-1), torch.stack(slopes, dim=-1)
    chosen = torch.from_numpy(exponents(degree)).to(places.device)
    factors = [table[..., axis, :][..., chosen[:, axis]] for axis in range(3)]
    x, y, z = factors
    dx, dy, dz = (sloped[..., axis, :][..., chosen[:, axis]] for axis in range(3))
    return x * y * z, torch.stack([dx * y * z, x * dy * z, x * y * dz], dim=-2)


def in_all_directions(scalars: torch.Tensor) -> torch.Tensor:
    """Return scalar functions (…, s) as displacements (…, 3, 3s) along each axis."""
    found = scalars[..., None, :, None] * torch.eye(3, dtype=scalars.dtype, device=scalars.device)[:, None]
    return found.flatten(-2)


def strains(gradients: torch.Tensor, poisson: torch.Tensor) -> torch.Tensor:
    """Return (B, 7q, n) whose products are the elastic energy, from ∂_a u_b (B, q, a, b, n) and ν (B,).

    ``λ (div u)² + 2μ ε:ε`` is a sum of seven squares.
    """
    lam, mu = (one.to(gradients.dtype)[:, None, None] for one in lame(1.0, poisson))
    pairs = ((0, 1), (1, 2), (2, 0))
    stretches = [gradients[:, :, axis, axis] for axis in range(3)]
    shears = [gradients[:, :, a, b] + gradients[:, :, b, a] for a, b in pairs]
    rows = [lam.sqrt() * sum(stretches)]
    rows += [(2 * mu).sqrt() * one for one in stretches] + [mu.sqrt() * one for one in shears]
    return torch.cat(rows, dim=1)


def lowest(stretched: torch.Tensor, moved: torch.Tensor, count: int) -> torch.Tensor:
    """Return the lowest elastic Ritz vectors (B, n, count).

    Energies are ``stretchedᵀ stretched`` and masses ``movedᵀ moved``, with factors (B, rows, n) in float64. Directions
    that are rounding errors are left out, and the six rigid motions too.
    """
    mass = moved.mT @ moved
    scale = mass.diagonal(dim1=-2, dim2=-1).clamp_min(torch.finfo(mass.dtype).tiny).rsqrt()
    weights, directions = torch.linalg.eigh(scale[:, :, None] * mass * scale[:, None])
    kept = weights > _ROUNDING_SHARE * weights[:, -1:]
    turn = scale[:, :, None] * directions * torch.where(kept, weights.abs().rsqrt(), 0.0)[:, None]
    small = stretched @ turn
    energy = small.mT @ small
    # A direction that is left out is stiffer than all others, so it comes last.
    stiff = 2.0 * energy.diagonal(dim1=-2, dim2=-1).sum(dim=-1, keepdim=True) + 1.0
    _, vectors = torch.linalg.eigh(energy + torch.diag_embed(torch.where(kept, 0.0, stiff)))
    return turn @ vectors[:, :, RIGID : RIGID + count]


def spectra(stretched: torch.Tensor, moved: torch.Tensor, count: int) -> torch.Tensor:
    """Return the logarithms of the lowest dimensionless frequencies (B, count), with derivatives.

    The Ritz vectors are found without derivatives. With them held fixed, the derivative of ``cᵀKc / cᵀMc`` is that of
    the Ritz value (Hellmann and Feynman), and in a cluster any vectors give that of the sum.
    """
    with torch.no_grad():
        vectors = lowest(stretched.double(), moved.double(), count)
    energy = (stretched.double() @ vectors).square().sum(dim=1)
    mass = (moved.double() @ vectors).square().sum(dim=1)
    return 0.5 * (energy / mass).log()
