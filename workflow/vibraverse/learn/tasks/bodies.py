"""Bodies as samples: what the tasks share."""

from __future__ import annotations

import numpy as np

from vibraverse.contract.errors import UsageError
from vibraverse.contract.seeds import stable_hash
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import scaled, scaled_material


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
            "material": scaled_material(*self.parameters[number]).astype(np.float32),
            "scaled": scaled(frequencies).astype(np.float32),
        }


def chosen(samples: Samples, sides: dict[str, np.ndarray], side: str) -> np.ndarray:
    """Return the bodies of a side; raise :class:`UsageError` if there are none."""
    if not len(sides[side]):
        raise UsageError(f"no body is on the side {side!r}; add objects, or choose another split")
    return sides[side]
