"""Bodies as samples: what the tasks share."""

from __future__ import annotations

import numpy as np

from vibraverse.contract.seeds import stable_hash
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import scaled, scaled_material
from vibraverse.learn.sides import TRAIN
from vibraverse.learn.task import Keyed, Task


class Bodies:
    """Chosen bodies of the samples, with materials; ``len()`` and items by number, for :class:`Keyed`.

    ``material`` is the number of the named material of every item; with None each object has one that follows from
    its id, the same for both its bodies.
    """

    def __init__(self, samples: Samples, bodies: np.ndarray, material: int | None = 0):
        self.samples, self.bodies, self.material = samples, bodies, material
        self.parameters = np.array(
            [
                [one[name] for name in ("density_kg_m3", "young_pa", "poisson")]
                for one in samples.materials.values()
            ]
        )
        self._scaled = np.array([scaled_material(*one) for one in self.parameters], dtype=np.float32)

    def __len__(self) -> int:
        return len(self.bodies)

    def __getitem__(self, index: int) -> dict:
        body, material = int(self.bodies[index]), self.material
        if material is None:
            material = stable_hash(str(self.samples.object[body]), "material") % len(self.parameters)
        return {"body": body, "material": material}

    def of_material(
        self, item: dict, random: np.random.Generator | None
    ) -> tuple[int, dict[str, np.ndarray]]:
        """Return the number of the item's material, and what networks get of it and of the sound."""
        number = item["material"] if random is None else int(random.integers(len(self.parameters)))
        frequencies = self.samples.row("frequencies_hz", item["body"])[number]
        return number, {
            "body": np.int64(item["body"]),
            "material_number": np.int64(number),
            "material": self._scaled[number],
            "scaled": scaled(frequencies).astype(np.float32),
        }


class Drawn(Keyed):
    """Samples made of :class:`Bodies`: with a ``seed`` what is random in them is drawn, without one nothing is."""

    def __init__(self, bodies: Bodies, seed: int | None):
        super().__init__(bodies, seed or 0, self._draw)
        self._random = seed is not None

    def sample(self, item: dict, random: np.random.Generator | None) -> dict[str, np.ndarray]:
        """Return what a network gets of an item; ``random`` is None where nothing is drawn."""
        raise NotImplementedError

    def _draw(self, item: dict, random: np.random.Generator) -> dict[str, np.ndarray]:
        return self.sample(item, random if self._random else None)


class BodyTask(Task):
    """A task over bodies: ``sides`` maps the sides of a split to numbers of bodies."""

    def __init__(self, samples: Samples, sides: dict[str, np.ndarray], options):
        self.samples, self.sides, self.options = samples, sides, options

    @property
    def kind(self) -> str:
        """What the model is in the table of results: ``published``, ``model``, or ``control``."""
        return "published" if self.options.model == "published" else "model"

    def ids(self, split: str) -> list[str]:
        """Return the names of a side's bodies."""
        return [self.samples.ids[body] for body in self.sides[split]]

    def right(self, bodies: np.ndarray, answers: dict[str, np.ndarray]) -> np.ndarray | None:
        """Return which answers about bodies (n,) are right (n,); None where answers are numbers."""
        return None

    def seed(self, side: str) -> int | None:
        """Return the seed of what is drawn on a side: only training draws."""
        return self.options.seed if side == TRAIN else None
