"""A network that corrects approximate spectra: convolutions along the modes.

Each mode has a few numbers: how far its approximations are from each other and from those of its neighbours. How far
they are from the truth follows from that in much the same way for all modes and bodies, so one small network serves
all. What is known of the body as a whole scales and shifts its hidden values.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

#: Neighbours that a convolution sees: two on each side.
_KERNEL = 5


class Corrector(nn.Module):
    """Approximate spectra (B, d, m), coarse to fine, and a vector of the body (B, c) to corrections (B, m).

    All spectra are logarithms. ``known`` (n, d, m) are those that the network is trained on: their mean is taken off,
    and what each mode has to tell is brought to one spread. In each layer the vector of the body scales and shifts the
    hidden values (FiLM, Perez et al. 2018).
    """

    def __init__(self, known: np.ndarray, body: int, width: int, layers: int):
        super().__init__()
        known = torch.tensor(known, dtype=torch.float32)
        self.register_buffer("mean", known.mean(dim=0))
        self.register_buffer("spread", _parts(known - self.mean).std(dim=(0, 2))[:, None] + 1e-6)
        self.register_buffer("place", torch.linspace(-1.0, 1.0, known.shape[-1])[None, None])
        sizes = [len(self.spread) + 1, *[width] * layers]
        self.layers = nn.ModuleList(
            nn.Conv1d(before, after, _KERNEL, padding=_KERNEL // 2, padding_mode="replicate")
            for before, after in zip(sizes, sizes[1:], strict=False)
        )
        self.bodies = nn.ModuleList(nn.Linear(body, 2 * width) for _ in range(layers))
        self.last = nn.Conv1d(width, 1, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, spectra: torch.Tensor, body: torch.Tensor) -> torch.Tensor:
        """Return the corrections (B, m); an untrained network gives zeros."""
        parts = _parts(spectra - self.mean) / self.spread
        hidden = torch.cat([parts, self.place.expand(len(spectra), -1, -1)], dim=1)
        for number, (layer, of_body) in enumerate(zip(self.layers, self.bodies, strict=True)):
            scale, shift = of_body(body)[:, :, None].chunk(2, dim=1)
            found = nn.functional.gelu(layer(hidden) * (1 + scale) + shift)
            hidden = found + (hidden if number else 0.0)
        return self.last(hidden)[:, 0]


def _parts(spectra: torch.Tensor) -> torch.Tensor:
    """Return spectra (B, d, m) as (B, d + 1, m): the finest, the falls to it space by space, its gaps."""
    finest = spectra[:, -1:]
    gaps = torch.diff(finest, dim=-1, append=finest[..., -1:])
    return torch.cat([finest, spectra[:, :-1] - spectra[:, 1:], gaps], dim=1)
