"""A network that corrects approximate spectra: convolutions along the modes.

Each mode has a few numbers: how far its approximations are from each other and from those of its neighbours. How far
they are from the truth follows from that in much the same way for all modes and bodies, so one small network serves
all. What is known of the body as a whole shifts its hidden values.
"""

from __future__ import annotations

import torch
from torch import nn

#: Neighbours that a convolution sees: two on each side.
_KERNEL = 5


class Corrector(nn.Module):
    """Approximate spectra (B, d, m), coarse to fine, and a vector of the body (B, c) to corrections (B, m).

    All spectra are logarithms.
    """

    def __init__(self, approximations: int, modes: int, body: int, width: int, layers: int):
        super().__init__()
        self.register_buffer("place", torch.linspace(-1.0, 1.0, modes)[None, None])
        self.body = nn.Linear(body, width)
        sizes = [approximations + 2, *[width] * layers]
        self.layers = nn.ModuleList(
            nn.Conv1d(before, after, _KERNEL, padding=_KERNEL // 2, padding_mode="replicate")
            for before, after in zip(sizes, sizes[1:], strict=False)
        )
        self.last = nn.Conv1d(width, 1, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, spectra: torch.Tensor, body: torch.Tensor) -> torch.Tensor:
        """Return the corrections (B, m); an untrained network gives zeros."""
        finest = spectra[:, -1:]
        steps = spectra[:, :-1] - spectra[:, 1:]
        gaps = torch.diff(finest, dim=-1, append=finest[..., -1:])
        place = self.place.expand(len(spectra), -1, -1)
        hidden = torch.cat([finest, steps, gaps, place], dim=1)
        known = self.body(body)[:, :, None]
        for number, layer in enumerate(self.layers):
            found = layer(hidden) + (known if number == 0 else 0.0)
            hidden = nn.functional.gelu(found) + (hidden if number else 0.0)
        return self.last(hidden)[:, 0]
