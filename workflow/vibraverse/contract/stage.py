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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from vibraverse import __version__
from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal, Refused, read_refusal

if TYPE_CHECKING:
    from pydantic import BaseModel


#: The file by which Snakemake keeps the time of a folder.
_TIMESTAMP = ".snakemake_timestamp"


@dataclass(frozen=True)
class Stage:
    """The contract of one stage.

    ``inputs`` and ``outputs`` map argument names to help texts. An input listed in ``many`` takes several paths, one in
    ``optional`` may be left out; an output in ``folders`` is a folder of files, and the name there is that of its
    record. ``options`` is the stage's configuration section. ``libraries`` are the distributions whose versions its
    products state. With ``passes_refusals`` off the stage reads refused inputs itself.
    """

    name: str
    help: str
    inputs: dict[str, str]
    outputs: dict[str, str]
    run: Callable[[Job], None]
    options: type[BaseModel] | None = None
    many: frozenset[str] = frozenset()
    folders: Mapping[str, str] = field(default_factory=dict)
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

    def record_at(self, output: str, place: Path) -> Path:
        """Return where a refusal stands for the product at ``place``: there, or in the record of a folder."""
        return place / self.folders[output] if output in self.folders else place


@dataclass
class Job:
    """One run of a stage: resolved inputs, the paths to write to, the validated options.

    ``outputs`` are temporary paths beside the final ones, of folders there already; whatever the stage writes there is
    renamed into place when it returns.
    """

    stage: Stage
    object: str
    solidity: str
    inputs: dict[str, Path | list[Path]]
    final: dict[str, Path]
    options: BaseModel | None
    threads: int = 1
    outputs: dict[str, Path] = field(default_factory=dict)

    def provenance(self, *written: str) -> dict:
        """Return versions, options and checksums, the same for the same inputs.

        ``written`` names the outputs that are complete, besides the one that will hold this; their checksums are in it.
        """
        versions = products.library_versions(self.stage.libraries)
        outputs = {"output_sha256": _checksums(self.outputs, written)} if written else {}
        return {
            "stage": self.stage.name,
            "stage_version": self.stage.version,
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
        output = next(iter(self.stage.folders), "record")
        record = self.stage.record_at(output, self.outputs[output])
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
        flat.extend(value if isinstance(value, list) else [value] if value is not None else [])
    return flat


def _write_refusal(job: Job, refusal: Refusal) -> None:
    for name, path in job.final.items():
        with products.whole(path) as partial:
            if name in job.stage.folders:
                partial.mkdir()
            job.stage.record_at(name, partial).write_text(refusal.to_text(), encoding="utf-8")
    print(f"refused ({refusal.reason}): {refusal.message} {refusal.advice}".strip(), file=sys.stderr)


def run(job: Job, command: list[str]) -> int:
    """Run a job and return its exit status: 0 for products or a refusal, else the machine failed."""
    print(shlex.join(command), file=sys.stderr, flush=True)
    for path in _flat(job.inputs):
        if not path.is_file():  # opening a pipe would wait for ever
            wrong = "is not a file" if path.exists() else "does not exist"
            print(f"{job.stage.name}: the input {path} {wrong}.", file=sys.stderr)
            return 2
    for name in job.stage.folders:
        _check_ours(job.stage, name, job.final[name])
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
    for path in job.final.values():
        print(f"wrote {path}", file=sys.stderr)
    cpu_s = _cpu_s() - cpu_before
    print(
        f"{job.stage.name}: done in {seconds:.1f} s, {cpu_s:.1f} s of CPU, at most {_most_mb()} MB",
        file=sys.stderr,
    )
    return 0


def _make(job: Job) -> bool:
    """Make the products, or put a refusal in their place; return whether it was refused."""
    for path in job.final.values():
        path.parent.mkdir(parents=True, exist_ok=True)
        products.remove_partials(path)
    job.outputs = {name: products.aside(path) for name, path in job.final.items()}
    try:
        for name in job.stage.folders:
            job.outputs[name].mkdir()
        job.stage.run(job)
        for name, final in job.final.items():
            products.publish(job.outputs[name], final)
    except Refused as refused:
        _write_refusal(
            job,
            Refusal(
                job.object, job.stage.name, refused.reason, refused.message, refused.advice, job.solidity
            ),
        )
        return True
    finally:
        for partial in job.outputs.values():
            products.remove(partial)
    return False


def _check_ours(stage: Stage, name: str, folder: Path) -> None:
    """Raise :class:`UsageError` where a folder that is to be replaced holds what the stage did not write."""
    from vibraverse.cli import UsageError

    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{name}: {folder} is a file, and the stage writes a folder; name another one")
    record = stage.record_at(name, folder)
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


def _not_stored(job: Job, error: Exception) -> str:
    """Return the sentence for an error that means that the products cannot be stored; empty for any other."""
    finals = list(job.final.values())
    if isinstance(error, PermissionError):  # which may as well mean an input
        where = Path(str(error.filename))
        inside = any(where.is_relative_to(path) for path in job.outputs.values())
        if not inside and not any(path.is_relative_to(where) for path in finals):
            return ""
    return products.not_stored(error, finals[0])


def _cpu_s() -> float:
    """Return the CPU seconds of this process, all its threads, and the children that it waited for."""
    return sum(os.times()[:4])


def _most_mb() -> int:
    """Return the most memory that this process or its largest child had, in MB; libraries count in both."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) // 1024
