"""``vibraverse listen``: what an impact sound says about a body of known shape: its material, its size, its wall.

The mesh goes through the workflow's own stages to its modal basis, as that of ``strike``. So the body has the
frequencies that the workflow gives it.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from pathlib import Path

from vibraverse.commands.one_mesh import (
    OneMesh,
    check_writable,
    mesh_arguments,
    progress,
    read_material,
    surface_warnings,
    work_folder,
    write_facts,
)
from vibraverse.config import validate
from vibraverse.config.geometry import Hollow
from vibraverse.contract.errors import UsageError
from vibraverse.machine.threads import set_threads
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.plausible import MAX_SPEED_M_S, SIZE_M

#: Longest part of a recording in which a hit is looked for, in seconds.
SEARCHED_S = 60.0
#: Elastic modes of the body, and the range of Poisson's ratio in which it is sought.
_MODES, _POISSON_RANGE = 64, (0.05, 0.45)
#: Slowest sound in a thin bar of a material that rings, in m/s: soft rubber.
_MIN_SPEED_M_S = 30.0
#: Walls of the bodies that are solved when the wall is sought.
WALLS = (0.3, 0.4, 0.5, 0.6, 0.7)


def parser() -> argparse.ArgumentParser:
    """Return the arguments of the command."""
    p = argparse.ArgumentParser(
        prog="vibraverse listen",
        parents=[mesh_arguments("--mesh")],
        description="Find the material of a body of known shape from its impact sound, or its size, or its wall.",
        epilog="Frequencies hold E/ρ and the size only as sqrt(E/ρ) / size. So give --size to find the material, or "
        "--material to find the size.",
    )
    p.add_argument(
        "sound",
        type=Path,
        nargs="?",
        metavar="SOUND",
        help="recording of one hit (WAV, FLAC, OGG, MP3, AIFF)",
    )
    p.add_argument(
        "--frequencies",
        type=Path,
        metavar="FILE",
        help="in place of a sound: text with a frequency in Hz per line, and its decay rate in 1/s if it is known",
    )
    p.add_argument(
        "--material",
        metavar="NAME|NUMBERS",
        help=f"the material, if it is known, to find the size: one of {', '.join(MATERIALS)}, or Young's modulus "
        "in Pa, density in kg/m³ and Poisson's ratio such as 7.2e10,2700,0.19",
    )
    p.add_argument(
        "--mass", type=float, metavar="KG", help="mass of the body, to tell E and the density apart"
    )
    p.add_argument(
        "--wall",
        action="store_true",
        help=f"find the wall of a hollow body too, as --hollow states it, from {WALLS[0]:g} to {WALLS[-1]:g}; solves "
        f"{len(WALLS)} bodies",
    )
    p.add_argument("--json", metavar="FILE", help="write the answer and all peaks as JSON; - prints them")
    return p


def main(argv: list[str]) -> int:
    """Run the command; return 0."""
    arguments = parser().parse_args(argv)
    plan = _Listen(arguments)
    set_threads(arguments.threads)
    with work_folder("listen", arguments.mesh) as folder:
        facts = plan.run(folder)
    from vibraverse.commands.heard import print_facts  # not earlier: it imports numerical libraries

    print_facts(facts, write_facts(facts, arguments.json))
    return 0


class _Listen:
    """The validated request; raises :class:`UsageError` before anything is computed."""

    def __init__(self, arguments: argparse.Namespace):
        self.sound, self.frequencies, self.wall = arguments.sound, arguments.frequencies, arguments.wall
        if (self.sound is None) == (self.frequencies is None):
            raise UsageError("name a sound file, or a list of frequencies with --frequencies, one of the two")
        if self.wall and arguments.hollow is not None:
            raise UsageError("--wall seeks the wall and --hollow states it; give one of the two")
        if arguments.material and arguments.size and not self.wall:
            raise UsageError(
                "--material and --size leave nothing to find; give one of the two, or --wall to find the wall of a "
                "hollow body"
            )
        if arguments.mass is not None and not 0 < arguments.mass < float("inf"):
            raise UsageError(f"--mass must be greater than 0 kg, not {arguments.mass:g}")
        if arguments.mass and arguments.material:
            raise UsageError(
                "--mass tells E and the density apart, which --material states; give one of the two"
            )
        self.mass_kg = arguments.mass
        self.material = read_material(arguments.material, MATERIALS) if arguments.material else None
        self.material_name = arguments.material
        if self.wall:
            arguments.hollow = WALLS[0]
        self.mesh = OneMesh(arguments, {}, _MODES)
        known = [self.material.poisson] if self.material else []
        poisson = min([_POISSON_RANGE[0], *known]), max([_POISSON_RANGE[1], *known])
        basis = self.mesh.options["basis"].model_dump()
        self.mesh.options["basis"] = validate(
            type(self.mesh.options["basis"]), {**basis, "poisson_range": poisson}
        )
        if arguments.json not in (None, "-"):
            check_writable(Path(arguments.json))

    def run(self, folder: Path) -> dict:
        """Listen, solve the body, and return the answer."""
        from vibraverse.commands.heard import Known, facts_of
        from vibraverse.listening.answer import answer, enough

        peaks, notes = self._peaks()
        enough(peaks)
        clean, model, exact, volume = self._body(folder)
        size_m, origin = self.mesh.options["modes"].object_size(clean)
        sought = origin == "default" or (self.material is not None and not self.wall)
        known = Known(None if sought else size_m, self.material, self.material_name, self.mass_kg)
        with progress("search"):
            found = answer(
                peaks, model, known.bounds(model.bounds, _MIN_SPEED_M_S, MAX_SPEED_M_S, SIZE_M), exact
            )
        facts = facts_of(found, peaks, model if exact is None else exact, known, volume)
        return {
            "sound": (self.sound or self.frequencies).name,
            "mesh": self.mesh.path.name,
            "solidity": self.mesh.solidity,
            **facts,
            "repairs": clean["repairs"],
            "warnings": [*(f"sound: {one}" for one in notes), *surface_warnings(clean), *facts["warnings"]],
        }

    def _peaks(self):
        """Return the peaks of the sound or the list, and notes about the recording."""
        from vibraverse.files.sounds import read_frequencies, read_sound
        from vibraverse.listening import peaks

        if self.frequencies:
            return peaks.listed(*read_frequencies(self.frequencies)), []
        from vibraverse.listening.strikes import strike

        samples, rate, length_s = read_sound(self.sound, SEARCHED_S)
        try:
            hit = strike(samples, rate)
        except UsageError as error:
            raise UsageError(f"{self.sound.name}: {error}") from None
        notes = hit.notes
        if length_s > SEARCHED_S:
            notes = [
                f"it lasts {length_s:.0f} s, of which the first {SEARCHED_S:g} s are searched for a hit",
                *notes,
            ]
        with progress("peaks"):
            return peaks.find(hit.samples, hit.rate_hz), notes

    def _body(self, folder: Path):
        """Return the record of the cleaned mesh, a searchable model, its exact form or None, and the volume by wall."""
        from vibraverse.listening.resonances import Resonances

        if self.wall:
            from vibraverse.listening.walls import Walls

            clean, bases = self._walls(folder)
            model = Walls({wall: Resonances(basis).table() for wall, basis in bases.items()})
            return clean, model, None, {wall: basis.volume for wall, basis in bases.items()}
        records = {made.step.name: made.content for made in self.mesh.run(self.mesh.needed(folder, "basis"))}
        basis = self._basis(folder)
        exact = Resonances(basis)
        return records["clean"], exact.table(), exact, {1.0: basis.volume}

    def _walls(self, folder: Path):
        """Return the record of the cleaned mesh and the bases of bodies with several walls."""
        first, bases, clean = folder / "outside", {}, {}
        first.mkdir()
        outside = self.mesh.needed(first, "grids")
        for made in self.mesh.run(outside):
            clean = made.content if made.step.name == "clean" else clean
        done = {made.step.name for made in outside}
        for wall in WALLS:
            place = folder / f"wall-{wall:g}"
            shutil.copytree(first, place)
            self.mesh.options["hollow"] = validate(Hollow, {"thickness": [wall, wall]})
            for _ in self.mesh.run(self._left(place, done)):
                pass
            bases[wall] = self._basis(place)
        return clean, bases

    def _left(self, place: Path, done: set[str]) -> Iterator:
        """Return the jobs that the basis of a body still needs."""
        return [made for made in self.mesh.needed(place, "basis") if made.step.name not in done]

    def _basis(self, place: Path):
        import h5py

        from vibraverse.files.basis import read_basis

        with h5py.File(self.mesh.at(place, "basis")) as h5:
            return read_basis(h5, surface=False)
