"""Sentences."""

from __future__ import annotations

from vibraverse.contract.texts import unknown


def test_few_known_names_are_listed_in_their_order():
    assert unknown("look", "clai", ("steel", "clay")) == (
        "unknown look 'clai'; did you mean 'clay'? (known: steel, clay)"
    )
    assert unknown("object", "bar", []) == "unknown object 'bar' (known: none)"


def test_of_many_known_names_the_nearest_are_listed():
    said = unknown(
        "object", "bar-012", (f"{kind}-{number:04d}" for kind in ("cup", "bar") for number in range(500))
    )
    assert said.startswith("unknown object 'bar-012'; did you mean 'bar-0")
    assert said.endswith(", and 980 more)")
    assert "cup" not in said
