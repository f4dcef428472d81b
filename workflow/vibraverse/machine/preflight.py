"""The preflight: checks before the first job that Apptainer, images, GPUs and the profile of a run exist.

A job that cannot start waits in a queue, or fails with the message of a tool that its owner may not know. The checks
here find that in advance, for the jobs that will run and nothing else. Each fails with one sentence.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from vibraverse.config import read
from vibraverse.contract import products
from vibraverse.contract.errors import NotStored, NotThere, UsageError
from vibraverse.contract.slices import JOIN
from vibraverse.contract.texts import DEFAULT_CONFIG, advised, unknown
from vibraverse.flow.learning import LEARNING_STEPS
from vibraverse.machine import containers, gpus

if TYPE_CHECKING:
    from vibraverse.flow.plan import Plan


def stop_without(check, *arguments):
    """Run a check and return its result; if it fails, end the process with its sentence and exit status 2."""
    try:
        return check(*arguments)
    except (NotThere, UsageError) as missing:
        print(f"vibraverse: {missing}", file=sys.stderr)
        sys.exit(2)


@contextmanager
def readable(path: str):
    """Let Snakemake read a configuration; on failure, end the process with a sentence that names file and line."""
    try:
        yield
    except Exception:
        if os.path.exists(path):  # Snakemake itself names a file that does not exist
            stop_without(read, path)
        raise


def configuration(path: str, text: str) -> None:
    """Write the resolved configuration, the run's first file."""
    try:
        products.write_text(path, text)
    except (NotStored, OSError) as error:
        raise NotThere(str(error)) from None


def known(plan: Plan, configs: Sequence[str | Path], kind: str, name: str) -> str:
    """Return the name of the object or shard of a requested file; raise :class:`NotThere` if the run lacks it.

    Snakemake's patterns match any name, and the functions in rules would raise ``KeyError``. ``configs`` are the files
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
    """Return whether a product of an unconfigured object is the mesh file of a configured one.

    Snakemake then looks for a rule that makes it, and accepts that none does.
    """
    folder = Path(plan.paths.at(plan.paths.object, object=name)).absolute()
    return any(entry.input and folder in entry.input.absolute().parents for entry in plan.objects.values())


def apptainer() -> None:
    """Check that images can be run, and that Snakemake can take their names."""
    if containers.binary() is None:
        raise NotThere(
            "the profile asks for containers, but the command apptainer is not on the PATH; install Apptainer "
            "(or load its module), or run without containers: --workflow-profile workflow/profiles/default"
        )
    if containers.image("any") is None:
        raise NotThere(
            f"the folder of images, {containers.folder()}, has a space in its name, which Snakemake cannot pass on; "
            "put them elsewhere and set VIBRAVERSE_IMAGES to that folder"
        )


def images(urls: Iterable[str]) -> None:
    """Check that each image file exists and matches this checkout; images in a registry are not checked."""
    named = {containers.image(family): family for family in containers.ALL}
    wrong = {
        named[url]: f"the image {url} {difference}"
        for url in sorted(set(urls))
        if "://" not in url and url in named and (difference := containers.differences(named[url], url))
    }
    if wrong:
        usual = wrong.keys() <= set(containers.FAMILIES)
        build = "make containers" if usual else f"make containers FAMILIES='{' '.join(wrong)}'"
        where = " (VIBRAVERSE_IMAGES says where they are)" if os.environ.get("VIBRAVERSE_IMAGES") else ""
        raise NotThere(f"{', '.join(wrong.values())}{where}; run `{build}`, then the same command again")


def rules(named: Iterable[str], known: Iterable[str]) -> None:
    """Check that the rules whose resources a profile sets exist; Snakemake ignores unknown ones."""
    for name in named:
        if name not in known:
            raise NotThere(f"the profile's set-resources names an {unknown('rule', name, sorted(known))}")


def learning(rules_: Iterable[str], slice_: str | None, here: bool) -> None:
    """Check that jobs of learning see the whole dataset and, if they run ``here``, that its packages are installed."""
    named = sorted(set(rules_) & {step.name for step in LEARNING_STEPS})
    if named and slice_ not in (None, JOIN):
        raise NotThere(
            f"the rule {named[0]} would see only the objects of slice {slice_}; make all slices first, then train with "
            f"--config slice={JOIN}"
        )
    missing = [name for name in ("torch", "ocnn", "sklearn") if named and here and find_spec(name) is None]
    if missing:
        raise NotThere(
            f"the rule {named[0]} needs the packages of learning, and this environment lacks {missing[0]}; run `make "
            "learn-demo` once, which makes an environment with them, then `. .venv-learn/bin/activate` and the same "
            "command again"
        )


def profile(arguments: Sequence[str]) -> None:
    """Check that the profile named by a command exists; Snakemake silently continues without it."""
    for name, following in zip(arguments, [*arguments[1:], ""], strict=True):
        option, joined, value = name.partition("=")
        value = value if joined else following
        if option == "--workflow-profile" and value != "none" and not _is_profile(value):
            raise NotThere(
                f"the profile {value} does not exist; give its whole path, as in "
                f"--workflow-profile {containers.PROJECT / 'workflow/profiles/default'}"
            )


def _is_profile(value: str) -> bool:
    """Return whether Snakemake finds a workflow profile of this name."""
    places = Path(value), Path("profiles", value), containers.PROJECT / "profiles" / value
    return any(place.is_file() or list(place.glob("*.yaml")) for place in places)


def seen_in_images(files: Iterable[str | Path], arguments: str = "") -> None:
    """Check that jobs in images will see mesh files; one file of each folder is tested.

    ``arguments`` are those that the profile passes to Apptainer. Snakemake makes the working folder the home in an
    image, so the user's home is not visible there.
    """
    near = Path.cwd(), Path("/tmp")
    folders = {path.parent: str(path) for path in (Path(file).absolute() for file in files)}
    looked_for = [
        path for folder, path in sorted(folders.items()) if not any(map(folder.is_relative_to, near))
    ]
    image = containers.image("geometry")
    if not looked_for or "://" in image:
        return
    command = [containers.binary(), "exec", "--home", str(near[0]), *shlex.split(arguments or ""), image]
    script = 'for file; do [ -e "$file" ] || echo "$file"; done'
    done = subprocess.run([*command, "sh", "-c", script, "sh", *looked_for], capture_output=True, text=True)
    unseen = [path for path in looked_for if path in done.stdout.splitlines()]
    if unseen:
        raise NotThere(
            f"jobs in images do not see {unseen[0]}: they see the working folder and /tmp; lend them its folder with "
            f"--apptainer-args '--bind {Path(unseen[0]).parent}', or with apptainer-args in the profile"
        )


def slices(missing: list[str]) -> None:
    """Check that the slices of a run have made their files."""
    if missing:
        raise NotThere(
            f"`slice: join` takes the files that the slices made, but {len(missing)} of them do not exist "
            f"({', '.join(Path(path).name for path in missing[:5])}{', …' if len(missing) > 5 else ''}); run the "
            "slices again (`logs/slices/` in the results holds what submitted ones said), or without `slice` to make "
            "everything that is missing"
        )


def local_gpus(jobs: Iterable[tuple[str, Mapping]]) -> None:
    """Check that this machine has as many NVIDIA GPUs as each of the jobs (rule, resources) asks for."""
    if sys.platform == "darwin" or os.path.exists("/dev/kfd"):  # Apple or AMD GPUs, which are not checked
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
