"""Mode shapes as a reader sees them: made from the body's modal basis and the material's coefficients in it.

Stored as they are they would be half of a dataset. A basis takes longer to read than the shapes of one material to
make, so that of the last body is kept: materials of one body come one after the other.
"""

from __future__ import annotations

from vibraverse.files.modes import read_mode_shapes, read_surface


class Shapes:
    """Reads mode shapes; keeps one surface of some megabytes."""

    def __init__(self):
        self._key, self._surface = None, None

    def surface(self, body, key) -> tuple:
        """Return basis and corrections on the surface; ``body`` is the HDF5 group that ``key`` stands for."""
        if self._key != key:
            self._key, self._surface = key, read_surface(body["basis"])
        return self._surface

    def read(self, body, key, material: str):
        """Return the mode shapes (m, V, 3) of a named material. Raises :class:`KeyError` where there is no such one."""
        return read_mode_shapes(body, self.surface(body, key), material)
