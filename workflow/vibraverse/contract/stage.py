"""The runner of a stage: files in, files out, refusals passed on.

:func:`run` keeps the contract of every stage. The log opens with the command that repeats the job. Refused inputs are
passed on at no cost. Products appear whole or not at all; a refusal takes their place. The journal of the run says
which jobs work and what each took.
"""

from __future__ import annotations

import os
import resource
import shlex
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import contextmanager, suppress
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

#: The file in which Snakemake keeps the modification time of a folder.
_TIMESTAMP = ".snakemake_timestamp"


@dataclass
class Job:
    """One run of a stage: resolved inputs, the paths to write to, the validated options.

    ``outputs`` are temporary paths beside the final ones; folders exist already. They are renamed into place when the
    stage returns. ``afterwards`` holds what must not happen before that; it may remain undone when the job is killed.
    """

    step: Step
    object: str
    solidity: str
    inputs: dict[str, Path | list[Path]]
    final: dict[str, Path]
    options: BaseModel | None
    threads: int = 1
    gpus: int = 0
    outputs: dict[str, Path] = field(default_factory=dict)
    afterwards: list[Callable[[], None]] = field(default_factory=list)

    @property
    def work_folder(self) -> Path:
        """The path of :attr:`work`, which may not exist: beside the first product."""
        return products.work_folder(next(iter(self.final.values())))

    @cached_property
    def work(self) -> Path:
        """The folder for what the stage keeps between attempts, made on first use.

        It survives a kill and a retry, and is removed when the products are published. A folder from other inputs,
        options or versions is emptied. A kill may leave half-written files in it: write aside and rename.
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

        ``written`` names the complete outputs whose checksums it includes; the one that will hold it is none of them.
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
    """Return the SHA-256 of files by argument; for a list and for a folder, by argument and file name.

    Files of one name get their folder's name too.
    """
    found = {}
    for name in names:
        path = files[name]
        several = path if isinstance(path, list) else sorted(path.iterdir()) if path.is_dir() else None
        if several is None:
            found[name] = products.sha256(path)
        else:
            alike = len({one.name for one in several}) < len(several)
            found[name] = {
                f"{one.parent.name}/{one.name}" if alike else one.name: products.sha256(one)
                for one in several
            }
    return found


def _flat(paths: dict[str, Path | list[Path]]) -> list[Path]:
    flat: list[Path] = []
    for value in paths.values():
        flat.extend(value if isinstance(value, list) else [value])
    return flat


def run(job: Job, work: Callable[[Job], None], command: list[str]) -> None:
    """Run a job by calling ``work`` of its stage; it ends with products, or with a refusal in their place.

    Raises :class:`UsageError` for inputs that do not exist and :class:`NotStored` if products cannot be written.
    """
    print(shlex.join(command), file=sys.stderr, flush=True)
    mark, outcome = _begin(job), journal.FAILED
    try:
        outcome = _run(job, work)
    finally:
        if mark is not None:
            journal.end(mark, outcome, _cpu_s(), _peak_mb())


def _begin(job: Job) -> journal.Mark | None:
    """Mark this job as begun in the journal of its run, if a run started it."""
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
        # The stage itself refuses a user's file that exists but cannot be read.
        if wrong and not (path in own and path.is_file()):
            raise UsageError(f"{job.step.name}: the input {path} {wrong}")
    for name in job.step.folders:
        _check_replaceable(job.step, name, job.final[name])
    started, cpu_before = time.perf_counter(), _cpu_s()
    with _storing(job):
        passed_on = _pass_on(job)
        refused = passed_on or _make(job, work)
        products.remove(job.work_folder)
    if refused is not None:
        _print_refusal(refused)
        return journal.PASSED_ON if passed_on else journal.REFUSED
    seconds = time.perf_counter() - started
    for path in job.final.values():
        print(f"wrote {path}", file=sys.stderr)
    print(
        f"{job.step.name}: done in {seconds:.1f} s, {_cpu_s() - cpu_before:.1f} s of CPU, at most {_peak_mb()} MB",
        file=sys.stderr,
    )
    return journal.DONE


def _pass_on(job: Job) -> Refusal | None:
    """Write the refusal of an input in the products' place; return it, or None if no input is refused."""
    for path in _flat(job.inputs) if job.step.passes_refusals else ():
        refusal = read_refusal(path)
        if refusal is not None:
            _write_refusal(job, refusal)
            return refusal
    return None


def _make(job: Job, work: Callable[[Job], None]) -> Refusal | None:
    """Make the products, or write a refusal in their place; return the refusal, or None."""
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


def _print_refusal(refusal: Refusal) -> None:
    print(f"refused ({refusal.reason}): {refusal.message} {refusal.advice}".strip(), file=sys.stderr)


def _check_replaceable(step: Step, name: str, folder: Path) -> None:
    """Raise :class:`UsageError` if an existing output folder holds files that the stage did not write."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{name}: {folder} is a file, but the stage writes a folder; name another one")
    record = step.outputs[name].record_in(folder)
    try:
        written = set(products.read_provenance(record)["output_sha256"][name])
    except (OSError, ValueError, LookupError, TypeError):
        written = set()  # no record, a refusal, or something unknown
    found = {path.name for path in folder.iterdir()}
    strange = sorted(found - written - {record.name, _TIMESTAMP})
    if strange:
        raise UsageError(
            f"{name}: {folder} holds {strange[0]!r}, which this stage did not write; the folder is replaced as a "
            "whole, so name another one, or move that away"
        )


@contextmanager
def _storing(job: Job):
    """Prefix the error about products that cannot be stored with the stage's name."""
    try:
        with products.storing(*job.final.values()):
            yield
    except NotStored as error:
        raise NotStored(f"{job.step.name}: {error}") from error


def _cpu_s() -> float:
    """Return the CPU time in seconds of this process with all its threads and the children that it waited for."""
    return sum(os.times()[:4])


def _peak_mb() -> int:
    """Return the peak memory of this process or its largest child in MB; libraries count in both.

    The kernel's ``ru_maxrss`` of a process also counts the program that started it: a job of a large process would seem
    as large. So this process's own peak is read from ``/proc`` where that exists.
    """
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with suppress(OSError), open("/proc/self/status", encoding="ascii", errors="replace") as file:
        own = next((int(line.split()[1]) for line in file if line.startswith("VmHWM:")), own)
    return max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) // 1024
