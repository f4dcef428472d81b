"""How a stage runs: files in, files out, refusals passed on.

:func:`run` gives every stage its contract: the log opens with the command that repeats it, refused inputs are passed on
at no cost, products appear whole or not at all, a refusal is written where the products would have been, and the
journal of the run says who works and what each job took.
"""

from __future__ import annotations

import os
import resource
import shlex
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from vibraverse import __version__
from vibraverse.contract import journal, products
from vibraverse.contract.errors import NotStored, Refused, UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.step import SHARD, Step

if TYPE_CHECKING:
    from pydantic import BaseModel

#: The file by which Snakemake keeps the time of a folder.
_TIMESTAMP = ".snakemake_timestamp"


@dataclass
class Job:
    """One run of a stage: resolved inputs, the paths to write to, the validated options.

    ``outputs`` are temporary paths beside the final ones, of folders there already; whatever the stage writes there is
    renamed into place when it returns. What must not happen before that, it puts into ``afterwards``; a killed job may
    leave it undone.
    """

    step: Step
    object: str
    solidity: str
    inputs: dict[str, Path | list[Path]]
    final: dict[str, Path]
    options: BaseModel | None
    threads: int = 1
    outputs: dict[str, Path] = field(default_factory=dict)
    afterwards: list[Callable[[], None]] = field(default_factory=list)

    @property
    def work_folder(self) -> Path:
        """Where :attr:`work` is, or would be: beside the first product."""
        return products.work_folder(next(iter(self.final.values())))

    @cached_property
    def work(self) -> Path:
        """The folder for what the stage keeps between attempts, made when first asked for.

        It survives a kill and a retry, and goes when the products are published. One that was begun with other inputs,
        options or versions is emptied. A file in it may be half-written: write those aside and rename them.
        """
        folder = self.work_folder
        begun, made_of = folder / "made-of.json", products.as_json(self.provenance())
        if not begun.is_file() or begun.read_text(encoding="utf-8") != made_of:
            products.remove(folder)
            folder.mkdir(parents=True)
            products.write_text(begun, made_of)
        return folder

    def provenance(self, *written: str) -> dict:
        """Return versions, options and checksums, the same for the same inputs.

        ``written`` names the outputs that are complete, besides the one that will hold this; their checksums are in it.
        """
        versions = products.library_versions(self.step.libraries)
        outputs = {"output_sha256": _checksums(self.outputs, written)} if written else {}
        return {
            "stage": self.step.name,
            "stage_version": self.step.version,
            "vibraverse": __version__,
            "libraries": versions,
            "object": self.object,
            "solidity": self.solidity,
            "options": self.options.model_dump(mode="json") if self.options else {},
            "input_sha256": _checksums(self.inputs, self.inputs),
            **outputs,
        }

    def write_record(self, content: dict) -> None:
        """Write the stage's JSON record: its findings, then its provenance."""
        record = self.step.outputs[self.step.record].record_in(self.outputs[self.step.record])
        written = [name for name, path in self.outputs.items() if path != record and path.exists()]
        products.write_json(record, {**content, "provenance": self.provenance(*written)})


def _checksums(files: Mapping[str, Path | list[Path]], names) -> dict:
    """Return the SHA-256 of files by argument; of several, and of those in a folder, by their names."""
    found = {}
    for name in names:
        path = files[name]
        several = path if isinstance(path, list) else sorted(path.iterdir()) if path.is_dir() else None
        if several is None:
            found[name] = products.sha256(path)
        else:
            found[name] = {one.name: products.sha256(one) for one in several}
    return found


def _flat(paths: dict[str, Path | list[Path]]) -> list[Path]:
    flat: list[Path] = []
    for value in paths.values():
        flat.extend(value if isinstance(value, list) else [value])
    return flat


def run(job: Job, work: Callable[[Job], None], command: list[str]) -> None:
    """Run a job, whose stage does ``work``; it ends with products, or with a refusal in their place.

    Raises :class:`UsageError` for inputs that do not exist and :class:`NotStored` where products cannot be written.
    """
    print(shlex.join(command), file=sys.stderr, flush=True)
    mark, outcome = _begin(job), journal.FAILED
    try:
        outcome = _run(job, work)
    finally:
        if mark is not None:
            journal.end(mark, outcome, _cpu_s(), _most_mb())


def _begin(job: Job) -> journal.Mark | None:
    """Let the journal of the run, where there is one, say that this job works."""
    shard = next(iter(job.final.values())).stem if job.step.per == SHARD else ""
    try:
        return journal.begin(job.step.name, job.object or shard, job.solidity)
    except OSError as error:
        said = products.not_stored(error, error.filename or "the journal of the run")
        raise NotStored(f"{job.step.name}: {said or error}") from error


def _run(job: Job, work: Callable[[Job], None]) -> str:
    """Run a job; return how it ended."""
    own = [path for name, path in job.inputs.items() if name not in job.step.chained]
    for path in _flat(job.inputs):
        wrong = unreadable(path, missing="name an existing file")
        # A closed file of the user's is the stage's to refuse.
        if wrong and not (path in own and path.is_file()):
            raise UsageError(f"{job.step.name}: the input {path} {wrong}")
    for name in job.step.folders:
        _check_ours(job.step, name, job.final[name])
    started, cpu_before = time.perf_counter(), _cpu_s()
    with _storing(job):
        passed_on = _passed_on(job)
        refused = passed_on or _make(job, work)
        products.remove(job.work_folder)
    if refused is not None:
        _tell(refused)
        return journal.PASSED_ON if passed_on else journal.REFUSED
    seconds = time.perf_counter() - started
    for path in job.final.values():
        print(f"wrote {path}", file=sys.stderr)
    print(
        f"{job.step.name}: done in {seconds:.1f} s, {_cpu_s() - cpu_before:.1f} s of CPU, at most {_most_mb()} MB",
        file=sys.stderr,
    )
    return journal.DONE


def _passed_on(job: Job) -> Refusal | None:
    """Put the refusal of an input, where there is one, in the products' place; return it."""
    for path in _flat(job.inputs) if job.step.passes_refusals else ():
        refusal = read_refusal(path)
        if refusal is not None:
            _write_refusal(job, refusal)
            return refusal
    return None


def _make(job: Job, work: Callable[[Job], None]) -> Refusal | None:
    """Make the products, or put a refusal in their place; return it."""
    for path in job.final.values():
        path.parent.mkdir(parents=True, exist_ok=True)
        products.remove_partials(path)
    job.outputs = {name: products.aside(path) for name, path in job.final.items()}
    refusal = None
    try:
        for name in job.step.folders:
            job.outputs[name].mkdir()
        work(job)
        for name, final in job.final.items():
            products.publish(job.outputs[name], final)
        for tidy in job.afterwards:
            tidy()
    except Refused as refused:
        about = refused.reason, refused.message, refused.advice
        refusal = Refusal(job.object, job.step.name, *about, job.solidity)
        _write_refusal(job, refusal)
    finally:
        for partial in job.outputs.values():
            products.remove(partial)
    return refusal


def _write_refusal(job: Job, refusal: Refusal) -> None:
    for name, path in job.final.items():
        output = job.step.outputs[name]
        with products.whole(path) as partial:
            if output.record:
                partial.mkdir()
            output.record_in(partial).write_text(refusal.to_text(), encoding="utf-8")


def _tell(refusal: Refusal) -> None:
    print(f"refused ({refusal.reason}): {refusal.message} {refusal.advice}".strip(), file=sys.stderr)


def _check_ours(step: Step, name: str, folder: Path) -> None:
    """Raise :class:`UsageError` where a folder that is to be replaced holds what the stage did not write."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{name}: {folder} is a file, but the stage writes a folder; name another one")
    record = step.outputs[name].record_in(folder)
    try:
        written = set(products.read_provenance(record)["output_sha256"][name])
    except (OSError, ValueError, LookupError, TypeError):
        written = set()  # no record, a refusal, or anything else
    found = {path.name for path in folder.iterdir()}
    strange = sorted(found - written - {record.name, _TIMESTAMP})
    if strange:
        raise UsageError(
            f"{name}: {folder} holds {strange[0]!r}, which this stage did not write; the folder is replaced as a "
            "whole, so name another one, or move that away"
        )


@contextmanager
def _storing(job: Job):
    """Say of which stage the products are that cannot be stored."""
    try:
        with products.storing(*job.final.values()):
            yield
    except NotStored as error:
        raise NotStored(f"{job.step.name}: {error}") from error


def _cpu_s() -> float:
    """Return the CPU seconds of this process, all its threads, and the children that it waited for."""
    return sum(os.times()[:4])


def _most_mb() -> int:
    """Return the most memory that this process or its largest child had, in MB; libraries count in both."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) // 1024
