"""Fully connected networks: of materials, of spectra, of anything that is a few numbers."""

from __future__ import annotations

from torch import nn


def dense(inputs: int, width: int, layers: int, outputs: int) -> nn.Sequential:
    """Return ``layers`` fully connected layers of a width with GELU, then a linear one: (…, inputs) to (…, outputs)."""
    sizes = [inputs, *[width] * layers]
    parts: list[nn.Module] = []
    for before, after in zip(sizes, sizes[1:], strict=False):
        parts += [nn.Linear(before, after), nn.GELU()]
    return nn.Sequential(*parts, nn.Linear(sizes[-1], outputs))


def material_network(width: int = 32) -> nn.Sequential:
    """Return the network of a scaled material (…, 3) to (…, width)."""
    return dense(3, width, 1, width)
