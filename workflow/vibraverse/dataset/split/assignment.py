"""The assignment of splits, from stable hashes of object ids.

Neither time nor order nor other objects matter, so a growing dataset moves no object. Everything made from one object
has the same split. So do the copies of one shape (:mod:`vibraverse.dataset.split.copies`): all take the split of the
first of them, or of one that was kept from an earlier dataset.

A rule that never moves an object can use its id alone; then the shares of a small stratum are a matter of chance.
Stratified splits keep the shares in every stratum and pay with a few moves. The shapes of a stratum are sorted by their
hashes and cut by the shares, so a new shape moves at most one other at each cut.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from vibraverse.contract.seeds import stable_hash


class Splits(NamedTuple):
    """The split of every object, the first of its copies (or itself), and the kept objects that had to move."""

    split: dict[str, str]
    first: dict[str, str]
    moved: list[str]

    def rows(self) -> list[dict[str, str]]:
        """Return the rows of ``splits.tsv``."""
        return [
            {"object": one, "split": split, "copy_of": "" if self.first[one] == one else self.first[one]}
            for one, split in sorted(self.split.items())
        ]

    def summary(self) -> dict:
        """Return the counts of copies for ``dataset.json``."""
        sizes = Counter(self.first.values())
        copies = sum(sizes.values()) - len(sizes)
        return {
            "shapes": len(sizes),
            "copies": copies,
            "most_of_one_shape": max(sizes.values(), default=0),
            "not_kept": self.moved,
        }


def split_of(object_id: str, splits: dict[str, float]) -> str:
    """Return the split of an object that is not a copy; ``splits`` maps names to shares that add up to 1.

    The hash is a number in [0, 1); the splits divide that interval in the order listed.
    """
    return _split_at(_place(object_id), splits)


def assign(
    first: dict[str, str],
    splits: dict[str, float],
    strata: dict[str, str] | None = None,
    kept: dict[str, str] | None = None,
) -> Splits:
    """Return the splits of all objects; ``first`` maps each to the first of its copies.

    With ``strata`` (object to stratum) every stratum is divided in the shares of ``splits``; a shape belongs to the
    stratum of its first object. ``kept`` are splits of an earlier dataset: they stay, and copies follow them. If copies
    were kept in different splits, the first kept one decides, and the others are listed in ``moved``.
    """
    kept = kept or {}
    members: dict[str, list[str]] = {}
    for object_id, leader in first.items():
        members.setdefault(leader, []).append(object_id)
    decided = {}
    for leader, copies in members.items():
        before = [kept[one] for one in copies if one in kept]
        if before:
            decided[leader] = before[0]
    if strata is None:
        for leader in members.keys() - decided.keys():
            decided[leader] = split_of(leader, splits)
    else:
        for stratum in sorted(set(map(strata.get, members))):
            inside = {leader: len(copies) for leader, copies in members.items() if strata[leader] == stratum}
            decided.update(_cut(inside, splits, decided))
    split = {object_id: decided[leader] for object_id, leader in first.items()}
    return Splits(split, first, sorted(one for one in kept if one in split and split[one] != kept[one]))


def emptiness(objects: dict[str, int]) -> str:
    """Return the sentence about splits without objects and how to fill them; "" if there are none.

    ``objects`` counts objects by split; for a dataset without objects the result is "".
    """
    names = [name for name, count in objects.items() if not count]
    if not names or len(names) == len(objects):
        return ""
    which = f"The split {names[0]} holds" if len(names) == 1 else f"The splits {' and '.join(names)} hold"
    return (
        f"{which} no object: take more objects, give {'it' if len(names) == 1 else 'them'} a larger share in "
        "dataset.splits, or set dataset.stratify to origin, which keeps to the shares within every source."
    )


def _cut(sizes: dict[str, int], splits: dict[str, float], decided: dict[str, str]) -> dict[str, str]:
    """Return the split of every undecided shape of a stratum; ``sizes`` maps shapes to numbers of copies."""
    total = sum(sizes.values())
    room = {name: share * total for name, share in splits.items()}
    for leader in sizes.keys() & decided.keys():
        if decided[leader] in room:
            room[decided[leader]] -= sizes[leader]
    room = {name: max(0.0, left) for name, left in room.items()}
    free = sorted(sizes.keys() - decided.keys(), key=lambda leader: (_place(leader), leader))
    whole, behind, found = sum(sizes[leader] for leader in free), 0, {}
    left = sum(room.values())
    shares = {name: value / left for name, value in room.items()} if left else splits
    for leader in free:
        found[leader] = _split_at((behind + 0.5 * sizes[leader]) / whole, shares)
        behind += sizes[leader]
    return found


def _place(object_id: str) -> float:
    return stable_hash(object_id, "split") / 2**64


def _split_at(position: float, splits: dict[str, float]) -> str:
    names = [name for name, share in splits.items() if share > 0]
    for name in names:
        position -= splits[name]
        if position < 0:
            return name
    return names[-1]
