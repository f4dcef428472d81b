"""Task ``frequencies``: the frequencies of a body from its shape and its material.

``published`` is the network of the VibraVerse paper: shape and material to 64 frequencies on the scaled mel scale.
``physics`` predicts the dimensionless spectrum from the shape and Poisson's ratio alone. Young's modulus, density and
size enter exactly, the frequencies ascend by construction, and every sample of every epoch has a Poisson's ratio of its
own. ``ritz`` does the same as a correction of frequencies by Ritz's method, which takes seconds of computing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import nn

from vibraverse.learn.judging import judge_frequencies
from vibraverse.learn.metrics import LOWEST, frequency_errors
from vibraverse.learn.networks.corrector import Corrector
from vibraverse.learn.networks.dense import dense, material_network
from vibraverse.learn.networks.octree import OctreeNetwork, rotations, turned
from vibraverse.learn.networks.siren import Siren
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import unit_hz, unscaled
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.tasks.bodies import Bodies, BodyTask, Drawn

#: Widths of the encoders, as published.
_SHAPE, _MATERIAL = 128, 32
#: Relative error at which the loss turns from quadratic to linear.
_KNEES = {"physics": 0.02, "ritz": 0.005}


class Published(nn.Module):
    """Shape (128) and material (32) to scaled frequencies, through a SIREN."""

    def __init__(self, network, modes: int):
        super().__init__()
        self.shape = OctreeNetwork(network.depth, _SHAPE)
        self.material = material_network(_MATERIAL)
        self.head = Siren(_SHAPE + _MATERIAL, network.width, network.layers, modes)

    def forward(self, batch: dict) -> torch.Tensor:
        """Return scaled frequencies (B, m)."""
        parts = [self.shape(batch["points"]), self.material(batch["material"])]
        return self.head(torch.cat(parts, dim=-1)).float()


class Physics(nn.Module):
    """Shape, its invariants and Poisson's ratio to the logarithms of the dimensionless frequencies, ascending.

    The network starts from ``mean`` (m,), that of the training side, and learns the departures from it. Sorting keeps
    the order. (Steps from mode to mode, each positive, keep it too, but an error in one moves all above it: after 150
    steps on eight bodies they were a hundred times farther off.) ``centre`` and ``spread`` (i,) normalise the
    logarithms of the invariants.
    """

    def __init__(self, network, mean: np.ndarray, centre: np.ndarray, spread: np.ndarray):
        super().__init__()
        self.shape = OctreeNetwork(network.depth, _SHAPE)
        self.head = dense(_SHAPE + len(centre) + 1, network.width, network.layers, len(mean))
        nn.init.zeros_(self.head[-1].weight)
        nn.init.zeros_(self.head[-1].bias)
        for name, values in (("mean", mean), ("centre", centre), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, batch: dict) -> torch.Tensor:
        """Return the logarithms (B, m)."""
        invariants = (batch["invariants"] - self.centre) / self.spread
        poisson = (batch["poisson"][:, None] - 0.25) / 0.15
        found = self.head(torch.cat([self.shape(batch["points"]), invariants, poisson], dim=-1)).float()
        return torch.sort(self.mean + found, dim=-1).values


class Corrected(nn.Module):
    """As :class:`Physics`, from frequencies by Ritz's method in d spaces, the finest last, in place of a shape.

    ``start`` (n, d, m) are those of the training side, ``mean`` (m,) is the median logarithm of the true frequencies
    over the finest. An octree of the shape would take twenty times as long; with equal steps it was not compared.
    """

    def __init__(self, network, mean: np.ndarray, start: np.ndarray, centre: np.ndarray, spread: np.ndarray):
        super().__init__()
        known = dense(len(centre) + 1, network.width, 1, network.width)
        self.known = nn.Sequential(known, nn.GELU())
        self.head = Corrector(start, network.width, network.width, network.layers)
        for name, values in (("mean", mean), ("centre", centre), ("spread", spread)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, batch: dict) -> torch.Tensor:
        """Return the logarithms (B, m)."""
        invariants = (batch["invariants"] - self.centre) / self.spread
        poisson = (batch["poisson"][:, None] - 0.25) / 0.15
        known = self.known(torch.cat([invariants, poisson], dim=-1))
        found = self.head(batch["ritz"], known).float()
        return torch.sort(batch["ritz"][:, -1] + self.mean + found, dim=-1).values


class Shapes(Drawn):
    """Bodies as invariants, material and frequencies, and as ``points`` points unless that is none.

    With a ``seed`` each item draws points, a rotation, a material and a Poisson's ratio of its own.
    """

    def __init__(self, bodies: Bodies, points: int, seed: int | None, spectra: tuple[str, ...]):
        super().__init__(bodies, seed)
        self.points, self.spectra = points, spectra

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return the arrays of one body."""
        samples, body = self.items.samples, item["body"]
        number, values = self.items.of_material(item, random)
        values |= {name: np.array(samples.row(name, body)) for name in self.spectra}
        if self.points:
            values |= self._points(body, random)
        poisson = self.items.parameters[number, 2]
        if random is not None:
            poisson = random.uniform(samples.poisson[0], samples.poisson[-1])
        return values | {
            "invariants": np.log(samples.row("invariants", body)),
            "poisson": np.float32(poisson),
        }

    def _points(self, body: int, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        points, turn, picked = self.items.samples.row("points", body), (1.0, 0, 0, 0), slice(self.points)
        if random is not None:
            picked = random.choice(len(points), size=min(self.points, len(points)), replace=False)
            turn = random.normal(size=4)
        return {"points": np.array(points[picked]), "turn": np.array(turn, dtype=np.float32)}


class Frequencies(BodyTask):
    """The task for the trainer."""

    best = "median"

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        super().__init__(samples, sides, options)
        self._published = options.model == "published"
        #: Arrays over Poisson's ratio that the model needs.
        self.spectra = ("log_omega", "ritz") if options.model == "ritz" else ("log_omega",)

    @property
    def exact(self) -> bool:
        """Whether Young's modulus, density and size enter exactly, so that any will do."""
        return not self._published

    def model(self) -> nn.Module:
        """Return the model of the options, untrained."""
        train = self.sides[TRAIN]
        if self._published:
            return Published(self.options.network, self.samples.row("log_omega", 0).shape[-1])
        invariants = np.log(self.samples.rows("invariants", train))
        about = invariants.mean(axis=0), invariants.std(axis=0) + 1e-6
        true = self.samples.rows("log_omega", train)
        if self.options.model == "physics":
            return Physics(self.options.network, true.mean(axis=(0, 1)), *about)
        start = self.samples.rows("ritz", train)
        mean = np.median(true - start[:, :, -1], axis=(0, 1))
        return Corrected(self.options.network, mean, start.reshape(-1, *start.shape[2:]), *about)

    def dataset(self, split: str, material: int = 0) -> Shapes:
        """Return the bodies of a side; those of ``train`` are drawn anew in each epoch, others have one material."""
        bodies = Bodies(self.samples, self.sides[split], material)
        points = 0 if self.options.model == "ritz" else self.options.network.points
        return Shapes(bodies, points, self.seed(split), self.spectra)

    def prepare(self, batch: dict, device) -> dict:
        """Return the batch on a device, its bodies turned, with the spectrum at the Poisson's ratio of each."""
        batch = super().prepare(batch, device)
        nodes = torch.tensor(self.samples.poisson, dtype=torch.float32, device=device)
        if "points" in batch:
            batch["points"] = turned(batch["points"], rotations(batch["turn"]))
        return batch | {name: between(nodes, batch[name], batch["poisson"]) for name in self.spectra}

    def losses(self, model: nn.Module, batch: dict) -> torch.Tensor:
        """Return the loss of every sample (B,)."""
        found = model(batch)
        if self._published:
            return (found - batch["scaled"]).square().mean(dim=-1)
        target = batch["log_omega"]
        knee = _KNEES[self.options.model]
        return nn.functional.smooth_l1_loss(found, target, beta=knee, reduction="none").mean(dim=-1)

    def predict(self, model: nn.Module, batch: dict) -> dict[str, torch.Tensor]:
        """Return predicted and true values (B, m): on the scaled mel scale for ``published``, else logarithms."""
        return {"found": model(batch), "true": batch["scaled" if self._published else "log_omega"]}

    def score(self, predictions: dict[str, np.ndarray]) -> dict[str, float]:
        """Return the errors of the frequencies."""
        to_frequencies = unscaled if self._published else np.exp
        found, true = (to_frequencies(predictions[name].astype(np.float64)) for name in ("found", "true"))
        return frequency_errors(np.maximum(found, LOWEST), true)

    def answers(self, side: str, predict: Callable[..., dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return predicted and true frequencies (n, materials, m) of a side in Hz.

        ``predict(side, dataset)`` returns what :meth:`predict` gives for every sample.
        """
        bodies = self.sides[side]
        found = [
            self.hertz(predict(side, self.dataset(side, number))["found"], bodies, number)
            for number in range(len(self.samples.materials))
        ]
        return {"found_hz": np.stack(found, axis=1), "true_hz": self.samples.rows("frequencies_hz", bodies)}

    def judge(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> list[dict]:
        """Return the measures of answers about bodies (n,), see :mod:`vibraverse.learn.judging`."""
        return judge_frequencies(self.samples, bodies, answers["found_hz"])

    def hertz(self, found: np.ndarray, bodies: np.ndarray, material: int) -> np.ndarray:
        """Return predictions (n, m) for bodies (n,) in a named material as frequencies in Hz."""
        if self._published:
            return unscaled(found.astype(np.float64))
        one = list(self.samples.materials.values())[material]
        volume = self.samples.rows("volume_m3", bodies)
        return (
            np.exp(found.astype(np.float64)) * unit_hz(volume, one["young_pa"], one["density_kg_m3"])[:, None]
        )


def between(nodes: torch.Tensor, values: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
    """Return values (B, …) at ``at`` (B,), linear between those (B, k, …) at equidistant nodes (k,)."""
    place = (at - nodes[0]) / (nodes[1] - nodes[0])
    low = place.floor().clamp(0, len(nodes) - 2).long()
    share = (place - low).reshape(-1, *[1] * (values.ndim - 2))
    rows = torch.arange(len(at), device=at.device)
    return (1 - share) * values[rows, low] + share * values[rows, low + 1]
