"""How well does `vibraverse listen` find materials and walls? Sounds of finer meshes, listened to with those of a run.

    python benchmarks/listen.py results --bodies 20 --kept finer
    python benchmarks/listen.py results --bodies 0 --walls 5

Bodies are those of a finished run, solid and hollow in turns. Each is meshed again from its surface with --elements
tetrahedra. From the modes of that mesh comes the location-invariant sound of every material of the table, with white
noise so many dB below the sound's own level. The basis of the run, on its own mesh, listens. So errors of elements and
of meshing count, and errors of the shape do not. --kept names a folder that keeps the finer bases, because solving
them takes most of the time.

The table has a row per noise. A case counts as found if the command would state an answer. Errors and coverage are
those of found cases: medians, the share within 1 % of E/ρ and within 0.02 of ν, and the share whose 95 % interval
holds the truth.

--walls takes hollow bodies of the run, whose t was drawn, solves bodies with other walls from their surfaces, and
looks for t in the sound of the run's own basis. Bodies whose first eight modes move by less than 1 % are left out.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from vibraverse.commands.heard import FEW, FOUND, NOTHING, Known, facts_of
from vibraverse.commands.listen import WALLS
from vibraverse.config.geometry import Tets
from vibraverse.contract.errors import Refused, UsageError
from vibraverse.contract.products import read_json
from vibraverse.contract.seeds import rng
from vibraverse.files.basis import read_basis, write_basis
from vibraverse.files.meshes import read_ply
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.meshing.tets import mesh_body
from vibraverse.listening import peaks
from vibraverse.listening.answer import answer
from vibraverse.listening.resonances import Resonances
from vibraverse.listening.strikes import strike
from vibraverse.listening.walls import Walls
from vibraverse.machine.threads import set_threads
from vibraverse.physics.basis import build_basis
from vibraverse.physics.impulse import impact_sound
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.modes import solve_material
from vibraverse.physics.plausible import MAX_SPEED_M_S, SIZE_M

_RATE_HZ, _SILENCE_S, _PEAK = 44_100, 0.05, 0.9
_SLOWEST_M_S = 30.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, help="results folder of a finished run")
    parser.add_argument("--bodies", type=int, default=20, help="bodies of which the material is sought")
    parser.add_argument("--walls", type=int, default=0, help="hollow bodies of which the wall is sought")
    parser.add_argument("--materials", nargs="+", default=list(MATERIALS), choices=list(MATERIALS))
    parser.add_argument("--snr", nargs="+", type=float, default=[40.0, 20.0, 10.0], help="in dB")
    parser.add_argument("--elements", type=int, default=6000, help="tetrahedra of the bodies that sound")
    parser.add_argument("--kept", type=Path, help="folder for the bases of these bodies")
    arguments = parser.parse_args()
    set_threads(1)
    if arguments.bodies:
        materials(arguments)
    if arguments.walls:
        walls(arguments)


def materials(arguments) -> None:
    """Print how well materials are found, by noise and then by material at the least noise."""
    rows: dict[float, list[dict]] = {snr: [] for snr in arguments.snr}
    began = time.process_time()
    for number, (name, folder) in enumerate(_bodies(arguments.results, arguments.bodies)):
        try:
            sounding = _finer(arguments, name, folder)
        except Refused as refused:
            print(f"{name}: left out, {refused}")
            continue
        with h5py.File(folder / "basis.h5") as h5:
            exact = Resonances(read_basis(h5, surface=False))
        model, size_m = exact.table(), _size(folder)
        for material in arguments.materials:
            for snr in arguments.snr:
                row = heard(sounding, material, size_m, snr, model, exact, f"{name}-{material}-{snr:g}")
                rows[snr].append({"body": name, "material": material, **row})
        print(f"{number + 1}: {name}, {time.process_time() - began:.0f} s", flush=True)
    print(f"\n{arguments.elements} elements sound\n")
    for title, groups in (
        ("noise", {f"{snr:g} dB": found for snr, found in rows.items()}),
        (
            f"material, {arguments.snr[0]:g} dB",
            {
                one: [row for row in rows[arguments.snr[0]] if row["material"] == one]
                for one in arguments.materials
            },
        ),
    ):
        print(
            f"| {title} | cases | too few peaks | nothing fits | found | E/ρ: median error | within 1 % | "
            "in interval | ν: median error | within 0.02 | in interval | α in interval | β in interval |"
        )
        print("|" + 13 * " --- |")
        for label, group in groups.items():
            print(_table_row(label, group))
        print()


def heard(sounding, material: str, size_m: float, snr: float, model, exact, label: str) -> dict:
    """Return the verdict on one material, and for each number its error and whether its interval holds the truth."""
    true = MATERIALS[material]
    recording = sound(sounding, true, size_m, snr, label)
    known = Known(size_m, None, None, None)
    try:
        found_peaks = peaks.find(strike(recording, _RATE_HZ).samples, _RATE_HZ)
        found = answer(found_peaks, model, _bounds(known, model), exact)
    except UsageError:
        return {"verdict": FEW}
    facts = facts_of(found, found_peaks, exact, known, {1.0: 1.0})
    truth = {**true, "young_per_density_m2_s2": true["young_pa"] / true["density_kg_m3"]}
    result = {"verdict": facts["verdict"]}
    for name, one in facts["found"].items():
        error = one["value"] - truth[name]
        error = error if name == "poisson" else error / truth[name]
        result[name] = abs(error), one["low"] <= truth[name] <= one["high"]
    return result


def walls(arguments) -> None:
    """Print how well walls are found."""
    print(
        "| body | t | first eight modes move by | found | interval | E/ρ error | ν error |\n|" + 7 * " --- |"
    )
    done = 0
    for folder in _folders(arguments.results, "hollow"):
        if done == arguments.walls:
            break
        try:
            bases = dict(_walled(folder))
        except Refused as refused:
            print(f"{folder.parent.name}: left out, {refused}")
            continue
        model = Walls({wall: Resonances(basis).table() for wall, basis in bases.items()})
        ends = [model.at(np.array([0.3, wall])).log_omega[:8] for wall in (WALLS[0], WALLS[-1])]
        moved = float(np.abs(ends[1] - ends[0]).mean())
        if moved < 0.01:
            continue
        done += 1
        with h5py.File(folder / "basis.h5") as h5:
            sounding = read_basis(h5, surface=False)
        size_m, t = _size(folder), read_json(folder / "hollow.json")["t"]
        material = list(MATERIALS)[done % len(MATERIALS)]
        recording = sound(sounding, MATERIALS[material], size_m, arguments.snr[0], f"{folder}-wall")
        known = Known(size_m, None, None, None)
        heard_peaks = peaks.find(strike(recording, _RATE_HZ).samples, _RATE_HZ)
        found = answer(heard_peaks, model, _bounds(known, model))
        facts = facts_of(found, heard_peaks, model, known, dict.fromkeys(WALLS, 1.0))
        if facts["verdict"] != FOUND:
            print(
                f"| {folder.parent.name}, {material} | {t:.3f} | {100 * moved:.1f} % | {facts['verdict']} |"
            )
            continue
        one, true = facts["found"], MATERIALS[material]
        ratio = one["young_per_density_m2_s2"]["value"] * true["density_kg_m3"] / true["young_pa"]
        print(
            f"| {folder.parent.name}, {material} | {t:.3f} | {100 * moved:.1f} % | {one['wall']['value']:.3f} | "
            f"{one['wall']['low']:.3f} to {one['wall']['high']:.3f} | {100 * (ratio - 1):+.2f} % | "
            f"{one['poisson']['value'] - true['poisson']:+.3f} |",
            flush=True,
        )


def sound(basis, material: dict, size_m: float, snr: float, label: str) -> np.ndarray:
    """Return a recording (n, 1): silence, the impact sound of a basis, silence, and white noise."""
    modes = solve_material(basis, material, size_m / LONGEST_SIDE, 64)
    struck = impact_sound(modes.frequencies_hz, modes.damping_per_s, _RATE_HZ).samples
    struck = struck * _PEAK / max(np.abs(struck).max(), 1e-300)
    silence = np.zeros(round(_SILENCE_S * _RATE_HZ))
    noise = np.sqrt(np.mean(struck**2)) * 10 ** (-snr / 20)
    whole = np.concatenate([silence, struck, silence])
    whole = whole + noise * rng("listen", label).standard_normal(len(whole))
    return (whole / max(np.abs(whole).max(), 1.0))[:, None]


def _bounds(known: Known, model) -> np.ndarray:
    return known.bounds(model.bounds, _SLOWEST_M_S, MAX_SPEED_M_S, SIZE_M)


def _folders(results: Path, solidity: str) -> list[Path]:
    """Return the folders of the finished bodies in an order that mixes families."""
    found = [one.parent for one in results.glob(f"objects/*/{solidity}/modes.h5")]
    return sorted(
        (one for one in found if _is_whole(one)), key=lambda one: rng(one.parent.name, "listen").random()
    )


def _is_whole(folder: Path) -> bool:
    return all(h5py.is_hdf5(folder / name) for name in ("basis.h5", "modes.h5"))  # a refusal is a text


def _bodies(results: Path, count: int) -> Iterator[tuple[str, Path]]:
    """Yield names and folders of bodies, solid and hollow in turns."""
    solid, empty = _folders(results, "solid"), _folders(results, "hollow")
    for i in range(min(count, len(solid))):
        folder = empty[i] if i % 2 and i < len(empty) else solid[i]
        yield f"{folder.parent.name}-{folder.name}", folder


def _size(folder: Path) -> float:
    with h5py.File(folder / "modes.h5") as h5:
        return float(h5.attrs["size_m"])


def _finer(arguments, name: str, folder: Path):
    """Return the basis of a body on a finer mesh, from the folder of kept ones if it is there."""
    kept = arguments.kept and arguments.kept / f"{name}-{arguments.elements}.h5"
    if kept and kept.is_file():
        with h5py.File(kept) as h5:
            return read_basis(h5, surface=False)
    surface = folder / "surface.ply" if folder.name == "hollow" else folder.parent / "surface.ply"
    basis = _solved(*read_ply(surface), arguments.elements, name)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(kept, "w") as h5:
            write_basis(h5, basis)
    return basis


def _solved(vertices: np.ndarray, faces: np.ndarray, elements: int, label: str):
    mesh = mesh_body(vertices, faces, Tets(target_elements=elements))
    return build_basis(mesh.points, mesh.cells, rng=rng(label, "listen"))


def _walled(folder: Path) -> Iterator[tuple[float, object]]:
    """Yield walls and the bases of bodies that have them."""
    vertices, faces = read_ply(folder.parent / "surface.ply")
    with h5py.File(folder.parent / "grids.h5") as h5:
        distance = h5["signed_distance"][:]
    for wall in WALLS:
        body = hollow(vertices, faces, distance, wall)
        yield wall, _solved(body.vertices, body.faces, 1500, f"{folder.parent.name}-{wall:g}")


def _table_row(label: str, group: list[dict]) -> str:
    found = [row for row in group if row["verdict"] == FOUND]

    def share(rows) -> str:
        rows = list(rows)
        return f"{100 * np.mean(rows):.0f} %" if rows else "–"

    def numbers(name: str) -> list[tuple[float, bool]]:
        return [row[name] for row in found if name in row]

    ratio, poisson = numbers("young_per_density_m2_s2"), numbers("poisson")
    cells = [
        label,
        len(group),
        sum(row["verdict"] == FEW for row in group),
        sum(row["verdict"] == NOTHING for row in group),
        len(found),
        f"{100 * np.median([one[0] for one in ratio]):.2f} %" if ratio else "–",
        share(one[0] < 0.01 for one in ratio),
        share(one[1] for one in ratio),
        f"{np.median([one[0] for one in poisson]):.4f}" if poisson else "–",
        share(one[0] < 0.02 for one in poisson),
        share(one[1] for one in poisson),
        *(share(one[1] for one in numbers(name)) for name in ("alpha_per_s", "beta_s")),
    ]
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    main()
