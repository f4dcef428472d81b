"""Task ``solidity``: tell a solid body from a hollow one by its sound, a picture and its material.

Both bodies of an object look alike and are made of the same materials, so pictures and materials alone must not help;
the models that get only these are controls. ``published`` is the network of the VibraVerse paper: a SIREN of the
frequencies and VGG-16 of one view. ``ratios`` gets the frequencies as ratios to the first, and the first apart;
``informed`` the material too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import nn

from vibraverse.contract.errors import UsageError
from vibraverse.learn.judging import judge_solidity
from vibraverse.learn.networks.dense import dense, material_network
from vibraverse.learn.networks.picture import SMALL, PictureNetwork
from vibraverse.learn.networks.siren import Siren
from vibraverse.learn.samples import Samples
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.tasks.bodies import Bodies, BodyTask, Drawn

#: What each model gets.
PARTS = {
    "published": ("sound", "image"),
    "ratios": ("ratios", "image"),
    "informed": ("ratios", "image", "material"),
    "sound": ("sound",),
    "image": ("image",),
    "material": ("material",),
}
_WIDTH = 128


class Classifier(nn.Module):
    """The parts of a sample, each through its network, then together to two classes (B, 2): solid, hollow."""

    def __init__(self, parts: tuple[str, ...], network, modes: int, published_size: bool):
        super().__init__()
        made = {
            "sound": lambda: Siren(modes, network.width, network.layers, _WIDTH, normalised=False),
            "ratios": lambda: dense(modes, network.width, network.layers, _WIDTH),
            "image": lambda: PictureNetwork(_WIDTH, None if published_size else SMALL),
            "material": lambda: material_network(_WIDTH),
        }
        self.parts = nn.ModuleDict({name: made[name]() for name in parts})
        self.head = dense(_WIDTH * len(parts), network.width, 1, 2)

    def forward(self, batch: dict) -> torch.Tensor:
        """Return the classes' scores (B, 2)."""
        return self.head(torch.cat([part(batch[name]) for name, part in self.parts.items()], dim=-1)).float()


class Strikes(Drawn):
    """Bodies as frequencies, one picture, material and class; with a ``seed`` material and view are drawn."""

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body."""
        samples, body = self.items.samples, item["body"]
        _, values = self.items.of_material(item, random)
        views = samples.row("views", body)
        view = int(random.integers(len(views))) if random is not None else 0
        return {
            "body": values["body"],
            "material": values["material"],
            "sound": values["scaled"],
            "ratios": ratios(values["scaled"]),
            "image": np.array(views[view]),
            "label": np.int64(samples.solidity[body] == "hollow"),
        }


def ratios(scaled: np.ndarray) -> np.ndarray:
    """Return the first scaled frequency, then the others' distances from it (m,), which hardly depend on the size."""
    return np.concatenate([scaled[:1], 4.0 * (scaled[1:] - scaled[:1])]).astype(np.float32)


class Solidity(BodyTask):
    """The task for the trainer; objects without both bodies are left out, so that the classes are equal in number."""

    best = "loss"

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        super().__init__(
            samples, {name: _in_pairs(samples, bodies) for name, bodies in sides.items()}, options
        )
        if not len(self.sides[TRAIN]):
            raise UsageError(
                "no object on the training side has both bodies, solid and hollow; write `solidities: [solid, hollow]` "
                "in the configuration, or leave the task out of learn.tasks"
            )

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        modes = self.samples.row("log_omega", 0).shape[-1]
        published_size = self.options.preset in ("small", "paper")
        return Classifier(PARTS[self.options.model], self.options.network, modes, published_size)

    @property
    def kind(self) -> str:
        """A model that gets one part alone is a control."""
        return "control" if len(PARTS[self.options.model]) == 1 else super().kind

    def dataset(self, split: str) -> Strikes:
        """Return the bodies of a side; those of ``train`` have another material and view in each epoch."""
        bodies = Bodies(self.samples, self.sides[split], None)
        return Strikes(bodies, self.seed(split))

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,)."""
        return nn.functional.cross_entropy(model(batch), batch["label"], reduction="none")

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return the loss (B,), the probability of a hollow body (B,) and the class (B,)."""
        scores = model(batch)
        return {
            "loss": nn.functional.cross_entropy(scores, batch["label"], reduction="none"),
            "hollow": scores.softmax(dim=-1)[:, 1],
            "label": batch["label"],
        }

    def score(self, predictions: dict[str, np.ndarray]) -> dict[str, float]:
        """Return loss and accuracy."""
        right = (predictions["hollow"] > 0.5) == predictions["label"]
        return {"loss": float(predictions["loss"].mean()), "accuracy": float(right.mean())}

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the probability of a hollow body (n,) for a side.

        ``predict(side, dataset)`` returns what :meth:`predict` gives for every sample.
        """
        return {"hollow": predict(side, self.dataset(side))["hollow"]}

    def judge(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> list[dict]:
        """Return the measures of answers about bodies (n,), see :mod:`vibraverse.learn.judging`."""
        return judge_solidity(self.samples, bodies, self.right(bodies, answers))

    def right(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> np.ndarray:
        """Return which answers about bodies (n,) are right (n,)."""
        return (answers["hollow"] > 0.5) == (self.samples.solidity[bodies] == "hollow")


def _in_pairs(samples: Samples, bodies: np.ndarray) -> np.ndarray:
    """Return the bodies whose object has both."""
    names, counts = np.unique(samples.object[bodies], return_counts=True)
    both = set(names[counts == 2])
    return np.array([body for body in bodies if samples.object[body] in both], dtype=np.int64)
