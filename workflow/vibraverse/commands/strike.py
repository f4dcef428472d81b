"""``vibraverse strike``: hear a mesh, from a file to its impact sound in one command.

Strike runs the workflow's own stages one after the other in a temporary folder, with a basis for its material alone. So
its numbers are those of the workflow for the same mesh and material.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import get_args

from vibraverse.commands.one_mesh import (
    FLAGS,
    OneMesh,
    as_flags,
    check_writable,
    infrasound_warnings,
    mesh_arguments,
    size_warnings,
    sound_warnings,
    surface_warnings,
    with_flags,
    work_folder,
    write_facts,
)
from vibraverse.commands.opened import page, show
from vibraverse.config import ConfigError, validate
from vibraverse.config.media import Audio, Observable
from vibraverse.config.physics import Material
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import unknown
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.machine.threads import set_threads
from vibraverse.physics.materials import MATERIALS

#: Material parameters and the arguments that override them.
_OVERRIDES = {
    "density_kg_m3": "rho",
    "young_pa": "young",
    "poisson": "poisson",
    "alpha_per_s": "alpha",
    "beta_s": "beta",
}
#: What the facts quote of the tetrahedra's quality table: the recipe, and what it changed.
_MESHING = ("algorithm", "ridge_deg", "wrap", "accuracy")
#: Modes that are printed with a page.
_SHOWN_MODES = 10
#: Configuration keys and the options that set them.
_FLAGS = FLAGS | {
    "contact_s": "--contact-s",
    **{key: "--density" if key == "density_kg_m3" else f"--{name}" for key, name in _OVERRIDES.items()},
}


def parser() -> argparse.ArgumentParser:
    """Return the arguments of the command."""
    p = argparse.ArgumentParser(
        prog="vibraverse strike",
        parents=[mesh_arguments()],
        description="Clean a mesh, fill it with tetrahedra, compute its vibration modes and render its impact sound.",
    )
    p.add_argument(
        "--material",
        default="ceramic",
        metavar="NAME",
        help=f"one of {', '.join(MATERIALS)} (default ceramic)",
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
        "--at",
        metavar="X,Y,Z",
        help="strike the surface point nearest to this one, in the file's coordinates",
    )
    p.add_argument(
        "--contact-s",
        type=float,
        default=Audio().contact_s,
        metavar="S",
        help="seconds that the striker touches the body; a soft one some 0.005 (default: an impulse)",
    )
    p.add_argument(
        "--observable",
        default=Audio().observable,
        choices=get_args(Observable),
        help="what of the motion is heard (default %(default)s)",
    )
    p.add_argument(
        "-o", "--output", type=Path, metavar="WAV", help="the sound (default: MESH-MATERIAL.wav here)"
    )
    p.add_argument("--json", metavar="FILE", help="write frequencies and facts as JSON; - prints them")
    p.add_argument(
        "--open",
        action="store_true",
        help="also write a page on which the body is struck anywhere, in any material, and open it in a browser",
    )
    p.add_argument(
        "--page",
        type=Path,
        metavar="HTML",
        help="write that page, to this file (default with --open: MESH-MATERIAL.html here)",
    )
    return p


def main(argv: list[str]) -> int:
    """Run the command; return 0."""
    arguments = parser().parse_args(_with_negative_point(argv))
    plan = _Strike(arguments)
    set_threads(arguments.threads)
    with work_folder("strike", arguments.mesh) as folder:
        facts, sound = plan.run(folder)
        page = plan.opened(folder) if plan.page else ""
    with products.whole(plan.output) as partial:
        partial.write_bytes(sound)
    stream = write_facts(facts, arguments.json)
    _print_facts(facts, plan.output, stream)
    if plan.page:
        products.write_text(plan.page, page)
        _print_modes(facts, stream)
        there = arguments.open and show(plan.page)
        print(f"wrote {plan.page}{'' if there else ': open it in a browser'}", file=stream)
    return 0


class _Strike:
    """The validated request; raises :class:`UsageError` before anything is computed."""

    def __init__(self, arguments: argparse.Namespace):
        self.material, self.material_name = self._material(arguments), arguments.material
        self.page = arguments.page or (
            Path(f"{arguments.mesh.stem}-{self.material_name}.html") if arguments.open else None
        )
        named = (
            {name: self._checked(Material, values) for name, values in MATERIALS.items()} if self.page else {}
        )
        materials = {**named, self.material_name: self.material}
        self.mesh = OneMesh(arguments, materials, arguments.modes, any_poisson=bool(self.page))
        self.point = self._point(arguments.at)
        self.audio = self._checked(
            Audio, {"contact_s": arguments.contact_s, "observable": arguments.observable}
        )
        self.output = arguments.output or Path(f"{self.mesh.path.stem}-{self.material_name}.wav")
        files = [Path(arguments.json)] if arguments.json not in (None, "-") else []
        for path in (self.output, *files, *([self.page] if self.page else [])):
            check_writable(path)

    @staticmethod
    def _material(arguments) -> Material:
        if arguments.material not in MATERIALS:
            raise UsageError(unknown("material", arguments.material, MATERIALS))
        given = {key: getattr(arguments, name) for key, name in _OVERRIDES.items()}
        values = {**MATERIALS[arguments.material], **{k: v for k, v in given.items() if v is not None}}
        return _Strike._checked(Material, values)

    @staticmethod
    def _checked(section: type, values: dict):
        try:
            return validate(section, values)
        except ConfigError as error:
            raise UsageError(as_flags(error, _FLAGS)) from None

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

    def _points(self, clean: dict) -> list[tuple[float, ...]]:
        """Return the requested struck point in the normalised coordinates of the cleaned mesh; [] without one."""
        if self.point is None:
            return []
        point = tuple((x - c) * clean["scale"] for x, c in zip(self.point, clean["centre"], strict=True))
        if max(map(abs, point)) > 1:
            place, centre = (",".join(f"{x:g}" for x in xs) for xs in (self.point, clean["centre"]))
            raise UsageError(
                f"--at {place} is not on the mesh, which is {LONGEST_SIDE / clean['scale']:g} long around {centre}; "
                "give a point in the coordinates of its file"
            )
        return [point]

    def run(self, folder: Path) -> tuple[dict, bytes]:
        """Run the stages that a sound of the body needs in ``folder``; return the facts and the sound."""
        mesh, clean = self.mesh, {}
        for made in mesh.run(mesh.needed(folder, "audio")):
            if made.step.name == "clean":
                clean = made.content
                mesh.options["audio"] = self.audio.model_copy(update={"points": self._points(clean)})
        name = mesh.options["audio"].names([self.material_name])[-1]
        rendered = products.read_json(mesh.at(folder, "audio_record"))["sounds"][name]
        tets = products.read_json(mesh.at(folder, "tets_record"))
        facts = self._facts(mesh.at(folder, "modes"), clean, tets, rendered)
        return facts, mesh.at(folder, "sound", material=name).read_bytes()

    def opened(self, folder: Path) -> str:
        """Return the page of the body; it opens with what the command asked for."""
        settings = {"material": self.material_name}
        if self.mesh.options["audio"].points:
            settings["point"] = "0"
        return page(self.mesh, folder, settings)

    def _facts(self, modes_path: Path, clean: dict, tets: dict, rendered: dict) -> dict:
        import h5py

        from vibraverse.geometry.meshing.cautions import of_wrap
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
        warnings = surface_warnings(clean)
        said = [f"tets: {sentence}" for sentence in tets["warnings"] + of_wrap(tets["quality"])]
        said += [f"modes: {sentence}" for sentence in of_modes([element_error])]
        warnings += map(with_flags, said)
        tolerance = self.mesh.options["modes"].tolerance
        if error.max() > tolerance:
            warnings.append(
                f"modes: the estimated frequency error by the basis reaches {error.max():.1e} (at most {tolerance:.0e})"
            )
        warnings += sound_warnings(rendered, len(frequencies), "lower --alpha or --beta")
        warnings += infrasound_warnings(frequencies.tolist())
        warnings += size_warnings(clean, self.mesh.options["modes"])
        return {
            "mesh": self.mesh.path.name,
            "material": self.material_name,
            "material_parameters": self.material.model_dump(),
            "solidity": self.mesh.solidity,
            "size_m": size_m,
            "volume_m3": volume_m3,
            "mass_kg": mass_kg,
            "vertices": tets["vertices"],
            "tetrahedra": tets["tetrahedra"],
            "meshing": {key: tets["quality"][key] for key in _MESHING if key in tets["quality"]},
            "order": self.mesh.options["basis"].order,
            "frequencies_hz": frequencies.tolist(),
            "damping_per_s": damping.tolist(),
            "relative_error": error.tolist(),
            "discretisation_error": element_error.tolist(),
            "duration_s": rendered["duration_s"],
            "struck_at": struck_at,
            "contact_s": self.audio.contact_s,
            "observable": self.audio.observable,
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


def _print_modes(facts: dict, stream) -> None:
    """Print the first modes, each with the estimated error by the elements."""
    rows = zip(facts["frequencies_hz"], facts["discretisation_error"], strict=True)
    for mode, (hz, error) in enumerate(rows, 1):
        if mode > _SHOWN_MODES:
            break
        print(f"mode {mode:>2}: {hz:10.1f} Hz ± {100 * error:.2g} %", file=stream)


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
