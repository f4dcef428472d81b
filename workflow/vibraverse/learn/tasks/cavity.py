"""Task ``cavity``: how thick the wall around the cavity of a hollow body is, by its sound.

The answer is t, the thickness of the wall over the depth of the deepest point. Outside and coarse voxels do not tell
it. ``sound`` hears the dimensionless frequencies and knows the outside and Poisson's ratio; ``outside`` does not hear.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import nn

from vibraverse.contract.errors import UsageError
from vibraverse.geometry.voxels import coarse_mesh
from vibraverse.learn.invariants import invariants
from vibraverse.learn.judging import judge_thickness
from vibraverse.learn.networks.dense import dense
from vibraverse.learn.samples import Samples
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.tasks.bodies import Bodies, BodyTask, Drawn
from vibraverse.learn.tasks.reconstruction import dimensionless


class Wall(nn.Module):
    """What is known of bodies (B, k) to t (B,); ``mean`` and ``spread`` (k,) normalise it, ``about`` (2,) t."""

    def __init__(self, network, mean: np.ndarray, spread: np.ndarray, about: np.ndarray):
        super().__init__()
        self.network = dense(len(mean), network.width, network.layers, 1)
        for name, values in (("mean", mean), ("spread", spread), ("about", about)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, batch: dict) -> torch.Tensor:
        """Return t."""
        found = self.network((batch["known"] - self.mean) / self.spread)[:, 0].float()
        return self.about[0] + self.about[1] * found


class Walls(Drawn):
    """Hollow bodies as numbers that are known of them; with a ``seed`` each item draws a material."""

    def __init__(self, bodies: Bodies, seed: int | None, task: Cavity):
        super().__init__(bodies, seed)
        self.task = task

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body."""
        number, _ = self.items.of_material(item, random)
        thickness = self.items.samples.row("thickness", item["body"])
        return {"known": self.task.known(item["body"], number), "t": np.float32(thickness)}


class Cavity(BodyTask):
    """The task for the trainer, over hollow bodies."""

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        hollow = samples.solidity == "hollow"
        super().__init__(samples, {side: bodies[hollow[bodies]] for side, bodies in sides.items()}, options)
        if not len(self.sides[TRAIN]):
            raise UsageError(
                "no object on the training side has a hollow body; write `solidities: [solid, hollow]` in the "
                "configuration, or leave the task out of learn.tasks"
            )
        self._outsides: dict[str, np.ndarray] = {}

    @property
    def kind(self) -> str:
        """A model that does not hear is a control."""
        return "control" if self.options.model == "outside" else super().kind

    def known(self, body: int, material: int) -> np.ndarray:
        """Return what a model gets: Poisson's ratio, the outside, and unless it does not hear, the frequencies."""
        parts = [[list(self.samples.materials.values())[material]["poisson"]], self._outside(body)]
        if self.options.model != "outside":
            parts.append(dimensionless(self.samples, body, material))
        return np.concatenate(parts).astype(np.float32)

    def _outside(self, body: int) -> np.ndarray:
        """Return the logarithms of the invariants (5,) of the coarse voxels; those of the surface know the cavity."""
        name = str(self.samples.object[body])
        if name not in self._outsides:
            self._outsides[name] = np.log(invariants(*coarse_mesh(self.samples.row("voxels", body))))
        return self._outsides[name]

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        known = np.array([
            self.known(body, number)
            for body in self.sides[TRAIN]
            for number in range(len(self.samples.materials))
        ])  # fmt: skip
        thickness = self.samples.rows("thickness", self.sides[TRAIN])
        about = np.array([thickness.mean(), thickness.std() + 1e-6])
        return Wall(self.options.network, known.mean(axis=0), known.std(axis=0) + 1e-6, about)

    def dataset(self, split: str) -> Walls:
        """Return the bodies of a side; those of ``train`` have another material in each epoch."""
        return Walls(Bodies(self.samples, self.sides[split], None), self.seed(split), self)

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,)."""
        return (model(batch) - batch["t"]).square()

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return the loss and the thickness of every sample, each (B,)."""
        found = model(batch)
        return {"loss": (found - batch["t"]).square(), "t": found}

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the thickness (n,) of a side's bodies."""
        return {"t": predict(side, self.dataset(side))["t"]}

    def judge(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> list[dict]:
        """Return the measures of answers about bodies (n,), see :mod:`vibraverse.learn.judging`."""
        return judge_thickness(self.samples, bodies, answers["t"])
