"""The step: a stage's inputs, outputs, record and options. The table of all stages is ``flow/steps.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

#: What a stage has one job for: an object, one of its bodies, a shard, the dataset, an object or a body on the page, a
#: body with known frequencies, the whole validation, a training, a split of a task, a part of a split, or all of
#: learning.
(
    OBJECT,
    BODY,
    SHARD,
    DATASET,
    SHOWN_OBJECT,
    SHOWN_BODY,
    KNOWN_BODY,
    VALIDATION,
    TRAINING,
    COMPARISON,
    PART,
    LEARNING,
) = (
    "object",
    "body",
    "shard",
    "dataset",
    "shown object",
    "shown body",
    "known body",
    "validation",
    "training",
    "comparison",
    "part",
    "learning",
)
#: What its products' paths carry.
_WILDCARDS = {
    OBJECT: ("object",),
    BODY: ("object", "solidity"),
    SHARD: ("shard",),
    SHOWN_OBJECT: ("object",),
    SHOWN_BODY: ("object", "solidity"),
    KNOWN_BODY: ("body",),
    TRAINING: ("task", "split", "model", "seed"),
    COMPARISON: ("task", "split"),
    PART: ("split", "part"),
}


def option(name: str) -> str:
    """Return the command-line option that names an input or output."""
    return f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class Input:
    """A file that a stage reads: what it holds, and the pattern of its path (an attribute of ``Paths``).

    Without a pattern it is the user's own file. ``many`` allows several files, ``optional`` allows none. For a folder,
    ``record`` is the name of the record file in it, which states the checksums of the others; the stage gets its path.
    """

    pattern: str
    help: str
    many: bool = False
    optional: bool = False
    record: str = ""

    def file(self, place: Path) -> Path:
        """Return the file that stands for the input at ``place``: itself, or the record in a folder."""
        return place / self.record if self.record else place


@dataclass(frozen=True)
class Output:
    """A product of a stage: the name of its pattern in ``Paths``, its path below the results folder, what it holds.

    The path carries the wildcards of the step. For a folder, ``record`` is the name of the record file in it.
    """

    pattern: str
    path: str
    help: str
    record: str = ""
    optional: bool = False

    def record_in(self, place: Path) -> Path:
        """Return the path that holds the refusal of the product at ``place``: itself, or the record in a folder."""
        return place / self.record if self.record else place


@dataclass(frozen=True, eq=False)
class Step:
    """The contract of one stage; ``run(job)`` in ``vibraverse.stages.<name>`` does its work.

    Raise ``version`` when products change for the same inputs: it reruns the stage everywhere. ``per`` is what the
    stage has one job for, ``only`` the one body that needs it. ``family`` names its environment and image. ``record``
    is the output that states the provenance. ``options`` is its configuration section, as ``module:Class`` below
    ``vibraverse.config``. ``libraries`` are the distributions whose versions products state. ``imports`` are the
    modules that its work loads. ``packed`` is the path of its record within an object's group of a shard. Without
    ``passes_refusals`` the stage reads refused inputs itself. With ``gpus`` it can use GPUs, and is told their number.
    """

    name: str
    version: int
    help: str
    per: str
    family: str
    inputs: Mapping[str, Input]
    outputs: Mapping[str, Output]
    record: str = ""
    options: str = ""
    libraries: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
    only: str = ""
    packed: str = ""
    passes_refusals: bool = True
    gpus: bool = False
    wildcards: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self):
        object.__setattr__(self, "wildcards", _WILDCARDS.get(self.per, ()))

    @property
    def chained(self) -> dict[str, Input]:
        """The inputs that other stages make."""
        return {name: input_ for name, input_ in self.inputs.items() if input_.pattern}

    @property
    def folders(self) -> dict[str, Output]:
        """The outputs that are folders."""
        return {name: output for name, output in self.outputs.items() if output.record}

    def bodies(self, solidities: tuple[str, ...]) -> tuple[str, ...]:
        """Return the bodies that the stage has jobs for; "" stands for the whole object."""
        return solidities if self.per == BODY else ("",)
