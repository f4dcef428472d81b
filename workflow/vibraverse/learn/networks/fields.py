"""A neural field that proposes displacements inside a body, with their derivatives.

A place inside is a few numbers: its coordinates and some smooth functions of the body. A set of places tells what the
body looks like: its code is a mean and a maximum over them. The code sets scale and shift of every layer, so each body
has its own fields. Derivatives by the place go through the layers beside the values, so none is approximated.
"""

from __future__ import annotations

import math

import torch
from torch import nn

from vibraverse.learn.networks.dense import dense

#: Numbers that describe a body.
_CODE = 64
#: Spread of the first layer's weights; with small ones all fields are alike.
_FIRST = 2.0


class BodyCode(nn.Module):
    """Places with their numbers (B, q, k), and numbers of the whole body (B, s), to codes (B, 64)."""

    def __init__(self, inputs: int, scalars: int, width: int):
        super().__init__()
        self.each = dense(inputs, width, 1, width)
        self.whole = dense(2 * width + scalars, width, 1, _CODE)

    def forward(self, places: torch.Tensor, scalars: torch.Tensor) -> torch.Tensor:
        """Return the codes."""
        each = self.each(places)
        return self.whole(torch.cat([each.mean(dim=1), each.amax(dim=1), scalars], dim=-1))


class Fields(nn.Module):
    """``fields`` displacements at places (B, q, k) of bodies with codes (B, 64)."""

    def __init__(self, inputs: int, width: int, layers: int, fields: int):
        super().__init__()
        sizes = [inputs, *[width] * layers]
        pairs = list(zip(sizes, sizes[1:], strict=False))
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairs)
        self.bodies = nn.ModuleList(nn.Linear(_CODE, 2 * width) for _ in pairs)
        self.last = nn.Linear(width + inputs, 3 * fields, bias=False)
        nn.init.normal_(self.layers[0].weight, std=_FIRST / math.sqrt(inputs))
        nn.init.uniform_(self.layers[0].bias, -_FIRST, _FIRST)

    def forward(
        self, codes: torch.Tensor, places: torch.Tensor, gradients: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Return the displacements (B, q, 3, fields), and their derivatives (B, q, a, 3, fields) along each axis a.

        ``gradients`` (B, q, 3, k) are those of the places' numbers; without them there are no derivatives.
        """
        values, slopes = places, gradients
        for number, (layer, body) in enumerate(zip(self.layers, self.bodies, strict=True)):
            scale, shift = body(codes)[:, None].chunk(2, dim=-1)
            before = layer(values) * (1 + scale) + shift
            after = nn.functional.gelu(before)
            if slopes is not None:
                moved = (slopes @ layer.weight.mT) * ((1 + scale) * _gelu_slope(before))[:, :, None]
                slopes = moved + slopes if number else moved
            values = after + values if number else after
        values = self._fields(torch.cat([values, places], dim=-1))
        if slopes is not None:
            slopes = self._fields(torch.cat([slopes, gradients], dim=-1))
        return values, slopes

    def _fields(self, hidden: torch.Tensor) -> torch.Tensor:
        return self.last(hidden).unflatten(-1, (3, -1))


def _gelu_slope(values: torch.Tensor) -> torch.Tensor:
    """Return the derivative of GELU."""
    below = 0.5 * (1.0 + torch.erf(values / math.sqrt(2.0)))
    return below + values * torch.exp(-0.5 * values.square()) / math.sqrt(2.0 * math.pi)
