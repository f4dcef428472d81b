"""Mode shapes in a reader: computed from the body's modal basis and the material's coefficients in it.

Stored in full, they would be half of a dataset. Reading a basis takes longer than computing the shapes of one material,
so the basis of the last body is cached: the materials of a body are read one after the other.
"""

from __future__ import annotations

from vibraverse.files.modes import read_mode_shapes, read_surface


class Shapes:
    """A reader of mode shapes; caches one surface basis of a few megabytes."""

    def __init__(self):
        self._key, self._surface = None, None

    def surface(self, body, key) -> tuple:
        """Return basis and corrections on the surface of the HDF5 group ``body``, which is cached under ``key``."""
        if self._key != key:
            self._key, self._surface = key, read_surface(body["basis"])
        return self._surface

    def read(self, body, key, material: str):
        """Return the mode shapes (m, V, 3) of a named material; raise :class:`KeyError` if it does not exist."""
        return read_mode_shapes(body, self.surface(body, key), material)
