"""One mesh file through the workflow's own stages, in a temporary folder: what the commands about one mesh share."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import io
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TextIO

from vibraverse.config import ConfigError, section, validate
from vibraverse.config.geometry import Clean, Hollow, Tets
from vibraverse.config.media import Audio
from vibraverse.config.physics import Basis, Material, MaterialModes
from vibraverse.config.sources import SourceEntry
from vibraverse.contract import products
from vibraverse.contract.errors import NotStored, NotThere, Refused, UsageError
from vibraverse.contract.limits import limited_memory
from vibraverse.contract.names import slug
from vibraverse.contract.progress import reports_to
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.stage import Job, run
from vibraverse.contract.step import BODY
from vibraverse.contract.texts import unknown
from vibraverse.files import formats
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import BY_NAME
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.plausible import SIZE_M
from vibraverse.upkeep.lineage import Made, needed

#: Configuration keys and the options that set them, for messages about mistakes.
FLAGS = {"size_m": "--size", "modes": "--modes", "order": "--order", "target_elements": "--elements"}
#: Memory in MB that a command about one mesh may take: a body of the most elements by default takes half of it.
MEMORY_MB = 6000
#: A key of the configuration that limits memory.
_MEMORY_KEY = re.compile(r"\b[a-z]+\.(limits\.)?memory_mb\b")

DEFAULT_MATERIAL = "ceramic"
#: The numbers of a material in their order; the first three suffice.
_MATERIAL_NUMBERS = ("young_pa", "density_kg_m3", "poisson", "alpha_per_s", "beta_s")
#: Lowest frequency that people hear as a tone.
AUDIBLE_HZ = 20.0


def mesh_arguments(name: str = "mesh") -> argparse.ArgumentParser:
    """Return the arguments that name a mesh and its simulation, as a parent of the commands' parsers.

    ``name`` is that of the mesh's own argument: ``mesh``, or ``--mesh`` where another file comes first.
    """
    p = argparse.ArgumentParser(add_help=False)
    required = {"required": True} if name.startswith("-") else {}
    p.add_argument(name, type=Path, metavar="MESH", help=formats.names(last=" or "), **required)
    p.add_argument(
        "--size",
        type=float,
        metavar="M",
        help="longest side in metres (default: the file's own metres, or 0.15)",
    )
    p.add_argument(
        "--hollow",
        type=float,
        metavar="T",
        help="hollow the body: the wall reaches T of the way to its deepest point",
    )
    p.add_argument("--order", type=int, default=2, help="element order, 1 or 2 (default 2)")
    p.add_argument(
        "--elements",
        type=int,
        default=Tets().target_elements,
        metavar="N",
        help="tetrahedra to aim for (default %(default)s)",
    )
    p.add_argument(
        "--memory-mb",
        type=int,
        default=MEMORY_MB,
        metavar="MB",
        help="memory that a stage may take; a mesh that needs more is refused (default %(default)s)",
    )
    p.add_argument("--threads", type=int, default=1, metavar="N", help="threads (default %(default)s)")
    return p


class OneMesh:
    """The mesh of a command and the options of its stages.

    Raises :class:`UsageError` before anything is computed. ``materials`` and ``modes`` are those of a simulation;
    without materials, or with ``any_poisson``, it serves any.
    """

    def __init__(
        self,
        arguments: argparse.Namespace,
        materials: Mapping[str, Material],
        modes: int,
        any_poisson: bool = False,
    ):
        self.path: Path = arguments.mesh
        if wrong := unreadable(self.path, missing="name an existing file"):
            raise UsageError(f"the mesh file {self.path} {wrong}")
        if not formats.is_mesh(self.path.name):
            raise UsageError(
                f"{self.path.name} is not a mesh file; export it as {formats.names(last=' or ')}"
            )
        self.object = slug(self.path.stem)
        self.solidity = "solid" if arguments.hollow is None else "hollow"
        self.threads = arguments.threads
        if arguments.threads < 1:
            raise UsageError(f"--threads must be at least 1, not {arguments.threads}")
        if arguments.hollow is not None and not 0 < arguments.hollow < 1:
            raise UsageError(f"--hollow must lie between 0 and 1, not {arguments.hollow:g}")
        if arguments.memory_mb < 1:
            raise UsageError(f"--memory-mb must be at least 1, not {arguments.memory_mb}")
        thickness = {} if arguments.hollow is None else {"thickness": [arguments.hollow, arguments.hollow]}
        self.memory_mb = arguments.memory_mb
        memory = {"memory_mb": self.memory_mb}
        basis = {"order": arguments.order, "modes": modes, **memory}
        if (
            materials and not any_poisson
        ):  # no others will be asked for, and a basis for one Poisson's ratio takes a fraction of the time
            ratios = [one.poisson for one in materials.values()]
            basis["poisson_range"] = [min(ratios), max(ratios)]
        try:
            self.options = {
                "sources": SourceEntry(origin="files"),
                "clean": validate(Clean, {"limits": memory}),
                "hollow": validate(Hollow, {**thickness, "limits": memory}),
                "tets": validate(Tets, {"target_elements": arguments.elements, "limits": memory}),
                "basis": validate(Basis, basis),
                "modes": validate(
                    MaterialModes,
                    {
                        "materials": {name: one.model_dump() for name, one in materials.items()},
                        "size_m": arguments.size,
                        "modes": modes,
                        **memory,
                    },
                ),
            }
        except ConfigError as error:
            raise UsageError(as_flags(error, FLAGS)) from None

    def needed(self, folder: Path, last: str) -> list[Made]:
        """Return the jobs that the stage ``last`` of the body needs, itself included; products lie in ``folder``."""
        return needed(Paths(folder), self.object, self.solidity if BY_NAME[last].per == BODY else "", last)

    def at(self, folder: Path, pattern: str, **wildcards: str) -> Path:
        """Return the path of a product, by the name of its pattern."""
        return Path(Paths(folder).named(pattern, object=self.object, solidity=self.solidity, **wildcards))

    def run(self, jobs: list[Made]) -> Iterator[Made]:
        """Run stages one after the other, each yielded when it is done; raise a refusal as :class:`Refused`."""
        for made in jobs:
            self._run(made)
            yield made

    def _run(self, made: Made) -> None:
        """Run one stage without its output."""
        step = made.step
        options = self.options.get(step.name) or (section(step.options)() if step.options else None)
        inputs = {name: made.input(name) for name in step.chained}
        if step.name == "sources":
            inputs["file"] = self.path
        final = {name: made.place(name) for name in step.outputs}
        job = Job(step, self.object, made.solidity, inputs, final, options, self.threads)
        work = importlib.import_module(f"vibraverse.stages.{step.name}").run
        with progress(step.name), limited_memory(self.memory_mb, f"The stage {step.name}", "--memory-mb"):
            run_quietly(run, job, work, ["vibraverse", step.name])
        refusal = read_refusal(made.record)
        if refusal is not None:
            raise Refused(refusal.reason, refusal.message, refusal.advice)


def run_quietly(function, *arguments) -> None:
    """Call a function without showing what it prints."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        function(*arguments)


def check_installed(command: str, stages: Iterable[str]) -> None:
    """Raise :class:`NotThere` if this environment lacks packages that stages need."""
    missing = []
    for library in sorted({library for stage in stages for library in BY_NAME[stage].libraries}):
        try:
            importlib.metadata.version(library)
        except importlib.metadata.PackageNotFoundError:
            missing.append(library)
    if missing:
        raise NotThere(
            f"{command} needs the Python packages {', '.join(missing)}, which this environment lacks; make one that "
            "holds them with `envs/env.sh .venv-learn learn workstation` in the clone, and call "
            f".venv-learn/bin/vibraverse {command}"
        )


@contextlib.contextmanager
def progress(what: str) -> Iterator[None]:
    """Show on a terminal what is being done, with what it reports."""
    terminal = sys.stderr if sys.stderr.isatty() else None

    def show(sentence: str) -> None:
        if terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\033[K{f'{what}: {sentence}'[: width - 2]} …", end="", file=terminal, flush=True)

    if terminal:
        print(f"\r\033[K{what} …", end="", file=terminal, flush=True)
    try:
        with reports_to(show):
            yield
    finally:
        if terminal:
            print("\r\033[K", end="", file=terminal, flush=True)


@contextlib.contextmanager
def work_folder(command: str, mesh: Path) -> Iterator[Path]:
    """Yield a temporary folder for the products of a command.

    A refusal of its mesh becomes a :class:`UsageError`; :class:`NotStored` says which folder is full.
    """
    with tempfile.TemporaryDirectory(prefix=f"vibraverse-{command}-") as folder:
        try:
            yield Path(folder)
        except NotStored as error:
            place = Path(folder).parent
            raise NotStored(
                f"{str(error).rstrip('.')} ({command} works in {place}: set TMPDIR to a folder with more room)"
            ) from error
        except Refused as refused:
            about = "" if mesh.name in refused.message else f"{mesh.name}: "
            raise UsageError(f"{about}{with_flags(str(refused))} [{refused.reason}]") from refused


def with_flags(text: str) -> str:
    """Return the text of a refusal or a warning with the options of commands in place of the configuration's keys."""
    return _MEMORY_KEY.sub("--memory-mb", text).replace("tets.target_elements", FLAGS["target_elements"])


def check_writable(path: Path) -> None:
    """Raise :class:`UsageError` if a file of this name cannot be written, because of its folder or itself."""
    if not path.absolute().parent.is_dir():
        raise UsageError(f"the folder of {path} does not exist; create it, or choose another")
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name a file in it")


def write_facts(facts: dict, json: str | None) -> TextIO:
    """Write facts to the file ``json``, or print them for ``-``, and return the stream for the summary beside them."""
    if json == "-":
        print(products.as_json(facts), end="")
        return sys.stderr
    if json:
        products.write_json(json, facts)
    return sys.stdout


def as_flags(error: ConfigError, flags: Mapping[str, str]) -> str:
    """Return the text of mistakes in configuration keys, in terms of the options that set them."""

    def as_flag(sentence: str) -> str:
        key, _, rest = sentence.partition(" ")
        return f"{flags.get(key.rstrip(':'), key)} {rest}"

    return str(ConfigError(*map(as_flag, error.mistakes), subject="the command"))


def read_material(text: str, named: Mapping[str, Mapping[str, float]]) -> Material:
    """Return a material by its name, or by its numbers."""
    if "," not in text:
        if text not in named:
            raise UsageError(unknown("material", text, named))
        return validate(Material, dict(named[text]))
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, len(_MATERIAL_NUMBERS)):
        raise UsageError(
            f"--material takes a name, or Young's modulus in Pa, density in kg/m³ and Poisson's ratio such as "
            f"7.2e10,2700,0.19, and then alpha and beta if they are known, not {text!r}"
        )
    damped = {name: MATERIALS[DEFAULT_MATERIAL][name] for name in _MATERIAL_NUMBERS[3:]}
    try:
        return validate(Material, damped | dict(zip(_MATERIAL_NUMBERS, numbers, strict=False)))
    except ConfigError as error:
        raise UsageError(f"--material {text}: {error}") from None


def surface_warnings(clean: dict) -> list[str]:
    """Return the warnings about a cleaned surface."""
    from vibraverse.geometry.cleaning.cautions import cautions

    return [f"clean: {sentence}" for sentence in cautions(clean)]


def size_warnings(clean: dict, options: MaterialModes) -> list[str]:
    """Return the warning that the size of a cleaned surface is a guess, or is one that nobody may state, if it is."""
    size_m, origin = options.object_size(clean)
    if origin == "default":
        return [f"size: the file states no unit; its longest side is taken as {size_m:g} m; give --size"]
    low, high = SIZE_M
    if origin == "file" and not low <= size_m <= high:
        return [
            f"size: the longest side is {size_m:g} m in the file's own unit (from {low:g} to {high:g} m is plausible); "
            "give --size if the file was made in another unit"
        ]
    return []


def infrasound_warnings(frequencies_hz: list[float]) -> list[str]:
    """Return the warning that modes of a body are too low to be heard, if some are."""
    low = sum(frequency < AUDIBLE_HZ for frequency in frequencies_hz)
    if not low:
        return []
    return [
        f"audio: {low} of {len(frequencies_hz)} modes are below {AUDIBLE_HZ:g} Hz and cannot be heard; "
        "a smaller --size raises them"
    ]


def sound_warnings(rendered: Mapping, modes: int, less_damping: str) -> list[str]:
    """Return the warnings about the modes of a sound that are not heard, from the counts of its rendering."""
    warnings = []
    if rendered["modes_above_nyquist"]:
        left_out = (
            f"{rendered['modes_above_nyquist']} of {modes} modes are above half the sample rate "
            f"({Audio().sample_rate_hz / 2:g} Hz) and left out"
        )
        silent = "" if rendered["modes_rendered"] else "silent, since "
        warnings.append(f"audio: {silent}{left_out}; a larger --size lowers them")
    if rendered["modes_overdamped"]:
        warnings.append(
            f"audio: {rendered['modes_overdamped']} of {modes} modes are overdamped and do not ring; {less_damping}"
        )
    return warnings
