"""The command ``vibraverse``: one subcommand per stage, and a few for people.

A subcommand's module is imported only when it is asked for, so that ``--help`` answers at once and the thread
settings stand before any numerical library starts.
"""

from __future__ import annotations

import importlib
import itertools
import os
import sys

from vibraverse import __version__
from vibraverse.machine.compiled import use_compiled_loops

#: Stage subcommands: name -> one line of help. The module is ``vibraverse.stages.<name>``.
STAGES = {
    "sources": "fetch or generate one object's mesh, with where it came from",
    "clean": "make a closed, oriented, manifold surface in [-1, 1]³",
    "grids": "voxelise the surface and measure the signed distance",
    "hollow": "take the inside out of the body",
    "tets": "fill a surface with tetrahedra",
    "basis": "solve for the material-independent modal basis",
    "modes": "frequencies, damping and mode shapes of every material",
    "audio": "render the impact sounds",
    "images": "render views of the outside",
    "dataset": "pack objects into one HDF5 shard",
    "index": "write the dataset's index, refusals and record",
    "report": "write the page people open",
    "validation_meshes": "mesh a body whose frequencies are known, coarse to fine",
    "validation_modes": "compare a body's frequencies with those it must have",
    "validation_table": "join the comparisons of all bodies, and plot them",
}

#: Subcommands for people: name -> one line of help. The module is ``vibraverse.commands.<name>``.
COMMANDS = {
    "strike": "hear a mesh: from a file to its impact sound in one go",
    "objects": "list the objects a configuration names",
    "materials": "list the known materials",
    "export": "write the dataset as WebDataset tars or for Hugging Face datasets",
    "config": "check a configuration, or print its JSON schema",
    "submit": "submit a run to Slurm as an array of slices",
    "resources": "suggest memory, time and group sizes from a run's own measurements",
    "gpus": "list the GPUs here, or run a command with some of its own",
    "check": "say whether a dataset is whole, to the last byte, and agrees with itself",
    "status": "say how far a run is, and how long the rest takes",
    "provenance": "trace a product back to its source, with versions and commands",
    "join": "show several datasets as one, without copying them",
    "repair": "say which products must be made again, and delete them so that they are",
    "refusals": "list refused objects by reason, or make them run again",
    "validation": "show how near the frequencies of known bodies are",
}

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "LP_NUM_THREADS",  # Mesa's software renderer
)

#: Libraries choose loops by the processor, and each rounds in its own way: a level set whose axes turn by 1e-9 may be
#: remade quite differently. With these every processor with AVX2 takes the same loops.
ROUNDING = {
    "MKL_CBWR": "AVX2,STRICT",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}


class UsageError(Exception):
    """A mistake in what was asked for: one sentence, exit code 2, nothing written."""


def _overview() -> str:
    def table(rows):
        return "\n".join(f"  {name:<17} {text}" for name, text in rows.items())

    return (
        "usage: vibraverse COMMAND …      (vibraverse COMMAND --help tells more)\n\n"
        "From meshes to shapes, modes, impact sounds and pictures that agree by physics.\n\n"
        f"For people:\n{table(COMMANDS)}\n\nStages, as the workflow calls them:\n{table(STAGES)}\n"
    )


def set_threads(threads: int) -> None:
    """Fix the thread count, and the rounding, before any numerical library is loaded."""
    for variable in _THREAD_VARIABLES:
        os.environ[variable] = str(threads)
    set_rounding()


def set_rounding() -> None:
    """Let libraries take the same loops as on other processors; before any of them is loaded."""
    if {"avx2", "fma"} <= _processor_flags():
        for variable, value in ROUNDING.items():
            os.environ.setdefault(variable, value)


def _processor_flags() -> set[str]:
    """Return what the processor is capable of, in the kernel's words; nothing where the system does not say."""
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            return next((set(line.split()) for line in file if line.startswith("flags")), set())
    except OSError:
        return set()


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    argv = sys.argv[1:] if argv is None else argv
    set_rounding()
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_overview(), end="")
        return 0
    if argv[0] in ("-V", "--version"):
        print(f"vibraverse {__version__}")
        return 0
    name, rest = argv[0], argv[1:]
    if name in STAGES and os.environ.get("VIBRAVERSE_WARM"):
        from vibraverse.machine import warm

        status = warm.ask(os.environ["VIBRAVERSE_WARM"], argv)
        if status is not None:
            return status
    use_compiled_loops()
    try:
        if name in STAGES:
            return _run_stage(name, rest, ["vibraverse", *argv])
        if name in COMMANDS:
            module = importlib.import_module(f"vibraverse.commands.{name}")
            return module.main(rest) or 0
        from vibraverse.contract.texts import unknown

        raise UsageError(unknown("command", name, [*COMMANDS, *STAGES]))
    except UsageError as error:
        print(f"vibraverse: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("vibraverse: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read this, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def asked_threads(argv: list[str]) -> str:
    """Return what stands after ``--threads``, which is needed before there is a parser: that of the stage."""
    for word, following in itertools.pairwise([*argv, ""]):
        name, equals, value = word.partition("=")
        if name == "--threads":
            return value if equals else following
    return "1"


def _run_stage(name: str, argv: list[str], command: list[str]) -> int:
    import argparse
    from pathlib import Path

    from vibraverse.config import ConfigError, validate
    from vibraverse.contract.stage import Job, run

    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)  # a log has what was said in its order
    threads = asked_threads(argv)
    set_threads(int(threads) if threads.isdigit() else 1)
    stage = importlib.import_module(f"vibraverse.stages.{name}").STAGE

    parser = argparse.ArgumentParser(prog=f"vibraverse {name}", description=stage.help)
    if stage.per_object:
        parser.add_argument("--object", required=True, metavar="ID", help="the object's id")
    if stage.per_solidity:
        parser.add_argument("--solidity", required=True, choices=("solid", "hollow"), help="which body")
    for group, arguments in (("inputs", stage.inputs), ("outputs", stage.outputs)):
        section = parser.add_argument_group(group)
        for key, text in arguments.items():
            section.add_argument(
                f"--{key.replace('_', '-')}",
                dest=f"{group}.{key}",
                required=key not in stage.optional,
                nargs="+" if key in stage.many else None,
                type=Path,
                metavar="FOLDER" if key in stage.folders else "FILE",
                help=text,
            )
    if stage.options is not None:
        parser.add_argument("--options", default="{}", metavar="JSON", help="the stage's configuration block")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="threads to use (default 1)")
    values = vars(parser.parse_args(argv))

    options = None
    if stage.options is not None:
        import json

        try:
            options = validate(stage.options, json.loads(values["options"]), prefix=name)
        except json.JSONDecodeError as error:
            raise UsageError(f"--options is not valid JSON: {error}") from None
        except ConfigError as error:
            raise UsageError(str(error)) from None
    job = Job(
        stage=stage,
        object=values.get("object", ""),
        solidity=values.get("solidity", ""),
        inputs={key: values[f"inputs.{key}"] for key in stage.inputs if values[f"inputs.{key}"] is not None},
        final={
            key: values[f"outputs.{key}"] for key in stage.outputs if values[f"outputs.{key}"] is not None
        },
        options=options,
        threads=values["threads"],
    )
    return run(job, command)
