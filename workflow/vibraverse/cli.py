"""The command ``vibraverse``: one subcommand per stage, and a few for people.

A subcommand's module is imported only when it is called. So ``--help`` answers at once, and the thread settings are
in place before any numerical library loads. A stage that runs in a warm process costs its command no import at all:
there are ten such commands for each object.
"""

from __future__ import annotations

import os
import sys

from vibraverse import __version__
from vibraverse.machine import warm
from vibraverse.machine.threads import asked_threads, set_rounding, set_threads

TYPE_CHECKING = False  # importing typing takes as long as all other imports here together
if TYPE_CHECKING:
    from vibraverse.contract.step import Step

#: Subcommands for people: name -> one line of help. The module is ``vibraverse.commands.<name>``.
COMMANDS = {
    "strike": "hear a mesh: from a file to its impact sound in one go",
    "animate": "draw a mode of a body as a moving picture",
    "predict": "ask a trained model for the frequencies of a mesh, with error bars",
    "listen": "find the material of a body from its impact sound, or its size, or its wall",
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
    "repair": "say which products must be rebuilt, and delete them so that the next run does it",
    "refusals": "list refused objects by reason, or make them run again",
    "validation": "show how near the frequencies of known bodies are",
}

#: Failures whose frames hold HDF5 files that could not be written. Freeing those files crashes, so they are kept.
_UNWRITTEN: list[Exception] = []


def _overview() -> str:
    from vibraverse.flow.steps import BY_NAME

    def table(rows):
        return "\n".join(f"  {name:<17} {text}" for name, text in rows.items())

    stages = {name: step.help for name, step in BY_NAME.items()}
    return (
        "usage: vibraverse COMMAND …      (vibraverse COMMAND --help tells more)\n\n"
        "From meshes to shapes, modes, impact sounds and pictures that agree by physics.\n\n"
        f"For people:\n{table(COMMANDS)}\n\nStages, as the workflow calls them:\n{table(stages)}\n"
    )


def entry() -> None:
    """Run the command line and end the process with its status."""
    status = main()
    if status == 1 and "h5py" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)  # at a regular exit, HDF5 crashes over the files that it could not write
    sys.exit(status)


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 1 if the machine failed, 2 for a usage error."""
    argv = sys.argv[1:] if argv is None else argv
    set_rounding()
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_overview(), end="")
        return 0
    if argv[0] in ("-V", "--version"):
        print(f"vibraverse {__version__}")
        return 0
    name, rest = argv[0], argv[1:]
    if name == warm.SUBCOMMAND:
        from vibraverse.machine.warm_process import serve

        serve(main, rest[0])
        return 0
    if name not in COMMANDS and os.environ.get(warm.VARIABLE):
        status = warm.ask(os.environ[warm.VARIABLE], argv)
        if status is not None:
            return status
    return _here(name, rest)


def _here(name: str, rest: list[str]) -> int:
    """Run a subcommand in this process; return its exit status."""
    from vibraverse.contract.errors import NotStored, NotThere, UsageError
    from vibraverse.machine.compiled import use_compiled_loops

    use_compiled_loops()
    try:
        return _run(name, rest)
    except UsageError as error:
        print(f"vibraverse: {error}", file=sys.stderr)
        return 2
    except (NotStored, NotThere) as error:
        print(f"vibraverse: {error}", file=sys.stderr)
        _UNWRITTEN.append(error)
        _drop_output()
        return 1
    except KeyboardInterrupt:
        print("vibraverse: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader, for instance `head`, has seen enough
        _drop_output()
        return 141


def _drop_output() -> None:
    """Discard printed text that cannot be written; Python would report it a second time at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run(name: str, argv: list[str]) -> int:
    """Run a subcommand; raise :class:`NotStored` if its output cannot be stored."""
    import importlib

    from vibraverse.contract.errors import NotStored, UsageError
    from vibraverse.contract.products import STORAGE_ERRORS, not_stored
    from vibraverse.contract.readable import unreadable
    from vibraverse.contract.texts import unknown
    from vibraverse.flow.steps import BY_NAME

    if name in BY_NAME:
        _run_stage(BY_NAME[name], argv)
        return 0
    if name not in COMMANDS:
        raise UsageError(unknown("command", name, [*COMMANDS, *BY_NAME]))
    module = importlib.import_module(f"vibraverse.commands.{name}")
    try:
        status = module.main(argv) or 0
        sys.stdout.flush()
        return status
    except STORAGE_ERRORS as error:
        named = [path for name in ("filename2", "filename") if (path := getattr(error, name, None))]
        read = isinstance(error, PermissionError) and named and os.path.isfile(named[0])
        if read and (wrong := unreadable(named[0])):
            raise UsageError(f"{named[0]} {wrong}") from error
        said = not_stored(error, *(named or ["what the command writes"]))
        if not said:
            raise
        raise NotStored(said) from error


def _parser(step: Step):
    import argparse
    from pathlib import Path

    from vibraverse.contract.step import BODY, KNOWN_BODY, OBJECT, SHOWN_BODY, SHOWN_OBJECT, option
    from vibraverse.flow.paths import SOLIDITIES

    parser = argparse.ArgumentParser(prog=f"vibraverse {step.name}", description=step.help)
    if step.per in (OBJECT, BODY, SHOWN_OBJECT, SHOWN_BODY, KNOWN_BODY):
        parser.add_argument("--object", required=True, metavar="ID", help="the object's id")
    if step.per in (BODY, SHOWN_BODY):
        parser.add_argument("--solidity", required=True, choices=SOLIDITIES, help="which body")
    for group, arguments in (("inputs", step.inputs), ("outputs", step.outputs)):
        section = parser.add_argument_group(group)
        for key, argument in arguments.items():
            section.add_argument(
                option(key),
                dest=f"{group}.{key}",
                required=not argument.optional,
                nargs="+" if getattr(argument, "many", False) else None,
                type=Path,
                metavar="FOLDER" if getattr(argument, "record", "") else "FILE",
                help=argument.help,
            )
    if step.options:
        parser.add_argument("--options", default="{}", metavar="JSON", help="the stage's configuration block")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="threads to use (default 1)")
    if step.gpus:
        parser.add_argument("--gpus", type=int, default=0, metavar="N", help="GPUs to use (default 0)")
    return parser


def _run_stage(step: Step, argv: list[str]) -> None:
    import importlib

    from vibraverse.contract.errors import UsageError
    from vibraverse.contract.stage import Job, run

    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)  # keeps stdout and stderr in order in a log
    threads = asked_threads(argv)
    set_threads(int(threads) if threads.isdigit() else 1)
    values = vars(_parser(step).parse_args(argv))
    options = None
    if step.options:
        import json

        from vibraverse.config import section, validate

        try:
            options = validate(section(step.options), json.loads(values["options"]), prefix=step.name)
        except json.JSONDecodeError as error:
            raise UsageError(f"--options is not valid JSON: {error}; write an object, as in '{{}}'") from None

    def named(group: str, arguments) -> dict:
        return {key: values[f"{group}.{key}"] for key in arguments if values[f"{group}.{key}"] is not None}

    inputs = named("inputs", step.inputs)
    for key, place in inputs.items():
        file = step.inputs[key].file
        inputs[key] = [file(one) for one in place] if isinstance(place, list) else file(place)
    job = Job(
        step=step,
        object=values.get("object", ""),
        solidity=values.get("solidity", ""),
        inputs=inputs,
        final=named("outputs", step.outputs),
        options=options,
        threads=values["threads"],
        gpus=values.get("gpus", 0),
    )
    work = importlib.import_module(f"vibraverse.stages.{step.name}").run
    run(job, work, ["vibraverse", step.name, *argv])
