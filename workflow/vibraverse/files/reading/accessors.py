"""The numbers of a glTF 2.0 document: accessors view buffers, and a sparse accessor replaces some of their rows."""

from __future__ import annotations

import numpy as np

from vibraverse.files.reading.bounds import MAX_PARTS, Bounds
from vibraverse.files.reading.document import Fields, data_uri

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Accessors:
    """The accessors of a document, read on demand; ``binary`` is the buffer without a URI."""

    def __init__(self, document: Fields, binary: bytes, bounds: Bounds):
        self.document, self.binary, self.bounds = document, binary, bounds
        self._buffers: dict[int, bytes] = {}

    def rows(self, number: int, type_: str, zeros: bool = False) -> np.ndarray:
        """Return the rows (count, columns) of an accessor.

        An accessor without data stands for zeros by the specification. Positions have data unless they are compressed,
        so it is a mistake without ``zeros``.
        """
        accessor = self.document.item("accessors", number)
        if accessor.text("type") != type_:
            raise ValueError(f"accessors[{number}] is {accessor.text('type'):.20} and should be {type_}")
        count, dtype, columns = accessor.whole("count"), _component(accessor), _COLUMNS[type_]
        if "bufferView" in accessor:
            rows = self._view(accessor, dtype, columns, count)
            self._check(type_, count)
        elif zeros or "sparse" in accessor:
            self._check(type_, count)
            rows = np.zeros((count, columns), dtype)
        else:
            raise ValueError(f"accessors[{number}] has no data; the mesh may be compressed")
        if "sparse" in accessor:
            rows = self._changed(rows, accessor.fields("sparse"))
        if accessor.true("normalized") and dtype.kind in "iu":
            rows = np.maximum(rows / np.iinfo(dtype).max, -1.0)
        return rows

    def has_data(self, number: int) -> bool:
        """Return whether an accessor has a buffer view or sparse values."""
        accessor = self.document.item("accessors", number)
        return "bufferView" in accessor or "sparse" in accessor

    def _changed(self, rows: np.ndarray, sparse: Fields) -> np.ndarray:
        """Return the rows of an accessor with the replacements of its ``sparse``."""
        changes, places = sparse.whole("count"), sparse.fields("indices")
        at = self._view(places, _component(places), 1, changes)[:, 0]
        if len(at) and (at.dtype.kind != "u" or at.max() >= len(rows)):
            raise ValueError(f"its {sparse.where} has indices beyond its {len(rows)} rows")
        rows = rows.copy()
        rows[at] = self._view(sparse.fields("values"), rows.dtype, rows.shape[1], changes)
        return rows

    def _check(self, type_: str, count: int) -> None:
        """Raise :class:`TooLarge` for more vertices or indices, ``ValueError`` for more matrices than the limits."""
        if type_ == "SCALAR":
            self.bounds.check(triangles=count // 3)
        elif type_ == "MAT4":
            if count > MAX_PARTS:
                raise ValueError(f"it has a skin of {count} joints; the limit is {MAX_PARTS}")
        else:
            self.bounds.check(vertices=count)

    def _view(self, place: Fields, dtype: np.dtype, columns: int, count: int) -> np.ndarray:
        """Return the numbers (count, columns) of a buffer view, without a copy."""
        view = self.document.item("bufferViews", place.whole("bufferView"))
        buffer = self._buffer(view.whole("buffer"))
        begin = view.whole("byteOffset", 0)
        end = begin + view.whole("byteLength")
        begin += place.whole("byteOffset", 0)
        row = dtype.itemsize * columns
        stride = view.whole("byteStride", 0) or row
        needed = (count - 1) * stride + row if count else 0
        if begin + needed > min(end, len(buffer)):
            raise ValueError("an accessor reaches beyond its buffer: the file seems cut off")
        if count < 2:  # the stride is unused, so it may have any value
            stride = row
        return np.ndarray((count, columns), dtype, buffer, begin if count else 0, (stride, dtype.itemsize))

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            buffer = self.document.item("buffers", number)
            self._buffers[number] = data_uri(buffer.text("uri")) if "uri" in buffer else self.binary
        return self._buffers[number]


def _component(accessor: Fields) -> np.dtype:
    """Return the type of the numbers of an accessor."""
    number = accessor.whole("componentType")
    if number not in _COMPONENTS:
        raise ValueError(f"its {accessor.where}.componentType is {number}, which glTF does not know")
    return np.dtype(_COMPONENTS[number])
