"""Which bodies are trained on, validated on and tested, for every split.

``object`` follows the splits of the dataset: an object's bodies and its copies are on one side. ``shuffled-K`` deals
the objects into folds by the hashes of their names, and tests the fold K. ``family-K`` does the same with whole
families: siblings of a family differ in a few numbers, so a split by object alone measures how well a network
interpolates between them.

Origins that are held out are never trained on; they are a test of their own, ``held_out``, whatever the split. Families
that are left out are on no side.
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


def sides(
    samples,
    split: str,
    splits: Mapping[str, Mapping[str, str]],
    folds: int,
    hold_out: Sequence[str] = (),
    leave_out: Sequence[str] = (),
) -> dict[str, np.ndarray]:
    """Return the numbers of the bodies on every side: ``train``, ``validation``, ``test``, ``held_out``.

    ``splits`` maps every object to its row of ``splits.tsv``. Raises :class:`TooFew` if ``train``, ``validation`` or
    ``test`` is empty.
    """
    first = {object_: splits[object_]["copy_of"] or object_ for object_ in samples.object.tolist()}
    family = dict(zip(samples.object.tolist(), samples.family.tolist(), strict=True))
    kind, _, fold = split.partition("-")
    if kind == "object":
        of_object = {object_: row["split"] for object_, row in splits.items()}
    else:
        group = {
            one: family.get(original, family[one]) if kind == "family" else original
            for one, original in first.items()
        }
        of_object = _folded(first, group, int(fold), folds)
    held = np.isin(samples.origin, list(hold_out))
    seen = ~held & ~np.isin(samples.family, list(leave_out))
    side = np.array([of_object[object_] for object_ in samples.object])
    found = {name: np.flatnonzero((side == name) & seen) for name in (TRAIN, VALIDATION, TEST)}
    found[HELD_OUT] = np.flatnonzero(held)
    for name in (TRAIN, VALIDATION, TEST):
        if not len(found[name]):
            raise TooFew(
                f"the split {split!r} of {len(set(samples.object[seen]))} objects leaves no body for {name}; "
                "add objects"
                + (
                    f", or raise the share of {name} in dataset.splits"
                    if kind == "object"
                    else f", or lower learn.folds below {folds}: there are {len(set(samples.family[seen]))} families"
                )
            )
    return found


def _folded(first: dict[str, str], group: dict[str, str], fold: int, folds: int) -> dict[str, str]:
    """Return the side of every object when a fold of the groups is tested.

    ``first`` maps an object to its original, so that no shape is on two sides; ``group`` to its group, that of the
    original.
    """
    groups = sorted(set(group.values()), key=lambda name: stable_hash(name, "fold"))
    fold_of = {name: number % folds for number, name in enumerate(groups)}
    tested = {one for one in first if fold_of[group[one]] == fold}
    trained = sorted(
        {first[one] for one in first.keys() - tested}, key=lambda one: stable_hash(one, "validation")
    )
    validated = set(trained[: -(-len(trained) // _VALIDATED)])
    return {
        one: TEST if one in tested else VALIDATION if original in validated else TRAIN
        for one, original in first.items()
    }
