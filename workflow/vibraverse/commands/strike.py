"""``vibraverse strike``: hear a mesh, from a file to its impact sound in one command.

Strike runs the workflow's own stages one after the other in a temporary folder. So its numbers equal those of the
workflow for the same mesh and material.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import math
import shutil
import sys
import tempfile
from pathlib import Path

from vibraverse.config import ConfigError, section, validate
from vibraverse.config.geometry import Hollow, Tets
from vibraverse.config.media import Audio
from vibraverse.config.physics import Basis, Material, MaterialModes
from vibraverse.config.sources import SourceEntry
from vibraverse.contract import products
from vibraverse.contract.errors import NotStored, Refused, UsageError
from vibraverse.contract.names import slug
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.stage import Job, run
from vibraverse.contract.texts import unknown
from vibraverse.files import formats
from vibraverse.flow.paths import Paths
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.machine.threads import set_threads
from vibraverse.physics.materials import MATERIALS
from vibraverse.upkeep.lineage import Made, needed

#: Material parameters and the arguments that override them.
_OVERRIDES = {
    "density_kg_m3": "rho",
    "young_pa": "young",
    "poisson": "poisson",
    "alpha_per_s": "alpha",
    "beta_s": "beta",
}
#: Configuration keys and the options that set them, for messages about mistakes.
_FLAGS = {
    "size_m": "--size",
    "modes": "--modes",
    "order": "--order",
    "target_elements": "--elements",
    "density_kg_m3": "--density",
    "young_pa": "--young",
    "poisson": "--poisson",
    "alpha_per_s": "--alpha",
    "beta_s": "--beta",
}


def parser() -> argparse.ArgumentParser:
    """Return the arguments of the command."""
    p = argparse.ArgumentParser(
        prog="vibraverse strike",
        description="Clean a mesh, fill it with tetrahedra, compute its vibration modes and render its impact sound.",
    )
    p.add_argument("mesh", type=Path, metavar="MESH", help=formats.names(last=" or "))
    p.add_argument(
        "--material",
        default="ceramic",
        metavar="NAME",
        help=f"one of {', '.join(MATERIALS)} (default ceramic)",
    )
    p.add_argument(
        "--size",
        type=float,
        metavar="M",
        help="longest side in metres (default: the file's own metres, or 0.15)",
    )
    p.add_argument(
        "--young", type=float, metavar="PA", help="Young's modulus in Pa, in place of the material's"
    )
    p.add_argument("--poisson", type=float, metavar="NU", help="Poisson's ratio")
    p.add_argument("--density", type=float, metavar="RHO", dest="rho", help="density in kg/m³")
    p.add_argument("--alpha", type=float, metavar="A", help="mass-proportional damping in 1/s")
    p.add_argument("--beta", type=float, metavar="B", help="stiffness-proportional damping in s")
    p.add_argument("--modes", type=int, default=64, metavar="N", help="elastic modes (default 64)")
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
        "--at",
        metavar="X,Y,Z",
        help="strike the surface point nearest to this one, in the file's coordinates",
    )
    p.add_argument(
        "-o", "--output", type=Path, metavar="WAV", help="the sound (default: MESH-MATERIAL.wav here)"
    )
    p.add_argument("--json", metavar="FILE", help="write frequencies and facts as JSON; - prints them")
    p.add_argument(
        "--threads",
        type=int,
        default=1,
        metavar="N",
        help="threads (default %(default)s)",
    )
    return p


def main(argv: list[str]) -> int:
    """Run the command; return 0, or 2 after one sentence if the mesh is refused."""
    arguments = parser().parse_args(_with_negative_point(argv))
    plan = _Strike(arguments)
    set_threads(arguments.threads)
    with tempfile.TemporaryDirectory(prefix="vibraverse-strike-") as folder:
        try:
            facts, sound = plan.run(Path(folder))
        except NotStored as error:
            place = Path(folder).parent
            raise NotStored(
                f"{str(error).rstrip('.')} (strike works in {place}: set TMPDIR to a folder with more room)"
            ) from error
        except Refused as refused:
            about = "" if plan.mesh.name in refused.message else f"{plan.mesh.name}: "
            print(f"vibraverse: {about}{refused} [{refused.reason}]", file=sys.stderr)
            return 2
        with products.whole(plan.output) as partial:
            shutil.copyfile(sound, partial)
    if arguments.json == "-":
        import json

        print(json.dumps(facts, indent=2, ensure_ascii=False))
    elif arguments.json:
        products.write_json(arguments.json, facts)
    _print_facts(facts, plan.output, sys.stderr if arguments.json == "-" else sys.stdout)
    return 0


class _Strike:
    """The validated request; raises :class:`UsageError` before anything is computed."""

    def __init__(self, arguments: argparse.Namespace):
        self.mesh: Path = arguments.mesh
        if wrong := unreadable(self.mesh, missing="name an existing file"):
            raise UsageError(f"the mesh file {self.mesh} {wrong}")
        if not formats.is_mesh(self.mesh.name):
            raise UsageError(
                f"{self.mesh.name} is not a mesh file; export it as {formats.names(last=' or ')}"
            )
        self.object = slug(self.mesh.stem)
        self.solidity = "solid" if arguments.hollow is None else "hollow"
        self.threads = arguments.threads
        if arguments.threads < 1:
            raise UsageError(f"--threads must be at least 1, not {arguments.threads}")
        self.material = self._material(arguments)
        self.material_name = arguments.material
        self.point = self._point(arguments.at)
        if arguments.hollow is not None and not 0 < arguments.hollow < 1:
            raise UsageError(f"--hollow must lie between 0 and 1, not {arguments.hollow:g}")
        thickness = {} if arguments.hollow is None else {"thickness": [arguments.hollow, arguments.hollow]}
        try:
            self.options = {
                "sources": SourceEntry(origin="files"),
                "hollow": validate(Hollow, thickness),
                "tets": validate(Tets, {"target_elements": arguments.elements}),
                "basis": validate(
                    Basis,
                    {"order": arguments.order, "modes": arguments.modes},
                ),
                "modes": validate(
                    MaterialModes,
                    {
                        "materials": {self.material_name: self.material.model_dump()},
                        "size_m": arguments.size,
                        "modes": arguments.modes,
                    },
                ),
            }
        except ConfigError as error:
            raise UsageError(_as_flags(error)) from None
        self.output = arguments.output or Path(f"{self.mesh.stem}-{self.material_name}.wav")
        for path in (self.output, *([Path(arguments.json)] if arguments.json not in (None, "-") else [])):
            if not path.absolute().parent.is_dir():
                raise UsageError(f"the folder of {path} does not exist; create it, or choose another")
            if path.is_dir():
                raise UsageError(f"{path} is a folder; name a file in it")

    @staticmethod
    def _material(arguments) -> Material:
        if arguments.material not in MATERIALS:
            raise UsageError(unknown("material", arguments.material, MATERIALS))
        given = {key: getattr(arguments, name) for key, name in _OVERRIDES.items()}
        values = {**MATERIALS[arguments.material], **{k: v for k, v in given.items() if v is not None}}
        try:
            return validate(Material, values)
        except ConfigError as error:
            raise UsageError(_as_flags(error)) from None

    @staticmethod
    def _point(text: str | None) -> tuple[float, float, float] | None:
        if text is None:
            return None
        try:
            x, y, z = (float(part) for part in text.split(","))
        except ValueError:
            x = y = z = math.nan
        if not all(map(math.isfinite, (x, y, z))):
            raise UsageError(f"--at takes three numbers such as 0.1,0,0.25, not {text!r}")
        return x, y, z

    def _points(self, clean: dict) -> list[list[float]]:
        """Return the requested struck point in the normalised coordinates of the cleaned mesh; [] without one."""
        if self.point is None:
            return []
        point = [(x - c) * clean["scale"] for x, c in zip(self.point, clean["centre"], strict=True)]
        if max(map(abs, point)) > 1:
            place, centre = (",".join(f"{x:g}" for x in xs) for xs in (self.point, clean["centre"]))
            raise UsageError(
                f"--at {place} is not on the mesh, which is {LONGEST_SIDE / clean['scale']:g} long around {centre}; "
                "give a point in the coordinates of its file"
            )
        return [point]

    def run(self, folder: Path) -> tuple[dict, Path]:
        """Run the stages that a sound of the body needs in ``folder``; return the facts and the path of the sound."""
        paths, name = Paths(folder), self.material_name
        clean: dict = {}
        points: list[list[float]] = []
        for made in needed(paths, self.object, self.solidity, "audio"):
            if made.step.name == "audio":
                self.options["audio"] = Audio(points=points)
                name = self.options["audio"].names([self.material_name])[-1]
            self._stage(made)
            if made.step.name == "clean":
                clean = made.content
                points = self._points(clean)  # fails early if the point is not on the mesh

        def at(pattern: str) -> Path:
            return Path(paths.at(pattern, object=self.object, solidity=self.solidity, material=name))

        rendered = products.read_json(at(paths.audio_record))["sounds"][name]
        return self._facts(at(paths.modes), clean, products.read_json(at(paths.tets_record)), rendered), at(
            paths.sound
        )

    def _stage(self, made: Made) -> None:
        """Run one stage without its output; raise its refusal as :class:`Refused`."""
        step = made.step
        if sys.stderr.isatty():
            print(f"\r\033[K{step.name} …", end="", file=sys.stderr, flush=True)
        options = self.options.get(step.name) or (section(step.options)() if step.options else None)
        inputs = {name: made.input(name) for name in step.chained}
        if step.name == "sources":
            inputs["file"] = self.mesh
        final = {name: made.place(name) for name in step.outputs}
        job = Job(step, self.object, made.solidity, inputs, final, options, self.threads)
        work = importlib.import_module(f"vibraverse.stages.{step.name}").run
        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                run(job, work, ["vibraverse", step.name])
        finally:
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr, flush=True)
        refusal = read_refusal(made.record)
        if refusal is not None:
            raise Refused(refusal.reason, refusal.message, refusal.advice)

    def _facts(self, modes_path: Path, clean: dict, tets: dict, rendered: dict) -> dict:
        import h5py

        from vibraverse.geometry.cleaning.cautions import cautions as of_surface
        from vibraverse.physics.cautions import cautions as of_modes

        with h5py.File(modes_path) as h5:
            group = h5[f"materials/{self.material_name}"]
            size_m, volume_m3 = float(h5.attrs["size_m"]), float(h5.attrs["volume_m3"])
            frequencies, damping = group["frequencies_hz"][()], group["damping_per_s"][()]
            error, mass_kg = group["relative_error"][()], float(group.attrs["mass_kg"])
            element_error = group["discretisation_error"][()]
        struck_at = rendered["struck_at"]
        if struck_at is not None:
            struck_at = [x / clean["scale"] + c for x, c in zip(struck_at, clean["centre"], strict=True)]
        warnings = [f"clean: {sentence}" for sentence in of_surface(clean)]
        said = [f"tets: {sentence}" for sentence in tets["warnings"]]
        said += [f"modes: {sentence}" for sentence in of_modes([element_error])]
        flag = _FLAGS["target_elements"]
        warnings += [sentence.replace("tets.target_elements", flag) for sentence in said]
        tolerance = self.options["modes"].tolerance
        if error.max() > tolerance:
            warnings.append(
                f"modes: the estimated frequency error by the basis reaches {error.max():.1e} (at most {tolerance:.0e})"
            )
        if rendered["modes_above_nyquist"]:
            left_out = (
                f"{rendered['modes_above_nyquist']} of {len(frequencies)} modes are above half the sample rate "
                f"({Audio().sample_rate_hz / 2:g} Hz) and left out"
            )
            silent = "" if rendered["modes_rendered"] else "silent, since "
            warnings.append(f"audio: {silent}{left_out}; a larger --size lowers them")
        if rendered["modes_overdamped"]:
            warnings.append(
                f"audio: {rendered['modes_overdamped']} of {len(frequencies)} modes are overdamped and do not ring; "
                "lower --alpha or --beta"
            )
        if not clean.get("size_m") and not self.options["modes"].size_m:
            warnings.append(
                f"size: the file states no unit; its longest side is taken as {size_m:g} m; give --size"
            )
        return {
            "mesh": self.mesh.name,
            "material": self.material_name,
            "material_parameters": self.material.model_dump(),
            "solidity": self.solidity,
            "size_m": size_m,
            "volume_m3": volume_m3,
            "mass_kg": mass_kg,
            "vertices": tets["vertices"],
            "tetrahedra": tets["tetrahedra"],
            "order": self.options["basis"].order,
            "frequencies_hz": frequencies.tolist(),
            "damping_per_s": damping.tolist(),
            "relative_error": error.tolist(),
            "discretisation_error": element_error.tolist(),
            "duration_s": rendered["duration_s"],
            "struck_at": struck_at,
            "repairs": clean["repairs"],
            "warnings": warnings,
        }


def _with_negative_point(argv: list[str]) -> list[str]:
    """Return the arguments with ``--at -1,0,0`` as ``--at=-1,0,0``, because argparse takes ``-1,0,0`` for an option."""
    joined = list(argv)
    for i, argument in enumerate(argv[:-1]):
        if argument == "--at":
            joined[i : i + 2] = [f"--at={argv[i + 1]}"]
            break
    return joined


def _as_flags(error: ConfigError) -> str:
    """Return the text of mistakes in configuration keys, in terms of the options that set them."""
    return str(ConfigError(*map(_as_flag, error.mistakes), subject="the command"))


def _as_flag(sentence: str) -> str:
    """Return a sentence about a configuration key as one about the option that sets it."""
    key, _, rest = sentence.partition(" ")
    return f"{_FLAGS.get(key.rstrip(':'), key)} {rest}"


def _print_facts(facts: dict, output: Path, stream) -> None:
    """Print a summary of the facts."""
    first = ", ".join(f"{f:.1f}" for f in facts["frequencies_hz"][:5])
    print(
        f"{facts['mesh']}: {facts['solidity']} {facts['material']}, longest side {facts['size_m']:g} m, "
        f"{facts['mass_kg']:.3g} kg, {facts['tetrahedra']} tetrahedra\n"
        f"lowest of {len(facts['frequencies_hz'])} modes: {first} Hz",
        file=stream,
    )
    if facts["struck_at"] is not None:
        point = ", ".join(f"{x:.4g}" for x in facts["struck_at"])
        print(f"struck at ({point}), the surface point nearest to the one asked for", file=stream)
    if facts["repairs"]:
        print(f"repaired: {', '.join(facts['repairs'])}", file=stream)
    for warning in facts["warnings"]:
        print(f"warning: {warning.rstrip('.')}", file=stream)
    print(f"wrote {output} ({facts['duration_s']:.2f} s)", file=stream)
