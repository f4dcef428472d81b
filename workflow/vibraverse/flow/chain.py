"""The chain of an object: its products in the order they are made, and the refusals among them.

A refusal is copied down the chain, so the first refused product shows the stage that refused. The dataset, the index
and ``vibraverse refusals`` use this module.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.step import BODY, OBJECT, Step
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.flow.steps import CHAIN


def chain_of(solidity: str = "") -> tuple[Step, ...]:
    """Return the stages of the object, or with ``solidity`` those of that body alone, in the order of the chain."""
    if not solidity:
        return tuple(step for step in CHAIN if step.per == OBJECT and not step.only)
    return tuple(step for step in CHAIN if step.per == BODY or step.only == solidity)


class Refusals(NamedTuple):
    """The refusals of one object: of the whole object, of single bodies, or none."""

    object: Refusal | None
    bodies: dict[str, Refusal]

    def is_refused(self, solidities) -> bool:
        """Return whether nothing of the object is left: it is refused as a whole, or each of its bodies is."""
        return self.object is not None or all(name in self.bodies for name in solidities)

    def rows(self, object_id: str) -> list[dict[str, str]]:
        """Return the rows of ``refusals.tsv``: one for the whole object, or one per refused body."""
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
    """Return the refusals of an object, from the first refused product of the object and of each body."""
    at_object = _first(paths, object_id)
    bodies = {}
    for solidity in solidities if at_object is None else ():
        refusal = _first(paths, object_id, solidity)
        if refusal is not None:
            bodies[solidity] = refusal
    return Refusals(at_object, bodies)


def stage_products(paths: Paths, object_id: str, solidities, folders: bool = False) -> list[str]:
    """Return the record of each stage of the object and of these bodies.

    With ``folders``, return the folder of a record that lies in one, because Snakemake knows only the folder.
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
    """Return the shards in a dataset's folder, sorted, without the partial files of killed jobs."""
    return [shard for shard in sorted(Path(dataset, "shards").glob("*.h5")) if not shard.name.startswith(".")]


def _first(paths: Paths, object_id: str, solidity: str = "") -> Refusal | None:
    """Return the first refusal among the records of an object or a body; all products of a stage hold the same one."""
    for step in chain_of(solidity):
        output = step.outputs[step.record]
        place = Path(paths.named(output.pattern, object=object_id, solidity=solidity))
        refusal = read_refusal(output.record_in(place))
        if refusal is not None:
            return refusal
    return None
