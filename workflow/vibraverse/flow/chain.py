"""Which products an object has, in the order they are made, and where a refusal stands among them.

A refusal is copied down the chain, so the first refused product tells at which stage it began. The dataset, the
index and ``vibraverse refusals`` all ask here.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.step import BODY, OBJECT, Step
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.flow.steps import CHAIN


def chain_of(solidity: str = "") -> tuple[Step, ...]:
    """Return the stages of the object itself, or those of one of its bodies alone, in the order of the chain."""
    if not solidity:
        return tuple(step for step in CHAIN if step.per == OBJECT and not step.only)
    return tuple(step for step in CHAIN if step.per == BODY or step.only == solidity)


class Refusals(NamedTuple):
    """What is refused of one object: the whole of it, or single bodies, or nothing."""

    object: Refusal | None
    bodies: dict[str, Refusal]

    def is_refused(self, solidities) -> bool:
        """Whether nothing of the object is left: it is refused itself, or every one of its bodies is."""
        return self.object is not None or all(name in self.bodies for name in solidities)

    def rows(self, object_id: str) -> list[dict[str, str]]:
        """Return the rows of ``refusals.tsv``: one for the object, or one for each refused body."""
        found = {"": self.object} if self.object else self.bodies
        return [
            {
                "object": object_id,
                "solidity": solidity,
                "stage": refusal.stage,
                "reason": refusal.reason,
                "message": refusal.message,
                "advice": refusal.advice,
            }
            for solidity, refusal in found.items()
        ]


def refusals_of(paths: Paths, object_id: str, solidities=SOLIDITIES) -> Refusals:
    """Return what is refused of an object, by the first refused product of the object and of each body."""
    at_object = _first(paths, object_id)
    bodies = {}
    for solidity in solidities if at_object is None else ():
        refusal = _first(paths, object_id, solidity)
        if refusal is not None:
            bodies[solidity] = refusal
    return Refusals(at_object, bodies)


def stage_products(paths: Paths, object_id: str, solidities, folders: bool = False) -> list[str]:
    """Return one product per stage that worked on the object and on these bodies: those that state their provenance.

    With ``folders``, the folder where it lies in one: that is what Snakemake knows.
    """
    return [
        place if folders else str(step.outputs[step.record].record_in(Path(place)))
        for solidity in ("", *solidities)
        for step in chain_of(solidity)
        for place in [paths.named(step.outputs[step.record].pattern, object=object_id, solidity=solidity)]
    ]


def objects_in(paths: Paths) -> list[str]:
    """Return the ids of the objects that have products, sorted."""
    folder = Path(paths.at(paths.object, object="_")).parent
    return sorted(entry.name for entry in folder.iterdir() if entry.is_dir()) if folder.is_dir() else []


def shards_in(dataset: str | Path) -> list[Path]:
    """Return the shards in a dataset's folder, sorted, without those that a killed job left half-written."""
    return [shard for shard in sorted(Path(dataset, "shards").glob("*.h5")) if not shard.name.startswith(".")]


def _first(paths: Paths, object_id: str, solidity: str = "") -> Refusal | None:
    """Return the first refusal among the products of an object, or of a body: one stands in all of a stage's."""
    for step in chain_of(solidity):
        output = step.outputs[step.record]
        place = Path(paths.named(output.pattern, object=object_id, solidity=solidity))
        refusal = read_refusal(output.record_in(place))
        if refusal is not None:
            return refusal
    return None
