"""JSON documents with type-checked fields.

A damaged file may hold anything anywhere, so every value is checked before use. A mistake raises ``ValueError`` that
names its place: ``its accessors[3].count is "x" and not a whole number``.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator

_REQUIRED = object()
#: Most characters of a wrong value in a message.
_MAX_SHOWN = 40


class Fields:
    """The fields of a JSON object by name; ``where`` is its place in the document, which itself is at "".

    ``null`` counts as missing. A field without a default is required; an optional list is empty by default.
    """

    def __init__(self, value, where: str = ""):
        if not isinstance(value, dict):
            raise _wrong(where or "JSON", value, "an object")
        self.value, self.where = value, where

    def __contains__(self, name: str) -> bool:
        return self.value.get(name) is not None

    def whole(self, name: str, default=_REQUIRED) -> int:
        """Return a non-negative whole number."""
        return _whole(self._get(name, default), self._at(name))

    def text(self, name: str, default=_REQUIRED) -> str:
        """Return a string."""
        return _text(self._get(name, default), self._at(name))

    def true(self, name: str) -> bool:
        """Return whether the field exists and is true."""
        value = self._get(name, False)
        if not isinstance(value, bool):
            raise _wrong(self._at(name), value, "true or false")
        return value

    def numbers(self, name: str, count: int) -> list[float]:
        """Return a list of ``count`` numbers."""
        values = self._list(name, _REQUIRED)
        if len(values) != count:
            raise ValueError(f"its {self._at(name)} has {len(values)} numbers and should have {count}")
        return [_number(value, f"{self._at(name)}[{i}]") for i, value in enumerate(values)]

    def wholes(self, name: str) -> list[int]:
        """Return a list of whole numbers."""
        return [_whole(value, f"{self._at(name)}[{i}]") for i, value in enumerate(self._list(name))]

    def texts(self, name: str) -> list[str]:
        """Return a list of strings."""
        return [_text(value, f"{self._at(name)}[{i}]") for i, value in enumerate(self._list(name))]

    def fields(self, name: str) -> Fields:
        """Return an object."""
        return Fields(self._get(name, _REQUIRED), self._at(name))

    def items(self, name: str) -> Iterator[Fields]:
        """Yield the objects of a list."""
        for i, value in enumerate(self._list(name)):
            yield Fields(value, f"{self._at(name)}[{i}]")

    def item(self, name: str, number: int) -> Fields:
        """Return one object of a list."""
        values = self._list(name)
        if number >= len(values):
            raise ValueError(f"it has no {self._at(name)}[{number}]")
        return Fields(values[number], f"{self._at(name)}[{number}]")

    def count(self, name: str) -> int:
        """Return the length of a list."""
        return len(self._list(name))

    def _at(self, name: str) -> str:
        return f"{self.where}.{name}" if self.where else name

    def _get(self, name: str, default):
        value = self.value.get(name)
        value = default if value is None else value
        if value is _REQUIRED:
            raise ValueError(f"its {self.where or 'JSON'} lacks {name}")
        return value

    def _list(self, name: str, default=()) -> list:
        value = self._get(name, default)
        if value is not default and not isinstance(value, list):
            raise _wrong(self._at(name), value, "a list")
        return value


def parse(text: bytes) -> Fields:
    """Return the document that a JSON text holds."""
    try:
        return Fields(json.loads(text))
    except UnicodeDecodeError:
        raise ValueError("it is no text") from None
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None


def _whole(value, where: str) -> int:
    if type(value) is not int or value < 0:
        raise _wrong(where, value, "a whole number from 0")
    return value


def _text(value, where: str) -> str:
    if not isinstance(value, str):
        raise _wrong(where, value, "a text")
    return value


def _number(value, where: str) -> float:
    if type(value) not in (int, float):
        raise _wrong(where, value, "a number")
    try:
        return float(value)
    except OverflowError:
        raise _wrong(where, value, "a number that a double holds") from None


def _wrong(where: str, value, kind: str) -> ValueError:
    shown = json.dumps(value, ensure_ascii=False) if not isinstance(value, (dict, list)) else "a list"
    if isinstance(value, dict):
        shown = "an object"
    return ValueError(f"its {where} is {shown[:_MAX_SHOWN]} and not {kind}")


def data_uri(uri: str) -> bytes:
    """Return the bytes in a data URI; raises ``ValueError`` for the name of a file."""
    if not uri.startswith("data:"):
        raise ValueError(f"it refers to {uri[:60]!r}, which is not in it")
    return base64.b64decode(uri.partition(",")[2])
