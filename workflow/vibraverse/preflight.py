"""Whether what a run asks for is there, said in one sentence before its first job: Apptainer, images, Slurm, GPUs.

A job that cannot start waits in a queue, or fails with the words of a tool that its owner may never have called. What
can be known before is asked here, of the jobs that will run and nothing else.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from vibraverse import containers, gpus, products
from vibraverse.commands import DEFAULT_CONFIG, advised, counted
from vibraverse.config import ConfigError, read
from vibraverse.texts import unknown

if TYPE_CHECKING:
    from vibraverse.plan import Plan

#: The Slurm job that this process is part of, if any: by itself, and as its array. Read when this is imported, for
#: Snakemake's Slurm plugin deletes the variables before a run's first job.
_OWN_JOBS = {os.environ.get("SLURM_JOB_ID"), os.environ.get("SLURM_ARRAY_JOB_ID")}


class NotThere(Exception):
    """Something that the run needs is not there; the message says what, and the remedy."""


def stop_without(check, *arguments):
    """Run a check and return what it finds; end the process with its sentence and exit status 2 where it fails."""
    try:
        return check(*arguments)
    except (NotThere, ConfigError) as missing:
        print(f"vibraverse: {missing}", file=sys.stderr)
        sys.exit(2)


@contextmanager
def readable(path: str):
    """Let Snakemake read a configuration; where it cannot, end the process with a sentence that names file and line."""
    try:
        yield
    except Exception:
        if os.path.exists(path):  # Snakemake itself names one that is not there
            stop_without(read, path)
        raise


def configuration(path: str, text: str) -> None:
    """Write the resolved configuration, the run's first file."""
    try:
        products.write_text(path, text)
    except OSError as error:
        raise NotThere(products.not_stored(error, path) or str(error)) from None


def known(plan: Plan, configs: Sequence[str | Path], kind: str, name: str) -> str:
    """Return the name of an object or a shard that a file is asked for, where the run has one of that name.

    Snakemake's patterns match any name, and rules' functions would end with a ``KeyError``. ``configs`` are the files
    of ``--configfile``.
    """
    there, more = (plan.objects if kind == "object" else plan.shards), ""
    if name in there or (kind == "object" and _is_source(plan, name)):
        return name
    if kind == "object":
        file = configs[-1] if configs else None
        more += f"; {advised('objects', config=file)} lists those that {file or DEFAULT_CONFIG} names"
    if plan.owned is not None:
        more += f"; this run is slice {plan.config.slice} of all"
    raise NotThere(f"a file is asked for of an {unknown(kind, name, there)}{more}")


def _is_source(plan: Plan, name: str) -> bool:
    """Whether a product of an object that is no longer configured is the mesh file of one that is.

    Snakemake then asks how to make it, and is content to find that nothing does.
    """
    folder = Path(plan.paths.at(plan.paths.object, object=name)).absolute()
    return any(entry.input and folder in entry.input.absolute().parents for entry in plan.objects.values())


def apptainer() -> None:
    """Check that images can be run, and named."""
    if containers.binary() is None:
        raise NotThere(
            "the profile asks for containers, but there is no command apptainer on the PATH; install Apptainer "
            "(or load its module), or run without containers: --workflow-profile workflow/profiles/default"
        )
    if containers.image("any") is None:
        raise NotThere(
            f"the images' folder {containers.folder()} has a space in its name, which Snakemake cannot pass on; "
            "put them elsewhere and set VIBRAVERSE_IMAGES to that folder"
        )


def images(urls: Iterable[str]) -> None:
    """Check that each image file is there and made of this checkout; images in a registry are taken as named."""
    named = {containers.image(family): family for family in containers.FAMILIES}
    for url in sorted(set(urls)):
        if "://" not in url and url in named:
            difference = containers.differences(named[url], url)
            if difference:
                raise NotThere(
                    f"the image {url} {difference}; run `make containers`, then the same command again"
                )


def shards(missing: list[str]) -> None:
    """Check that the slices of a run have made all shards."""
    if missing:
        raise NotThere(
            f"`slice: join` takes the shards that the slices made, but {len(missing)} of them are not there "
            f"({', '.join(Path(path).name for path in missing[:5])}{', …' if len(missing) > 5 else ''}); run the "
            "slices again, or without `slice` to make everything that is missing"
        )


def local_gpus(jobs: Iterable[tuple[str, Mapping]]) -> None:
    """Check that this machine has as many of NVIDIA's GPUs as any of the jobs (rule, resources) asks for."""
    if sys.platform == "darwin" or os.path.exists("/dev/kfd"):  # Apple's, AMD's
        return
    asked = {}
    for rule, resources in jobs:
        if resources.get("gpu"):
            asked[rule] = max(asked.get(rule, 0), int(resources["gpu"]))
    for rule, count in sorted(asked.items()):
        try:
            gpus.enough_of(count)
        except gpus.NoGPU as missing:
            raise NotThere(f"the rule {rule}: {missing}") from None


def slurm(jobs: Iterable[tuple[str, Mapping]], folder: str | Path = ".") -> None:
    """Check that Slurm answers, has what jobs (rule, resources) ask for, and no earlier run's jobs in ``folder``."""
    there, default = partitions()
    no_earlier_jobs(Path(folder).resolve())
    asked = {}
    for rule, resources in jobs:
        gpus = resources.get("gpu") or ("gpu" in str(resources.get("gres", "")))
        partition = resources.get("slurm_partition") or default
        key = (rule, partition, bool(gpus))
        asked[key] = max(asked.get(key, 0), int(resources.get("mem_mb") or 0))
    for (rule, chosen, gpus), memory_mb in sorted(asked.items(), key=str):
        for name in (chosen or "").split(",") if chosen else []:
            if name not in there:
                raise NotThere(
                    f"Slurm has no partition {name!r}, which the rule {rule} asks for; there are: "
                    f"{', '.join(sorted(there))}. Set slurm_partition in the profile"
                )
            memory, has_gpus = there[name]
            if gpus and not has_gpus:
                others = [other for other, (_, has) in sorted(there.items()) if has]
                raise NotThere(
                    f"the rule {rule} asks for a GPU, but the partition {name} has none; "
                    + (f"GPUs are in: {', '.join(others)}" if others else "no partition has one")
                    + f". Set slurm_partition or gpu of {rule} in the profile's set-resources"
                )
            if memory_mb > memory:
                raise NotThere(
                    f"the rule {rule} asks for {memory_mb} MB, but the largest node of the partition {name} has "
                    f"{memory} MB; choose another partition, or set its mem_mb in the profile's set-resources"
                )


def _ask(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except FileNotFoundError:
        raise NotThere(
            f"the profile asks for Slurm, but there is no command {command[0]} here; log in to the cluster's "
            "submit node, or run without it: --workflow-profile workflow/profiles/default"
        ) from None
    except subprocess.TimeoutExpired:
        done = subprocess.CompletedProcess(command, 1, "", "no answer within 60 s")
    if done.returncode != 0:
        words = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise NotThere(f"Slurm does not answer ({words}); `scontrol ping` tells more, nothing was submitted")
    return done.stdout


def partitions() -> tuple[dict[str, tuple[int, bool]], str | None]:
    """Return name -> (MB of the largest node, whether it has GPUs), and the default partition."""
    found: dict[str, tuple[int, bool]] = {}
    default = None
    for line in _ask("sinfo", "-h", "-o", "%P|%m|%G").splitlines():
        name, memory, gres = line.split("|")
        if name.endswith("*"):
            name = default = name[:-1]
        old = found.get(name, (0, False))
        found[name] = (max(old[0], int(memory.rstrip("+"))), old[1] or "gpu" in gres)
    return found, default


def no_earlier_jobs(folder: Path) -> None:
    """Check that no job of a run that was killed still writes here: it and this run would disturb each other."""
    queue = _ask("squeue", "-h", "-u", str(os.getuid()), "-t", "PENDING,RUNNING,COMPLETING", "-o", "%i|%Z")
    jobs = (line.split("|", 1) for line in queue.splitlines())
    left = [job for job, where in jobs if where == str(folder) and re.match(r"\d+", job)[0] not in _OWN_JOBS]
    if left:
        raise NotThere(
            f"an earlier run still has {counted(len(left), 'Slurm job')} in {folder}; wait for its end (`squeue --me` "
            f"shows it), or end it with `scancel {' '.join(left[:20])}`, then repeat the command"
        )
