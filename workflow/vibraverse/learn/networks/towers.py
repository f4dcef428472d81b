"""Towers: sound, picture and shape of a body to unit vectors in one space, and the loss that draws equal ones together.

The loss is InfoNCE (van den Oord et al. 2018): each body must find its own entry among all of the batch, over the
batches of all processes.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import torch
from torch import nn

from vibraverse.learn.networks.dense import dense
from vibraverse.learn.networks.octree import OctreeNetwork
from vibraverse.learn.networks.picture import SMALL, PictureNetwork
from vibraverse.learn.networks.siren import Siren
from vibraverse.learn.pools import MODALITIES

#: Width of the space.
WIDTH = 128
#: Factor of the inner products where it is fixed, and where learning it begins; the largest that is learnt.
SCALE, LARGEST_SCALE = 1 / 0.07, 100.0


class Spectrum(nn.Module):
    """Logarithms of frequencies (B, m) to vectors: their mean, which is the scale, and the distances from it.

    ``mean`` and ``spread`` (m + 1,) of these numbers normalise them.
    """

    def __init__(self, network, mean: np.ndarray, spread: np.ndarray):
        super().__init__()
        self.head = dense(len(mean), network.width, network.layers, WIDTH)
        for name, values in (("mean", mean), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, log_hz: torch.Tensor) -> torch.Tensor:
        """Return (B, 128)."""
        scale = log_hz.mean(dim=-1, keepdim=True)
        return self.head((torch.cat([scale, log_hz - scale], dim=-1) - self.mean) / self.spread)


class Shape(nn.Module):
    """Points with normals (B, p, 6), and numbers (B, k) that are known of the body, to vectors (B, 128).

    ``mean`` and ``spread`` (k,) normalise the numbers; with none the points are all that is seen.
    """

    def __init__(self, depth: int, mean: np.ndarray, spread: np.ndarray):
        super().__init__()
        self.points = OctreeNetwork(depth, WIDTH)
        self.known = dense(len(mean), WIDTH, 1, WIDTH) if len(mean) else None
        for name, values in (("mean", mean), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, points: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
        """Return (B, 128)."""
        found = self.points(points)
        return found + self.known((known - self.mean) / self.spread) if self.known else found


class Towers(nn.Module):
    """A tower for each modality, and a linear classifier of the material on the vectors of ``classified`` modalities.

    ``scale`` is learnt if ``learns_scale``.
    """

    def __init__(
        self,
        sound: nn.Module,
        image: nn.Module,
        shape: nn.Module,
        classified: tuple[str, ...],
        materials: int,
        learns_scale: bool,
    ):
        super().__init__()
        self.sound, self.image, self.shape, self.classified = sound, image, shape, classified
        self.material = nn.Linear(WIDTH, materials)
        self.log_scale = nn.Parameter(torch.tensor(math.log(SCALE)), requires_grad=learns_scale)

    def forward(self, batch: dict) -> dict[str, torch.Tensor]:
        """Return unit vectors (B, 128) of each modality, scores of the materials (B, c, M), and ``scale``."""
        found = {
            "sound": self.sound(batch["heard"]),
            "image": self.image(batch["image"]),
            "shape": self.shape(batch["points"], batch["known"]),
        }
        found = {name: nn.functional.normalize(values.float(), dim=-1) for name, values in found.items()}
        seen = torch.stack([found[name] for name in self.classified], dim=1)
        scale = self.log_scale.exp().clamp(max=LARGEST_SCALE)
        return {**found, "materials": self.material(seen).float(), "scale": scale}


def picture_network(published_size: bool) -> PictureNetwork:
    """Return the tower of pictures: VGG-16, or the small network."""
    return PictureNetwork(WIDTH, None if published_size else SMALL)


def sound_network(network, modes: int) -> Siren:
    """Return the published tower of sounds: a SIREN of the scaled frequencies (B, m)."""
    return Siren(modes, network.width, network.layers, WIDTH, normalised=False)


def contrast(
    found: dict[str, torch.Tensor],
    everything: dict[str, torch.Tensor],
    first: int,
    alike: dict[tuple[str, str], torch.Tensor],
    scale: torch.Tensor,
    symmetric: bool,
) -> torch.Tensor:
    """Return the sum over the three pairs of modalities of InfoNCE (B,), as the mean of both directions or one.

    ``found`` are unit vectors (B, d) by modality, ``everything`` those of all processes (A, d), where those of this
    process begin at row ``first``. ``alike`` (B, A) by pair is True for entries that are left out of a row's sum,
    because they are right too.
    """
    rows = torch.arange(len(found["sound"]), device=scale.device)
    total = torch.zeros(len(rows), device=scale.device)
    for one, other in combinations(MODALITIES, 2):
        left_out = alike[one, other].clone()
        left_out[rows, first + rows] = False
        parts = []
        for asked, wanted in ((one, other), (other, one)) if symmetric else ((one, other),):
            scores = scale * found[asked] @ everything[wanted].T
            scores = scores.masked_fill(left_out, -math.inf)
            parts.append(nn.functional.cross_entropy(scores, first + rows, reduction="none"))
        total = total + torch.stack(parts).mean(dim=0)
    return total
