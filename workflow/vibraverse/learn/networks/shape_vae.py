"""The shape network of reconstruction: a variational autoencoder of sets of latent tokens, told what is heard.

Points on the surface of a coarse body become latent tokens: the farthest of the points look at all of them, then at
each other. The tokens pass a narrow normal distribution. Sound and material join them as one token each, and places in
space look at all tokens to find the signed distance there.

The architecture is that of 3DShape2VecSet (Zhang et al., ACM Trans. Graph. 42, 92, 2023) in the sizes that the
VibraVerse paper took over from Step1X-3D (arXiv 2505.07747), written from their descriptions.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import nn

from vibraverse.learn.networks.attention import CrossBlock, SelfBlock

#: Octaves of the Fourier features of a place: 1, 2, …, 128, without π.
_OCTAVES = 8
#: Numbers of a place: itself, then sine and cosine of each coordinate in each octave.
_PLACE = 3 + 2 * 3 * _OCTAVES
#: Channels of the bottleneck.
BOTTLENECK = 64
#: Bounds of the logarithm of the variance, against overflow.
_LOG_VARIANCE = (-30.0, 20.0)


class ShapeVae(nn.Module):
    """Surface points with normals, and what else is known, to signed distances.

    ``network`` is a :class:`vibraverse.config.learn.Network`. ``known`` maps the names of further inputs to their
    numbers of values; each becomes a token.
    """

    def __init__(self, network, known: Mapping[str, int]):
        super().__init__()
        width, self.latents = network.width, network.latents
        self.point = nn.Linear(_PLACE + 3, width)
        self.gather = CrossBlock(width)
        self.encoder = nn.ModuleList(SelfBlock(width) for _ in range(network.encoder_blocks))
        self.encoded = nn.LayerNorm(width)
        self.narrow, self.widen = nn.Linear(width, 2 * BOTTLENECK), nn.Linear(BOTTLENECK, width)
        self.known = nn.ModuleDict({name: nn.Linear(values, width) for name, values in known.items()})
        self.decoder = nn.ModuleList(SelfBlock(width) for _ in range(network.decoder_blocks))
        self.place = nn.Linear(_PLACE, width)
        self.look = CrossBlock(width)
        self.last = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))

    def encode(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and logarithm of the variance (B, latents, 64) of bodies given as points with normals (B, p, 6).

        The first points are those that become tokens, so they should be far from each other.
        """
        seen = self.point(torch.cat([fourier(points[..., :3]), points[..., 3:]], dim=-1))
        tokens = self.gather(seen[:, : self.latents], seen)
        for block in self.encoder:
            tokens = block(tokens)
        mean, log_variance = self.narrow(self.encoded(tokens)).chunk(2, dim=-1)
        return mean, log_variance.clamp(*_LOG_VARIANCE)

    def decode(self, latent: torch.Tensor, batch: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the tokens (B, latents + known, width) of latents (B, latents, 64) with what is known."""
        joined = [self.widen(latent)]
        joined += [network(batch[name])[:, None] for name, network in self.known.items()]
        tokens = torch.cat(joined, dim=1)
        for block in self.decoder:
            tokens = block(tokens)
        return tokens

    def distances(self, tokens: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """Return the values (B, q) at places (B, q, 3); those of one place do not depend on the other places."""
        return self.last(self.look(self.place(fourier(places)), tokens))[..., 0].float()

    def forward(self, batch: Mapping[str, torch.Tensor]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the values (B, q) at ``places``, and the mean over tokens and channels of the divergence (B,).

        In training the latents are drawn from their distribution; otherwise they are its mean.
        """
        mean, log_variance = self.encode(batch["cloud"])
        latent = mean
        if self.training:
            latent = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        found = self.distances(self.decode(latent, batch), batch["places"])
        divergence = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance)
        return found, divergence.float().mean(dim=(1, 2))


def fourier(places: torch.Tensor) -> torch.Tensor:
    """Return the Fourier features (…, 51) of places (…, 3)."""
    octaves = 2.0 ** torch.arange(_OCTAVES, dtype=places.dtype, device=places.device)
    angles = (places[..., None] * octaves).flatten(-2)
    return torch.cat([places, angles.sin(), angles.cos()], dim=-1)
