"""``vibraverse submit``: submit slices of a run as one Slurm array job, and a job that joins their shards.

Each element of the array is an ordinary run of one slice on its node, with as many parallel jobs as it has cores. So
Slurm gets a few long jobs instead of hundreds of thousands of short ones, and no process has to monitor them.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import yaml

from vibraverse.config import load
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.contract.slices import JOIN
from vibraverse.flow.plan import Plan
from vibraverse.flow.resources import CLASSES
from vibraverse.machine import containers, preflight, slurm
from vibraverse.machine.containers import PROJECT

#: Memory in MB for Snakemake itself and the warm process, with a margin: a slice of 1,000 objects takes a third of a
#: gigabyte, the warm process two thirds.
SNAKEMAKE_MB = 1500
#: Default memory in MB per core.
CORE_MB = 4000
#: Memory in MB of the job that joins.
JOIN_MB = CLASSES["collect"][0] + SNAKEMAKE_MB
#: Variables of Slurm's commands that the user sets; Slurm sets the others inside a job.
_USER_VARIABLES = ("SLURM_CONF", "SLURM_CLUSTERS", "SLURM_JWT")
#: Options of sbatch that this command also has, and the variables with their defaults. This command passes on what they
#: say in the script, because sbatch gives the variables precedence over the script.
_SBATCH_VARIABLES = {
    "partition": "SBATCH_PARTITION",
    "account": "SBATCH_ACCOUNT",
    "qos": "SBATCH_QOS",
    "time": "SBATCH_TIMELIMIT",
}


def parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = argparse.ArgumentParser(
        prog="vibraverse submit",
        description="Submit a run to Slurm as an array of slices, then a job that joins what they made. To go on after "
        "an accident, give the same command again.",
        epilog="What stands after -- is given to snakemake for every slice.",
    )
    p.add_argument("--slices", type=int, required=True, metavar="N", help="elements of the array")
    p.add_argument("--cores", type=int, default=8, metavar="N", help="cores of each (default %(default)s)")
    p.add_argument(
        "--mem-mb",
        type=int,
        metavar="MB",
        help=f"memory of each (default {CORE_MB} per core, and Snakemake's own)",
    )
    p.add_argument(
        "--configfile", "--config", default="config.yaml", metavar="FILE", help="default %(default)s"
    )
    p.add_argument(
        "--profile",
        type=Path,
        default=PROJECT / "workflow/profiles/default",
        metavar="DIR",
        help="profile of each run inside its element: default, or apptainer (default %(default)s)",
    )
    p.add_argument("--partition", metavar="NAME", help="default: SBATCH_PARTITION, else the cluster's")
    p.add_argument("--account", metavar="NAME", help="default: SBATCH_ACCOUNT, else yours")
    p.add_argument("--qos", metavar="NAME", help="quality of service (default: SBATCH_QOS, else yours)")
    p.add_argument(
        "--time",
        metavar="TIME",
        help="time of each, as sbatch takes it (default: SBATCH_TIMELIMIT, else the partition's)",
    )
    p.set_defaults(**{option: os.environ.get(variable) for option, variable in _SBATCH_VARIABLES.items()})
    p.add_argument("--at-most", type=int, metavar="N", help="elements that run at once (default: all)")
    p.add_argument("--sbatch", default="", metavar="OPTIONS", help="more options of sbatch, as one word")
    p.add_argument("--dry-run", action="store_true", help="print the scripts, submit nothing")
    p.add_argument("snakemake", nargs="*", metavar="ARGUMENT", help="given to snakemake for every slice")
    return p


def main(argv: list[str]) -> int:
    """Submit the array and its join, or print their scripts."""
    chosen = parser().parse_args(argv)
    config = _checked(chosen)
    logs = Path(config.results) / "logs/slices"
    slices, join = slices_script(chosen, logs), join_script(chosen, logs)
    if chosen.dry_run:
        print(slices, join, sep="\n", end="")
        return 0
    _check_slurm(chosen)
    logs.mkdir(parents=True, exist_ok=True)
    array = _sbatch(slices)
    # afterany: if slices failed, the join names the missing files.
    try:
        last = _sbatch(join, f"--dependency=afterany:{array}")
    except UsageError as error:
        ended = subprocess.run(["scancel", array], capture_output=True).returncode == 0
        left = f"job {array}, are cancelled" if ended else f"job {array}, are still queued: `scancel {array}`"
        raise UsageError(f"{error}; the slices that it was to join, {left}") from None
    print(f"Submitted {chosen.slices} slices as job {array}, and job {last} that joins what they make.")
    print(
        f"Watch them with `squeue --me`; what each says is in {logs}. To go on after an accident: the same command."
    )
    return 0


def slices_script(chosen: argparse.Namespace, logs: Path) -> str:
    """Return the script of the array."""
    at_once = f"%{chosen.at_most}" if chosen.at_most else ""
    return _script(
        chosen,
        "vibraverse-slice",
        [f"--array=1-{chosen.slices}{at_once}", f"--output={logs}/%a.log"],
        chosen.cores,
        _memory_mb(chosen),
        chosen.snakemake,
        f'"slice=$SLURM_ARRAY_TASK_ID/{chosen.slices}"',
    )


def join_script(chosen: argparse.Namespace, logs: Path) -> str:
    """Return the script of the last job."""
    return _script(chosen, "vibraverse-join", [f"--output={logs}/join.log"], 1, JOIN_MB, [], f"slice={JOIN}")


def _script(
    chosen: argparse.Namespace,
    name: str,
    options: list[str],
    cores: int,
    memory_mb: int,
    arguments: list[str],
    key: str,
) -> str:
    asked = [f"--job-name={name}", *options, "--ntasks=1", f"--cpus-per-task={cores}", f"--mem={memory_mb}"]
    asked += [f"--{option}={value}" for option in _SBATCH_VARIABLES if (value := getattr(chosen, option))]
    command = [
        sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile"),
        "--workflow-profile", str(chosen.profile.absolute()), "--configfile", str(Path(chosen.configfile).absolute()),
        "--resources", f"mem_mb={memory_mb - SNAKEMAKE_MB}", "--cores", str(cores), *arguments,
    ]  # fmt: skip
    lines = [
        "#!/bin/bash",
        *(f"#SBATCH {option if ' ' not in option else shlex.quote(option)}" for option in asked),
        *([f"#SBATCH {chosen.sbatch}"] if chosen.sbatch else []),
        f"export PATH={shlex.quote(str(Path(sys.executable).parent))}:$PATH",
        f"cd {shlex.quote(str(Path.cwd()))}",
        f"exec {shlex.join(command)} --config {key}",
    ]
    return "\n".join(lines) + "\n"


def _memory_mb(chosen: argparse.Namespace) -> int:
    """Return the memory in MB of an array element: enough for its cores and for the largest job."""
    largest = max(memory for memory, _ in CLASSES.values())
    return chosen.mem_mb or max(CORE_MB * chosen.cores, largest) + SNAKEMAKE_MB


def _checked(chosen: argparse.Namespace):
    """Return the configuration; raise :class:`UsageError` if the request is wrong."""
    for option in ("slices", "cores", "at_most"):
        value = getattr(chosen, option)
        if value is not None and value < 1:
            raise UsageError(f"--{option.replace('_', '-')} must be at least 1, not {value}")
    if chosen.mem_mb is not None and chosen.mem_mb <= SNAKEMAKE_MB:
        raise UsageError(
            f"--mem-mb must be more than the {SNAKEMAKE_MB} that Snakemake itself may take, not {chosen.mem_mb}"
        )
    settings = chosen.profile / "config.yaml"
    if wrong := unreadable(settings, missing="choose one of workflow/profiles"):
        raise UsageError(f"{chosen.profile} is not a profile: {settings} {wrong}")
    executor = (yaml.safe_load(settings.read_text(encoding="utf-8")) or {}).get("executor", "local")
    if executor != "local":
        raise UsageError(
            f"the profile {chosen.profile} hands jobs to {executor}, but each element of the array runs its slice on "
            "its own node; take workflow/profiles/default or workflow/profiles/apptainer"
        )
    for argument in chosen.snakemake:
        if found := re.match(r"--config(files?)?(?==|$)|-C", argument):
            raise UsageError(
                f"{found[0]} cannot stand after --, where the slice's own would replace it; write what it sets into "
                f"{chosen.configfile}, or name another file with --configfile before --"
            )
    config = load(chosen.configfile)
    if config.slice is not None:
        raise UsageError(f"{chosen.configfile} names a slice already ({config.slice}); leave the key out")
    Plan({**config.model_dump(), "slice": f"1/{chosen.slices}"})
    return config


def _check_slurm(chosen: argparse.Namespace) -> None:
    """Check that Slurm has the requested resources, and that no earlier run works here."""
    try:
        there, default = slurm.partitions()
        slurm.no_earlier_jobs(Path.cwd())
        if _in_containers(chosen) and containers.binary():  # without it, each slice checks on its node
            preflight.images([image for family in containers.FAMILIES if (image := containers.image(family))])
    except preflight.NotThere as missing:
        raise UsageError(str(missing)) from None
    asked = [
        ("each slice", _memory_mb(chosen), "give fewer --cores, or --mem-mb"),
        ("the join", JOIN_MB, "choose another --partition"),
    ]
    names = chosen.partition or default
    for name in names.split(",") if names else []:
        if name not in there:
            raise UsageError(
                f"Slurm has no partition {name!r}; choose --partition from: {', '.join(sorted(there))}"
            )
        largest = there[name].memory_mb
        for job, memory_mb, remedy in asked:
            if largest < memory_mb:
                raise UsageError(
                    f"{job} would ask for {memory_mb} MB, but the largest node of the partition {name} has "
                    f"{largest} MB; {remedy}"
                )


def _in_containers(chosen: argparse.Namespace) -> bool:
    """Return whether the profile runs jobs in images."""
    profile = yaml.safe_load((chosen.profile / "config.yaml").read_text(encoding="utf-8")) or {}
    asked = profile.get("software-deployment-method", profile.get("sdm", []))
    return "apptainer" in ([asked] if isinstance(asked, str) else asked)


def _sbatch(script: str, *options: str) -> str:
    """Submit a script; return the job's id."""
    # Inside another job, that job's settings must not be inherited; the user's own SBATCH_* are in the script.
    environment = {
        key: value
        for key, value in os.environ.items()
        if key in _USER_VARIABLES or not key.startswith(("SLURM_", "SBATCH_"))
    }
    done = subprocess.run(
        ["sbatch", "--parsable", *options], input=script, capture_output=True, text=True, env=environment
    )
    if done.returncode != 0:
        raise UsageError(
            f"Slurm refused the job: {' '.join(done.stderr.split())}; change the options that it names"
        )
    return done.stdout.strip().split(";")[0]
