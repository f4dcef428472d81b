"""What a stage promises: its inputs, outputs, record and options. The table of all stages is ``flow/steps.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

#: What there is one job for: an object, a body of it, a shard, the dataset, a body whose frequencies are known, all
#: of these.
OBJECT, BODY, SHARD, DATASET, KNOWN_BODY, VALIDATION = (
    "object",
    "body",
    "shard",
    "dataset",
    "known body",
    "validation",
)


def option(name: str) -> str:
    """Return the option of the command line by which an input or output is named."""
    return f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class Input:
    """A file that a stage reads: what it holds, and the pattern of its path (an attribute of ``Paths``).

    Without a pattern it is the user's own file. ``many`` files may be named at once, an ``optional`` one left out.
    """

    pattern: str
    help: str
    many: bool = False
    optional: bool = False


@dataclass(frozen=True)
class Output:
    """A product of a stage: the name of its pattern in ``Paths``, its path below the results folder, what it holds.

    The path bears the wildcards of the step. A folder of files names the file in it that is its ``record``.
    """

    pattern: str
    path: str
    help: str
    record: str = ""
    optional: bool = False

    def record_in(self, place: Path) -> Path:
        """Return where a refusal stands for the product at ``place``: there, or in the record of a folder."""
        return place / self.record if self.record else place


@dataclass(frozen=True, eq=False)
class Step:
    """The contract of one stage, whose work is ``run(job)`` in ``vibraverse.stages.<name>``.

    ``version`` reruns the stage everywhere when it is raised: raise it when products change for the same inputs.
    ``per`` is what there is one job for, and ``only`` the one body that needs it. ``family`` names its environment and
    image. ``record`` is the output that states the provenance. ``options`` names its configuration section, as
    ``module:Class`` below ``vibraverse.config``. ``libraries`` are the distributions whose versions products state,
    ``imports`` the modules that its work loads, and ``packed`` is where an object's group of a shard holds its record.
    With ``passes_refusals`` off the stage reads refused inputs itself.
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
    wildcards: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self):
        wildcards = {
            OBJECT: ("object",), BODY: ("object", "solidity"), SHARD: ("shard",), KNOWN_BODY: ("body",),
        }  # fmt: skip
        object.__setattr__(self, "wildcards", wildcards.get(self.per, ()))

    @property
    def chained(self) -> dict[str, Input]:
        """The inputs that other stages make."""
        return {name: input_ for name, input_ in self.inputs.items() if input_.pattern}

    @property
    def folders(self) -> dict[str, Output]:
        """The outputs that are folders."""
        return {name: output for name, output in self.outputs.items() if output.record}

    def bodies(self, solidities: tuple[str, ...]) -> tuple[str, ...]:
        """Return the bodies that the stage has a job for; "" for a job of the whole object."""
        return solidities if self.per == BODY else ("",)
