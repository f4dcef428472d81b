"""Task ``reconstruction``: the shape of a body from its coarse voxels, its sound and its material.

The voxels are those of the outside, which an object's solid and hollow bodies share; what is inside, only the sound can
tell. ``published`` is the network of the VibraVerse paper, with the frequencies on the scaled mel scale and signed
distances as they are. ``truncated`` limits these to 0.1, takes half of them near the surface, and hears dimensionless
frequencies. Controls are the same without something: ``shuffled`` hears another body, ``material`` hears nothing, and
``silent`` knows no material either.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import nn

from vibraverse.learn.judging import judge_reconstruction
from vibraverse.learn.networks.shape_vae import ShapeVae
from vibraverse.learn.reconstructions import Truth, measured
from vibraverse.learn.samples import Samples
from vibraverse.learn.sampling import EVEN, NEAR, UNIT, voxel_cloud
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.tasks.bodies import Bodies, BodyTask, Drawn

#: Model -> what it knows besides the voxels.
KNOWN = {
    "published": ("scaled", "material"),
    "truncated": ("heard", "material"),
    "shuffled": ("heard", "material"),
    "material": ("material",),
    "silent": (),
}
_CONTROLS = ("shuffled", "material", "silent")
#: Weight of the divergence in the loss, as published.
_DIVERGENCE = 1e-3
#: Signed distances of all models but the published one are limited to this, and are learned as shares of it.
_TRUNCATION = 0.1
#: Places that are looked at together when a surface is extracted.
_TOGETHER = 16_384


class Reconstructor(nn.Module):
    """The shape network; ``mean`` and ``spread`` (m,) normalise dimensionless frequencies."""

    def __init__(self, network, known: tuple[str, ...], mean: np.ndarray, spread: np.ndarray):
        super().__init__()
        self.network = ShapeVae(network, {name: 3 if name == "material" else len(mean) for name in known})
        for name, values in (("mean", mean), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def inputs(self, batch: dict) -> dict:
        """Return the batch as the shape network takes it."""
        return {**batch, "heard": (batch["heard"] - self.mean) / self.spread}

    def forward(self, batch: dict) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the values (B, q) at ``places``, and the divergence (B,)."""
        return self.network(self.inputs(batch))


class Solids(Drawn):
    """Bodies as points on their voxels, sound and material, with signed distances at places.

    With a ``seed`` each item draws its places, its points, and a material. ``whole`` items, which answers are asked
    about, name the body instead of the places.
    """

    def __init__(self, bodies: Bodies, seed: int | None, task: Reconstruction, whole: bool):
        super().__init__(bodies, seed)
        self.network, self.model, self.whole = task.options.network, task.options.model, whole

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body."""
        samples, body = self.items.samples, item["body"]
        number, values = self.items.of_material(item, random)
        return {
            **values,
            "cloud": self._cloud(body, random),
            **({} if self.whole else self._places(body, random)),
            "heard": dimensionless(samples, self._heard(item, random), number),
            "poisson": np.float64(self.items.parameters[number, 2]),
        }

    def _heard(self, item: dict, random: np.random.Generator | None) -> int:
        """Return the body that is heard: the item's own, or for ``shuffled`` one of another object on the side."""
        if self.model != "shuffled":
            return item["body"]
        bodies, names = self.items.bodies, self.items.samples.object
        others = bodies[names[bodies] != names[item["body"]]]
        if not len(others):
            return item["body"]
        if random is not None:
            return int(random.choice(others))
        return int(others[(np.searchsorted(others, item["body"]) + len(others) // 2) % len(others)])

    def _cloud(self, body: int, random: np.random.Generator | None) -> np.ndarray:
        """Return points on the voxels (p, 6), the farthest ones first."""
        samples, network = self.items.samples, self.network
        everything = voxel_cloud(samples.row("voxels", body), samples.voxel_points, str(samples.object[body]))
        first = samples.row("farthest", body)[: network.latents]
        others = np.delete(np.arange(len(everything)), first)
        wanted = network.voxel_points - len(first)
        chosen = others[:wanted] if random is None else random.choice(others, wanted, replace=False)
        return everything[np.concatenate([first, chosen])]

    def _places(self, body: int, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        samples, wanted = self.items.samples, self.network.distances
        places, distances = samples.row("distance_places", body), samples.row("distances", body)
        near = 0 if self.model == "published" else wanted // 2
        found = []
        for kind, count in ((EVEN, wanted - near), (NEAR, near)):
            rows = np.arange(count)
            if random is not None:
                rows = random.choice(distances.shape[1], size=count, replace=False)
            found.append((UNIT * places[kind, rows], distances[kind, rows]))
        return {
            name: np.concatenate(parts).astype(np.float32)
            for name, parts in zip(("places", "true"), zip(*found, strict=True), strict=True)
        }


class Reconstruction(BodyTask):
    """The task for the trainer."""

    best = "loss"

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        super().__init__(samples, sides, options)
        self.truncation = None if options.model == "published" else _TRUNCATION

    @property
    def kind(self) -> str:
        """A model that does not hear the body is a control."""
        return "control" if self.options.model in _CONTROLS else super().kind

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        heard = np.concatenate([
            [dimensionless(self.samples, body, number) for number in range(len(self.samples.materials))]
            for body in self.sides[TRAIN]
        ])  # fmt: skip
        spread = heard.std(axis=0) + 1e-6
        return Reconstructor(self.options.network, KNOWN[self.options.model], heard.mean(axis=0), spread)

    def dataset(self, split: str, whole: bool = False) -> Solids:
        """Return the bodies of a side; those of ``train`` are drawn anew in each epoch."""
        return Solids(Bodies(self.samples, self.sides[split], None), self.seed(split), self, whole)

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,)."""
        found, divergence = model(batch)
        return self._error(found, batch) + _DIVERGENCE * divergence

    def _error(self, found: torch.Tensor, batch: dict) -> torch.Tensor:
        true = batch["true"]
        if self.truncation:
            true = (true / self.truncation).clamp(-1.0, 1.0)
        return (found - true).square().mean(dim=-1)

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return the loss of every sample (B,), or of whole bodies the measures of their reconstructions."""
        if "places" in batch:
            return {"loss": self.losses(model, batch)}
        batch = model.inputs(batch)
        tokens = model.network.decode(model.network.encode(batch["cloud"])[0], batch)
        rows = [
            self.measured(self._field(model, one[None]), int(body), float(poisson))
            for one, body, poisson in zip(tokens, batch["body"], batch["poisson"], strict=True)
        ]
        return {name: torch.tensor(np.array([row[name] for row in rows])) for name in rows[0]}

    def _field(self, model: nn.Module, tokens: torch.Tensor) -> Callable[[np.ndarray], np.ndarray]:
        """Return the signed distance that the tokens (1, n, width) of a body stand for."""

        def field(places: np.ndarray) -> np.ndarray:
            parts = torch.as_tensor(places, dtype=torch.float32, device=tokens.device).split(_TOGETHER)
            found = torch.cat([model.network.distances(tokens, part[None])[0] for part in parts])
            return (found * (self.truncation or 1.0)).cpu().numpy()

        return field

    def measured(self, field, body: int, poisson: float) -> dict:
        """Return the measures of a reconstruction of a body."""
        samples = self.samples
        truth = Truth.of(samples, body)
        modes = samples.row("log_omega", body).shape[-1]
        return measured(field, truth, self.options.network.cells, modes, poisson, samples.ritz_unknowns[0])

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the measures (n,) of the reconstructions of a side's bodies, and their ``log_omega`` (n, m)."""
        return predict(side, self.dataset(side, whole=True))

    def judge(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> list[dict]:
        """Return the measures of answers about bodies (n,), see :mod:`vibraverse.learn.judging`."""
        return judge_reconstruction(self.samples, bodies, self.poisson(bodies), answers)

    def poisson(self, bodies: np.ndarray) -> np.ndarray:
        """Return the Poisson's ratio (n,) of the material that each body is heard in."""
        chosen = Bodies(self.samples, bodies, None)
        return np.array([chosen.parameters[chosen[index]["material"], 2] for index in range(len(bodies))])

    def heard(self, body: int) -> np.ndarray:
        """Return the logarithms of ω (m,) of a body for E = ρ = 1 in normalised lengths, in its material."""
        return dimensionless(self.samples, body, Bodies(self.samples, np.array([body]), None)[0]["material"])


def dimensionless(samples: Samples, body: int, material: int) -> np.ndarray:
    """Return ``log(2π f L / sqrt(E/ρ))`` (m,) float32, with L the longest side over 1.8.

    The cube root of the volume in place of L would tell what is asked for.
    """
    one = list(samples.materials.values())[material]
    length = float(samples.row("size_m", body)) / 1.8
    unit = np.sqrt(one["young_pa"] / one["density_kg_m3"]) / (2 * np.pi * length)
    return np.log(samples.row("frequencies_hz", body)[material] / unit).astype(np.float32)
