"""What a stage is and how one runs: files in, files out, refusals passed on.

A stage module holds one :class:`Stage`. The command line builds its arguments from it, and
:func:`run` gives it the contracts every stage keeps: the log opens with the command that repeats it, refused
inputs are passed on at no cost, products appear whole or not at all, and a refusal is written where
the products would have been.
"""

from __future__ import annotations

import os
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

    def provenance(self, *written: str) -> dict:
        """Return versions, options and checksums, the same for the same inputs.

        ``written`` names the outputs that are complete, besides the one that will hold this; their checksums are in it.
        """
        versions = products.library_versions(self.stage.libraries)
        outputs = {"output_sha256": _checksums(self.outputs, self.final, written)} if written else {}
        return {
            "stage": self.stage.name,
            "stage_version": self.stage.version,
            "vibraverse": __version__,
            "libraries": versions,
            "object": self.object,
            "solidity": self.solidity,
            "options": self.options.model_dump(mode="json") if self.options else {},
            "input_sha256": _checksums(self.inputs, self.inputs, self.inputs),
            **outputs,
        }

    def write_record(self, content: dict, output: str = "record") -> None:
        """Write the stage's JSON record: its findings, then its provenance."""
        written = [name for name in self.outputs if name != output and _all_there(self.outputs[name])]
        products.write_json(self.outputs[output], {**content, "provenance": self.provenance(*written)})


Files = dict[str, Path | list[Path]]


def _checksums(files: Files, called: Files, names) -> dict:
    """Return the SHA-256 of files by argument; of several, by the names that they are ``called``."""
    found = {}
    for name in names:
        if isinstance(files[name], list):
            pairs = zip(called[name], files[name], strict=True)
            found[name] = {final.name: products.sha256(path) for final, path in pairs}
        elif files[name] is not None:
            found[name] = products.sha256(files[name])
    return found


def _all_there(paths: Path | list[Path]) -> bool:
    return all(path.is_file() for path in (paths if isinstance(paths, list) else [paths]))


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
    started, cpu_before = time.perf_counter(), _cpu_s()
    try:
        refused = _make(job)
    except Exception as error:
        said = _not_stored(job, error)
        if not said:
            raise
        print(f"{job.stage.name}: {said}", file=sys.stderr, flush=True)
        os._exit(1)  # HDF5 crashes at a process's end over what it could not write
    if refused:
        return 0
    seconds = time.perf_counter() - started
    for path in _flat(job.final)[:8]:
        print(f"wrote {path}", file=sys.stderr)
    cpu_s = _cpu_s() - cpu_before
    print(
        f"{job.stage.name}: done in {seconds:.1f} s, {cpu_s:.1f} s of CPU, at most {_most_mb()} MB",
        file=sys.stderr,
    )
    return 0


def _make(job: Job) -> bool:
    """Make the products, or put a refusal in their place; return whether it was refused."""
    for path in _flat(job.final):
        path.parent.mkdir(parents=True, exist_ok=True)
        products.remove_partials(path)
    job.outputs = {
        name: [products.aside(path) for path in value] if isinstance(value, list) else products.aside(value)
        for name, value in job.final.items()
    }
    try:
        job.stage.run(job)
        left = _left_over(job)
        for partial, final in zip(_flat(job.outputs), _flat(job.final), strict=True):
            products.publish(partial, final)
        for path in left:
            path.unlink(missing_ok=True)
    except Refused as refused:
        _write_refusal(
            job,
            Refusal(
                job.object, job.stage.name, refused.reason, refused.message, refused.advice, job.solidity
            ),
        )
        return True
    finally:
        for partial in _flat(job.outputs):
            partial.unlink(missing_ok=True)
    return False


def _left_over(job: Job) -> list[Path]:
    """Return what the record that lies there says was made beside it, and is not made now.

    A file counts only while its bytes are those of the record: no other is ours to remove.
    """
    several = job.stage.many & job.final.keys()
    if not several:
        return []
    record = job.final["record"]
    try:
        before = products.read_provenance(record)["output_sha256"]
        listed = {record.parent / name: sha256 for key in several for name, sha256 in before[key].items()}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return []  # no record, a refusal, or anything else
    made = {path.absolute() for path in _flat(job.final)}
    return [
        path
        for path, sha256 in listed.items()
        if path.absolute() not in made and path.is_file() and products.sha256(path) == sha256
    ]


def _not_stored(job: Job, error: Exception) -> str:
    """Return the sentence for an error that means that the products cannot be stored; empty for any other."""
    finals = _flat(job.final)
    if isinstance(error, PermissionError):  # which may as well mean an input
        where = str(error.filename)
        if where not in map(str, _flat(job.outputs)) and not any(
            path.is_relative_to(where) for path in finals
        ):
            return ""
    return products.not_stored(error, finals[0])


def _cpu_s() -> float:
    """Return the CPU seconds of this process, all its threads, and the children that it waited for."""
    return sum(os.times()[:4])


def _most_mb() -> int:
    """Return the most memory that this process or its largest child had, in MB; libraries count in both."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) // 1024
