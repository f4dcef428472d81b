"""Access to groups, texts and values of an HDF5 file whose bytes may be wrong; raises ``ValueError`` for damage.

h5py raises ``TypeError`` for a type that NumPy lacks. Here that is distinguished from a programming error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import h5py


@contextmanager
def _typed(name: str) -> Iterator[None]:
    """Turn h5py's ``TypeError`` into a ``ValueError``; only calls of h5py may run within it."""
    try:
        yield
    except TypeError as error:
        raise ValueError(f"{name} has a type that cannot be read ({error})") from None


def group(parent, name: str) -> h5py.Group:
    """Return a group."""
    found = parent[name]
    if not isinstance(found, h5py.Group):
        raise ValueError(f"{name} is no group")
    return found


def members(parent, name: str) -> Mapping:
    """Return the members of a group by name; empty if the group does not exist."""
    found = parent.get(name)
    return found if isinstance(found, h5py.Group) else {}


def text(parent, name: str) -> str:
    """Return a text."""
    return text_of(parent[name], name)


def text_of(item, name: str) -> str:
    """Return the text that a dataset holds."""
    with _typed(name):
        is_text = isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype) and item.shape == ()
    if not is_text:
        raise ValueError(f"{name} is no text")
    return item.asstr()[()]


def value(item, name: str):
    """Return the value of a dataset."""
    if not isinstance(item, h5py.Dataset):
        raise ValueError(f"{name} is neither a group nor an array")
    with _typed(name):
        found = item[()]
    return _held(found, name)


def attribute(item, key: str, name: str):
    """Return an attribute."""
    with _typed(name):
        found = item.attrs[key]
    return _held(found, name)


def shaped(item, name: str) -> h5py.Dataset:
    """Return a dataset whose type and shape are known."""
    with _typed(name):
        known = item.dtype is not None and item.shape is not None
    if not known:
        raise ValueError(f"{name} holds nothing")
    return item


def _held(found, name: str):
    if isinstance(found, h5py.Empty):
        raise ValueError(f"{name} holds nothing")
    return found
