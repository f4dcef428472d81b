"""What the tests of learning share."""

from __future__ import annotations

#: The file that takes longest begins first, so that the other processes do not wait for it at the end.
_FIRST = "test_learning_run.py"


def pytest_collection_modifyitems(items: list) -> None:
    """Put the longest file in front; the others keep their order."""
    items.sort(key=lambda item: item.path.name != _FIRST)
