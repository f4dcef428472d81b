"""Attention blocks on sets of tokens, with PyTorch's own attention.

Layers are normalised before attention and network (pre-LN), keys, queries and values have no bias, and heads have 64
channels.
"""

from __future__ import annotations

import torch
from torch import nn

#: Channels of a head; a width is a multiple of it.
HEAD = 64
#: Width of a block's network over that of its tokens.
_EXPANSION = 4


class Attention(nn.Module):
    """Tokens (B, n, width) look at others (B, m, width)."""

    def __init__(self, width: int):
        super().__init__()
        self.heads = width // HEAD
        self.queries = nn.Linear(width, width, bias=False)
        self.keys_values = nn.Linear(width, 2 * width, bias=False)
        self.last = nn.Linear(width, width)

    def forward(self, tokens: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Return (B, n, width)."""
        keys, values = map(self._split, self.keys_values(others).chunk(2, dim=-1))
        found = nn.functional.scaled_dot_product_attention(self._split(self.queries(tokens)), keys, values)
        return self.last(found.transpose(1, 2).flatten(2))

    def _split(self, tokens: torch.Tensor) -> torch.Tensor:
        return tokens.unflatten(-1, (self.heads, HEAD)).transpose(1, 2)


class SelfBlock(nn.Module):
    """Tokens (B, n, width) look at each other, then each passes a network of two layers."""

    def __init__(self, width: int):
        super().__init__()
        self.before = nn.LayerNorm(width)
        self.attention = Attention(width)
        self.each = _network(width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, n, width)."""
        normalised = self.before(tokens)
        tokens = tokens + self.attention(normalised, normalised)
        return tokens + self.each(tokens)


class CrossBlock(nn.Module):
    """Tokens (B, n, width) look at others (B, m, width), then each passes a network of two layers."""

    def __init__(self, width: int):
        super().__init__()
        self.before, self.before_others = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(width)
        self.each = _network(width)

    def forward(self, tokens: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Return (B, n, width)."""
        tokens = tokens + self.attention(self.before(tokens), self.before_others(others))
        return tokens + self.each(tokens)


def _network(width: int) -> nn.Sequential:
    inner = _EXPANSION * width
    return nn.Sequential(nn.LayerNorm(width), nn.Linear(width, inner), nn.GELU(), nn.Linear(inner, width))
