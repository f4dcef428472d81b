"""What a stage is and how one runs: files in, files out, refusals passed on.

A stage module holds one :class:`Stage`. The command line builds its arguments from it, and
:func:`run` gives it the contracts every stage keeps: the log opens with the command that repeats it, refused
inputs are passed on at no cost, products appear whole or not at all, and a refusal is written where
the products would have been.
"""

from __future__ import annotations

import resource
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from vibraverse import __version__, products
from vibraverse.refusal import Refusal, Refused, read_refusal

if TYPE_CHECKING:
    from pydantic import BaseModel


@dataclass(frozen=True)
class Stage:
    """The contract of one stage.

    ``inputs`` and ``outputs`` map argument names to help texts; a name listed in ``many`` takes several
    paths. ``options`` is the stage's configuration section. ``libraries`` are the distributions whose
    versions its products state. With ``passes_refusals`` off the stage reads refused inputs itself. Inputs named in
    ``optional`` may be left out.
    """

    name: str
    help: str
    inputs: dict[str, str]
    outputs: dict[str, str]
    run: Callable[[Job], None]
    options: type[BaseModel] | None = None
    many: frozenset[str] = frozenset()
    optional: frozenset[str] = frozenset()
    libraries: tuple[str, ...] = ()
    per_object: bool = True
    per_solidity: bool = False
    passes_refusals: bool = True

    @property
    def version(self) -> int:
        """The stage's version; raising it in ``vibraverse.stages`` reruns the stage everywhere."""
        from vibraverse.stages import VERSIONS

        return VERSIONS[self.name]


@dataclass
class Job:
    """One run of a stage: resolved inputs, the paths to write to, the validated options.

    ``outputs`` are temporary paths beside the final ones; whatever the stage writes there is renamed
    into place when it returns.
    """

    stage: Stage
    object: str
    solidity: str
    inputs: dict[str, Path | list[Path]]
    final: dict[str, Path | list[Path]]
    options: BaseModel | None
    threads: int = 1
    outputs: dict[str, Path | list[Path]] = field(default_factory=dict)

    def provenance(self) -> dict:
        """Return versions, options and input checksums, the same for the same inputs."""
        versions = products.library_versions(self.stage.libraries)
        inputs = {}
        for name, value in self.inputs.items():
            if isinstance(value, list):
                inputs[name] = {path.name: products.sha256(path) for path in value}
            elif value is not None:
                inputs[name] = products.sha256(value)
        return {
            "stage": self.stage.name,
            "stage_version": self.stage.version,
            "vibraverse": __version__,
            "libraries": versions,
            "object": self.object,
            "solidity": self.solidity,
            "options": self.options.model_dump(mode="json") if self.options else {},
            "input_sha256": inputs,
        }

    def write_record(self, content: dict, output: str = "record") -> None:
        """Write the stage's JSON record: its findings, then its provenance."""
        products.write_json(self.outputs[output], {**content, "provenance": self.provenance()})


def _flat(paths: dict[str, Path | list[Path]]) -> list[Path]:
    flat: list[Path] = []
    for value in paths.values():
        flat.extend(value if isinstance(value, list) else [value] if value is not None else [])
    return flat


def _write_refusal(job: Job, refusal: Refusal) -> None:
    for path in _flat(job.final):
        products.write_text(path, refusal.to_text())
    print(f"refused ({refusal.reason}): {refusal.message} {refusal.advice}".strip(), file=sys.stderr)


def run(job: Job, command: list[str]) -> int:
    """Run a job and return its exit status: 0 for products or a refusal, else the machine failed."""
    print(shlex.join(command), file=sys.stderr, flush=True)
    for path in _flat(job.inputs):
        if not path.is_file():  # opening a pipe would wait for ever
            wrong = "is not a file" if path.exists() else "does not exist"
            print(f"{job.stage.name}: the input {path} {wrong}.", file=sys.stderr)
            return 2
    if job.stage.passes_refusals:
        for path in _flat(job.inputs):
            refusal = read_refusal(path)
            if refusal is not None:
                _write_refusal(job, refusal)
                return 0
    started = time.perf_counter()
    for path in _flat(job.final):
        path.parent.mkdir(parents=True, exist_ok=True)
        products.remove_partials(path)
    job.outputs = {
        name: [products.aside(path) for path in value] if isinstance(value, list) else products.aside(value)
        for name, value in job.final.items()
    }
    try:
        job.stage.run(job)
        for partial, final in zip(_flat(job.outputs), _flat(job.final), strict=True):
            products.publish(partial, final)
    except Refused as refused:
        _write_refusal(
            job,
            Refusal(
                job.object, job.stage.name, refused.reason, refused.message, refused.advice, job.solidity
            ),
        )
        return 0
    finally:
        for partial in _flat(job.outputs):
            partial.unlink(missing_ok=True)
    seconds = time.perf_counter() - started
    for path in _flat(job.final)[:8]:
        print(f"wrote {path}", file=sys.stderr)
    print(f"{job.stage.name}: done in {seconds:.1f} s, at most {_most_mb()} MB", file=sys.stderr)
    return 0


def _most_mb() -> int:
    """Return the most memory that this process or its largest child had, in MB; libraries count in both."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) // 1024
