"""Task ``retrieval``: find the shape or the picture that belongs to a sound, and the other ways round.

``published`` is the model of the VibraVerse paper: a SIREN of the frequencies, VGG-16 of one view, and an octree
network of the shape to which a network of the material is added, trained by InfoNCE over the three pairs. ``contrast``
gets the same and is trained better: in both directions, with a learnt scale and larger batches, without negatives that
are right, from a spectrum whose scale stands apart. ``sized`` also knows the size of the shape and the constants of
the material. ``no_material`` is a control: a material that sound and shape both state tells many pairs apart.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import torch
from torch import nn

from vibraverse.contract.errors import UsageError
from vibraverse.learn.networks.octree import rotations, turned
from vibraverse.learn.networks.towers import (
    Shape,
    Spectrum,
    Towers,
    contrast,
    picture_network,
    sound_network,
)
from vibraverse.learn.pools import (
    DIRECTIONS,
    MODALITIES,
    SMALLEST,
    alike,
    in_direction,
    judge_retrieval,
    key_of,
)
from vibraverse.learn.precision import exact, tf32
from vibraverse.learn.ranking import summary
from vibraverse.learn.ranks import gathered
from vibraverse.learn.samples import Samples
from vibraverse.learn.sides import TEST, TRAIN
from vibraverse.learn.tasks.bodies import Bodies, BodyTask
from vibraverse.learn.tasks.frequencies import Shapes

#: Weight of the material's cross-entropy.
_CLASSIFIED = 0.1
#: The numbers of a sample that say what is right: how it looks, which body it is, in which material.
_LABELS = ("look", "same_body", "material_number")


class Triples(Shapes):
    """Bodies as frequencies, one picture and points; with a ``seed`` material, view, points and rotation are drawn."""

    def __init__(self, bodies: Bodies, points: int, seed: int | None):
        super().__init__(bodies, points, seed, ())
        self.numbers = alike(bodies.samples)

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body in a material."""
        values = super().sample(item, random)
        samples, body = self.items.samples, item["body"]
        views = samples.row("views", body)
        view = int(random.integers(len(views))) if random is not None else 0
        frequencies = samples.row("frequencies_hz", body)[values["material_number"]]
        return values | {
            "image": np.array(views[view]),
            "log_hz": np.log(frequencies).astype(np.float32),
            "log_volume": np.log(samples.row("volume_m3", body)).astype(np.float32),
            "look": self.numbers["look"][body],
            "same_body": self.numbers["body"][body],
        }


class Retrieval(BodyTask):
    """The task for the trainer.

    Raises :class:`UsageError` for fewer than two materials, and for a tested side that is too small for a pool.
    """

    best = "missed"

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        super().__init__(samples, sides, options)
        if len(samples.materials) < 2:
            raise UsageError(
                f"retrieval: all bodies are of {next(iter(samples.materials))}, so no material can be told from "
                "another; name two or more in `materials`, or take the task out of learn.tasks"
            )
        if len(sides[TEST]) < SMALLEST:
            raise UsageError(
                f"retrieval: the split {options.split!r} tests {len(sides[TEST])} bodies; among fewer than {SMALLEST} "
                "all are found with the first ten guesses; add objects, raise the share of test in dataset.splits, "
                "lower learn.folds, or take the task out of learn.tasks"
            )
        self.published = options.model == "published"
        self.sees_material, self.sees_size = options.model != "no_material", options.model == "sized"

    @property
    def kind(self) -> str:
        """A model whose shapes lack the material is a control."""
        return super().kind if self.sees_material else "control"

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        network, modes = self.options.network, self.samples.row("log_omega", 0).shape[-1]
        return Towers(
            sound_network(network, modes) if self.published else Spectrum(network, *self._spectra()),
            picture_network(self.options.preset in ("small", "paper")),
            self.shape_tower(),
            # Pictures show no material.
            ("sound", "shape") if self.sees_material else ("sound",),
            len(self.samples.materials),
            learns_scale=not self.published,
        )

    def shape_tower(self) -> nn.Module:
        """Return the tower of shapes."""
        count = len(self.samples.materials) if self.sees_material else 0
        known = self._sizes() if self.sees_size else (np.zeros(count), np.ones(count))
        return Shape(self.options.network.depth, *known)

    def _spectra(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and spread (m + 1,) of the numbers of a spectrum over the training side, in all materials."""
        logarithms = np.log(self.samples.rows("frequencies_hz", self.sides[TRAIN]))
        scale = logarithms.mean(axis=-1, keepdims=True)
        numbers = np.concatenate([scale, logarithms - scale], axis=-1)
        return numbers.mean(axis=(0, 1)), numbers.std(axis=(0, 1)) + 1e-6

    def _sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and spread (k,) of what :meth:`prepare` joins; the material is scaled already."""
        invariants = np.log(self.samples.rows("invariants", self.sides[TRAIN]))
        volume = np.log(self.samples.rows("volume_m3", self.sides[TRAIN]))
        numbers = np.column_stack([invariants, volume])
        return np.append(numbers.mean(axis=0), np.zeros(3)), np.append(numbers.std(axis=0) + 1e-6, np.ones(3))

    def dataset(self, split: str, material: int | None = None) -> Triples:
        """Return the bodies of a side, each in its own material or all in one; those of ``train`` are drawn anew."""
        bodies = Bodies(self.samples, self.sides[split], material)
        return Triples(bodies, self.options.network.points, self.seed(split))

    def prepare(self, batch: dict, device) -> dict:
        """Return the batch on a device, its bodies turned, with what the towers are told."""
        batch = super().prepare(batch, device)
        parts = [batch["invariants"], batch["log_volume"][:, None], batch["material"]]
        return {
            **batch,
            "points": turned(batch["points"], rotations(batch["turn"])),
            "heard": batch["scaled" if self.published else "log_hz"],
            "known": torch.cat(parts, dim=-1).float()
            if self.sees_size
            else nn.functional.one_hot(batch["material_number"], len(self.samples.materials)).float(),
        }

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,), among the samples of all processes."""
        found = model(batch)
        # Scores are sharp differences of products: no rounding to bfloat16 or TF32.
        with exact(batch["points"].device), tf32(False):
            vectors, first = gathered(torch.stack([found[name] for name in MODALITIES], dim=1))
            everything = dict(zip(MODALITIES, vectors.unbind(dim=1), strict=True))
            loss = contrast(
                found, everything, first, self._alike(batch), found["scale"], symmetric=not self.published
            )
            scores = found["materials"].flatten(0, 1)
            wanted = batch["material_number"].repeat_interleave(found["materials"].shape[1])
            classified = nn.functional.cross_entropy(scores, wanted, reduction="none")
            return loss + _CLASSIFIED * classified.view(len(loss), -1).mean(dim=-1)

    def _alike(self, batch: dict) -> dict[tuple[str, str], torch.Tensor]:
        """Return by pair of modalities which samples of all processes are right for each sample (B, A).

        The published loss takes the sample alone for right.
        """
        own = torch.stack([batch[name] for name in _LABELS], dim=1)
        everything, _ = gathered(own)
        look, body, material = (own[:, None] == everything).unbind(dim=-1)
        same = {"look": look, "body": body & material if self.sees_material else body}
        return {
            pair: torch.zeros_like(look) if self.published else same[key_of(pair)]
            for pair in combinations(MODALITIES, 2)
        }

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return the vectors of each modality (B, 128), and which bodies are alike."""
        found = model(batch)
        numbers = {"look": batch["look"], "body": batch["same_body"]}
        return {**{name: found[name] for name in MODALITIES}, **numbers}

    def score(self, predictions: dict[str, np.ndarray]) -> dict[str, float]:
        """Return how often the first guess is right, and one minus the mean reciprocal rank, over all directions."""
        found = [summary(in_direction(predictions, predictions, direction)) for direction in DIRECTIONS]
        top_1, mrr = (float(np.mean([one[name] for one in found])) for name in ("top_1", "mrr"))
        return {"missed": 1.0 - mrr, "top_1": top_1}

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the vectors of a side's bodies, see :func:`vibraverse.learn.pools.judge_retrieval`.

        ``predict(side, dataset)`` returns what :meth:`predict` gives for every sample.
        """
        parts = [predict(side, self.dataset(side, number)) for number in range(len(self.samples.materials))]
        found = {name: np.stack([part[name] for part in parts], axis=1) for name in MODALITIES}
        return {**found, "image": found["image"][:, :1], "material": self.materials(side)}

    def materials(self, side: str) -> np.ndarray:
        """Return the number of the material (n,) that each body of a side has where they have several."""
        own = Bodies(self.samples, self.sides[side], None)
        return np.array([own[index]["material"] for index in range(len(own))])

    def judge(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> list[dict]:
        """Return the measures of answers about bodies (n,), see :mod:`vibraverse.learn.pools`."""
        return judge_retrieval(self.samples, bodies, answers)
