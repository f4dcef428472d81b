"""Which bodies are trained on, validated on and tested, for every split.

``object`` follows the splits of the dataset: an object's bodies and its copies are on one side. ``family-K`` tests on
whole families: they are dealt into folds by the hashes of their names, and the fold K is tested. Siblings of
a family differ in a few numbers, so a split by object alone measures how well a network interpolates between them.

Origins that are held out are never trained on; they are a test of their own, ``held_out``, whatever the split.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vibraverse.contract.seeds import stable_hash

TRAIN, VALIDATION, TEST, HELD_OUT = SIDES = ("train", "validation", "test", "held_out")
#: One of so many objects of a fold's training side is validated on.
_VALIDATED = 10


class TooFew(ValueError):
    """A side without bodies, in one sentence that says what to change."""


def sides(samples, split: str, splits: Mapping[str, Mapping[str, str]], folds: int, hold_out: Sequence[str]):
    """Return the numbers of the bodies on every side: ``train``, ``validation``, ``test``, ``held_out``.

    ``splits`` maps every object to its row of ``splits.tsv``. Raises :class:`TooFew` if ``train``, ``validation`` or
    ``test`` is empty.
    """
    if split == "object":
        of_object = {object_: row["split"] for object_, row in splits.items()}
    else:
        of_object = _by_family(samples, int(split.removeprefix("family-")), splits, folds)
    held = np.isin(samples.origin, list(hold_out))
    side = np.array([of_object[object_] for object_ in samples.object])
    found = {name: np.flatnonzero((side == name) & ~held) for name in (TRAIN, VALIDATION, TEST)}
    found[HELD_OUT] = np.flatnonzero(held)
    for name in (TRAIN, VALIDATION, TEST):
        if not len(found[name]):
            raise TooFew(
                f"the split {split!r} of {len(set(samples.object))} objects leaves no body for {name}; add objects"
                + (
                    f", or lower learn.folds below {folds}: there are {len(set(samples.family))} families"
                    if split != "object"
                    else f", or raise the share of {name} in dataset.splits"
                )
            )
    return found


def _by_family(samples, fold: int, splits, folds: int) -> dict[str, str]:
    """Return the side of every object when a fold of the families is tested.

    A copy goes where its original goes, so that no shape is on two sides.
    """
    family = dict(zip(samples.object, samples.family, strict=True))
    first = {object_: splits[object_]["copy_of"] or object_ for object_ in family}
    families = sorted(set(family.values()), key=lambda name: stable_hash(name, "fold"))
    fold_of = {name: number % folds for number, name in enumerate(families)}
    tested = {one for one, original in first.items() if fold_of[family.get(original, family[one])] == fold}
    trained = sorted(
        {first[one] for one in first.keys() - tested}, key=lambda one: stable_hash(one, "validation")
    )
    validated = set(trained[: -(-len(trained) // _VALIDATED)])
    return {
        one: TEST if one in tested else VALIDATION if original in validated else TRAIN
        for one, original in first.items()
    }
