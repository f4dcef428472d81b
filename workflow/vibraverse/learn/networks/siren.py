"""SIREN: fully connected layers with sines (Sitzmann et al. 2020)."""

from __future__ import annotations

import math

import torch
from torch import nn

#: The frequency of the sines. It is meant for inputs in [-1, 1]: features must be normalised before.
OMEGA = 30.0


class Sine(nn.Module):
    """A linear layer followed by ``sin(30 x)``, with the weights that keep the distribution of its outputs."""

    def __init__(self, inputs: int, outputs: int, first: bool = False):
        super().__init__()
        self.linear = nn.Linear(inputs, outputs)
        bound = 1.0 / inputs if first else math.sqrt(6.0 / inputs) / OMEGA
        nn.init.uniform_(self.linear.weight, -bound, bound)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return (…, outputs)."""
        return torch.sin(OMEGA * self.linear(values))


class Siren(nn.Module):
    """``layers`` sine layers of a width, then a linear one: (…, inputs) to (…, outputs).

    With ``normalised`` inputs pass a layer normalisation first, since features of other networks have any scale.
    """

    def __init__(self, inputs: int, width: int, layers: int, outputs: int, normalised: bool = True):
        super().__init__()
        self.norm = nn.LayerNorm(inputs) if normalised else nn.Identity()
        sizes = [inputs, *[width] * layers]
        self.sines = nn.Sequential(
            *(
                Sine(before, after, number == 0)
                for number, (before, after) in enumerate(zip(sizes, sizes[1:], strict=False))
            )
        )
        self.last = nn.Linear(width, outputs)
        bound = math.sqrt(6.0 / width) / OMEGA
        nn.init.uniform_(self.last.weight, -bound, bound)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return (…, outputs)."""
        return self.last(self.sines(self.norm(values)))
