"""Fresh materials and sizes for every sample of every epoch, with exact labels from the stored modal basis.

One item per body. Labels equal those that the stage ``modes`` computes for that material and size: a dense problem of a
few hundred unknowns, about 15 milliseconds. Item ``i`` of epoch ``e`` depends only on the seed, ``e`` and the body, not
on the worker.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from vibraverse.config.physics import Sampled
from vibraverse.contract.seeds import rng
from vibraverse.contract.texts import unknown
from vibraverse.dataset import schema
from vibraverse.dataset.read.items import Items
from vibraverse.dataset.read.reader import Reader
from vibraverse.files.basis import read_basis
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.physics.materials import drawn
from vibraverse.physics.modes import solve_material
from vibraverse.physics.shapes import mode_shapes

#: Name of the material of every item.
FRESH = "fresh"
#: Fields that depend on size and material, and are therefore computed.
COMPUTED = (
    "size_m", "scale_m", "volume_m3", "density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s", "mass_kg",
    "frequencies_hz", "damping_per_s", "damped_frequencies_hz", "relative_error", "discretisation_error",
    "mode_coefficients", "mode_shapes",
)  # fmt: skip


class FreshItems:
    """The bodies among a reader's items, each with a material and a size drawn for the epoch.

    ``ranges`` override those of :class:`vibraverse.config.physics.Sampled` by parameter. Sizes are drawn
    log-uniformly from ``size_m``; None keeps the stored size. ``bases`` is the number of modal bases, half a megabyte
    each, that a process caches. Set :attr:`epoch` before each pass to draw anew.

    Raises :class:`KeyError` for a field that only a stored material has, :class:`ValueError` for a range outside that
    of the basis.
    """

    def __init__(
        self,
        reader: Reader,
        ranges: dict[str, tuple[float, float]] | None = None,
        size_m: tuple[float, float] | None = (0.05, 0.5),
        seed: int = 0,
        bases: int = 64,
    ):
        self.reader, self.size_m, self.seed, self.epoch = reader.part(_bodies(reader)), size_m, seed, 0
        self.ranges = Sampled(**(ranges or {})).ranges()
        for name in reader.fields:
            path = schema.BY_NAME[name].path
            if name not in COMPUTED and ("{material}" in path or "{sound}" in path):
                raise KeyError(f"a fresh material has no {name}; of it are known: {', '.join(COMPUTED)}")
        if reader.look == "material" and "views" in reader.fields:
            raise KeyError(unknown("look", FRESH, ("clay", "or any other the dataset holds")))
        self._corrected = _corrected(reader)
        self._bases: OrderedDict = OrderedDict()
        self._kept = bases

    def __len__(self) -> int:
        return len(self.reader)

    @property
    def items(self) -> Items:
        """One row of the index per body: that of its first item."""
        return self.reader.items

    def __getitem__(self, index: int) -> dict:
        place = self.items.place(index)
        del place["material"]
        values = self._computed(**place)
        fields = {
            name: values[name] if name in COMPUTED else self.reader.read(name, **place)
            for name in self.reader.fields
        }
        return {**place, "material": FRESH, **fields}

    def close(self) -> None:
        """Close the files of this process and drop the cached bases."""
        self._bases.clear()
        self.reader.close()

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_bases": OrderedDict()}

    def _computed(self, object: str, solidity: str) -> dict:
        basis = self._basis(object, solidity)
        random = rng(object, solidity, FRESH, str(self.seed), str(self.epoch))
        material = {name: float(value[0]) for name, value in drawn(random, 1, self.ranges).items()}
        size_m = float(self.reader.read("size_m", object, solidity))
        if self.size_m is not None:
            size_m = float(self.size_m[0] * (self.size_m[1] / self.size_m[0]) ** random.random())
        scale_m = size_m / LONGEST_SIDE
        modes = solve_material(basis, material, scale_m, len(basis.residuals), self._corrected)
        computed = {name: getattr(modes, name) for name in COMPUTED if hasattr(modes, name)}
        computed["mode_coefficients"] = modes.coefficients.astype(np.float32)
        if "mode_shapes" in self.reader.fields:
            surface = self.reader.surface(object, solidity)
            computed["mode_shapes"] = mode_shapes(*surface, computed["mode_coefficients"])
        size = {"size_m": size_m, "scale_m": scale_m, "volume_m3": basis.volume * scale_m**3}
        return {name: np.asarray(value)[()] for name, value in {**size, **material, **computed}.items()}

    def _basis(self, object: str, solidity: str):
        """Return a body's basis without its surface, from the cache if possible."""
        key = object, solidity
        if key not in self._bases:
            basis = read_basis(self.reader.group(object)[f"{solidity}/basis"], surface=False)
            (low, high), (lowest, highest) = self.ranges["poisson"], basis.poisson_range
            if not lowest <= low <= high <= highest:
                raise ValueError(
                    f"the basis of {object}, {solidity}, holds for Poisson's ratios {lowest:g} to {highest:g}, "
                    f"not {low:g} to {high:g}"
                )
            self._bases[key] = basis
            if len(self._bases) > self._kept:
                self._bases.popitem(last=False)
        self._bases.move_to_end(key)
        return self._bases[key]


def _bodies(reader: Reader) -> np.ndarray:
    """Return the positions of each body's first item, by object, the solid body first."""
    firsts = reader.items.firsts("object", "solidity")
    objects, solidities = (reader.items.column(name)[firsts] for name in ("object", "solidity"))
    return firsts[np.lexsort((solidities.among({"hollow"}), objects.ranks()))]


def _corrected(reader: Reader) -> bool:
    """Return whether the stored frequencies are corrected, if all shards agree."""
    said = {str(one.get("modes", {}).get("options", {}).get("corrected", True)) for one in reader.making()}
    return said != {"False"}
