"""``vibraverse predict``: ask a trained model which frequencies a mesh has, with error bars and without a simulation.

The mesh is cleaned by the workflow's own stages, as that of ``strike``, because the model was trained on such surfaces.
"""

from __future__ import annotations

import argparse
import glob
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vibraverse.commands import run_arguments, run_config, run_paths
from vibraverse.commands.one_mesh import (
    DEFAULT_MATERIAL,
    OneMesh,
    check_installed,
    check_writable,
    mesh_arguments,
    progress,
    read_material,
    size_warnings,
    sound_warnings,
    surface_warnings,
    work_folder,
    write_facts,
)
from vibraverse.config.learn import OBJECT
from vibraverse.config.media import Audio
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.step import BODY
from vibraverse.contract.texts import DEFAULT_CONFIG
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import BY_NAME
from vibraverse.machine.threads import set_threads
from vibraverse.physics.materials import MATERIALS
from vibraverse.upkeep.lineage import needed


def parser() -> argparse.ArgumentParser:
    """Return the arguments of the command."""
    p = argparse.ArgumentParser(
        prog="vibraverse predict",
        parents=[mesh_arguments(), run_arguments()],
        description="Ask a trained model for the frequencies of a mesh, with error bars, and for its impact sound.",
        epilog="The sound is the location-invariant one of the dataset: every mode gets the same impulse, so its "
        "amplitude falls with its frequency. A struck point would need mode shapes, which the model does not predict.",
    )
    p.add_argument(
        "--model",
        type=Path,
        metavar="DIR",
        help="folder of a training of the task frequencies (default: the best one of the results)",
    )
    p.add_argument(
        "--material",
        nargs="+",
        action="extend",
        metavar="NAME|NUMBERS",
        help=f"names (of the configuration, or of {', '.join(MATERIALS)}), or numbers: Young's modulus in Pa, density "
        f"in kg/m³, Poisson's ratio and, for the sound, alpha in 1/s and beta in s, such as 7.2e10,2700,0.19 "
        f"(default {DEFAULT_MATERIAL})",
    )
    p.add_argument(
        "--check",
        action="store_true",
        help="simulate the body too, as strike does, and show the errors; --order and --elements are for this",
    )
    p.add_argument(
        "--sound",
        type=Path,
        metavar="WAV",
        help="write the impact sound; with several materials, each is added to the name",
    )
    p.add_argument("--json", metavar="FILE", help="write all numbers as JSON; - prints them")
    return p


def main(argv: list[str]) -> int:
    """Run the command; return 0."""
    arguments = parser().parse_args(argv)
    set_threads(max(1, arguments.threads))
    plan = _Predict(arguments)
    with work_folder("predict", arguments.mesh) as folder:
        facts = plan.run(folder)
    from vibraverse.commands.predicted import print_facts  # not earlier: it imports numerical libraries

    if arguments.sound:
        plan.write_sounds(facts)
    print_facts(facts, write_facts(facts, arguments.json))
    return 0


class _Predict:
    """The validated request; raises :class:`UsageError` before anything is computed."""

    def __init__(self, arguments: argparse.Namespace):
        from vibraverse.learn.trained import read  # imports NumPy

        self.surface = "clean" if arguments.hollow is None else "hollow"
        check_installed("predict", ("evaluate", *_stages(self.surface)))
        if arguments.check:
            check_installed("predict --check", _stages("modes"))
        named = dict(MATERIALS)
        if arguments.config or Path(DEFAULT_CONFIG).is_file():
            named |= {name: one.model_dump() for name, one in run_config(arguments).materials.items()}
        asked = arguments.material or [DEFAULT_MATERIAL]
        self.materials = {text: read_material(text, named) for text in asked}
        self.checked, self.sound = arguments.check, arguments.sound
        for path in (arguments.sound, arguments.json if arguments.json != "-" else None):
            if path is not None:
                check_writable(Path(path))
        self.trained = read(arguments.model or _best(run_paths(arguments)))
        self.mesh = OneMesh(arguments, self.materials, self.trained.layout.modes)
        self.values = {name: one.model_dump() for name, one in self.materials.items()}

    def run(self, folder: Path) -> dict:
        """Predict, and simulate if asked to; return the facts."""
        from vibraverse.commands import predicted
        from vibraverse.files.meshes import read_ply
        from vibraverse.geometry import LONGEST_SIDE, surfaces
        from vibraverse.learn.trained import COVERED, error_bars

        mesh, seconds = self.mesh, {}
        with _timed(seconds, "loading"), progress("model"):
            from vibraverse.learn.prediction import Predictor  # imports PyTorch

            predictor = Predictor(self.trained, mesh.threads)
        clean, done = {}, set()
        with _timed(seconds, "cleaning"):
            for made in mesh.run(mesh.needed(folder, self.surface)):
                clean = made.content if made.step.name == "clean" else clean
                done.add(made.step.name)
        with _timed(seconds, "predicting"), progress("prediction"):
            vertices, faces = read_ply(mesh.at(folder, "boundary"))
            size_m, _ = mesh.options["modes"].object_size(clean)
            volume_m3 = surfaces.volume(vertices, faces) * (size_m / LONGEST_SIDE) ** 3
            found = predictor.frequencies(vertices, faces, mesh.object, mesh.solidity, volume_m3, self.values)
        bars = error_bars(self.trained, mesh.solidity)
        rows = {
            name: predicted.row(one, volume_m3, found_hz, bars)
            for (name, one), found_hz in zip(self.values.items(), found, strict=True)
        }
        if self.checked:
            with _timed(seconds, "simulating"):
                for _ in mesh.run(
                    [made for made in mesh.needed(folder, "modes") if made.step.name not in done]
                ):
                    pass
            for name, row in rows.items():
                row |= predicted.compared(row, predicted.simulated(mesh.at(folder, "modes"), name))
        return {
            "mesh": mesh.path.name,
            "solidity": mesh.solidity,
            "size_m": size_m,
            "volume_m3": volume_m3,
            "model": predicted.about(self.trained),
            "error_bars": bars and {"percent": COVERED, **bars.measured_on()},
            "materials": rows,
            "sounds": {},
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "repairs": clean["repairs"],
            "warnings": [
                *surface_warnings(clean),
                *(f"model: {sentence}" for sentence in predictor.cautions(self.values)),
                *predicted.bar_warnings(bars),
                *size_warnings(clean, mesh.options["modes"]),
            ],
        }

    def write_sounds(self, facts: dict) -> None:
        """Write the sound of every material, and add the files and their warnings to the facts."""
        from vibraverse.media.audio import wav_bytes
        from vibraverse.physics.impulse import impact_sound

        options, rows = Audio(), facts["materials"]
        for name, row in rows.items():
            path = self.sound
            if len(rows) > 1:
                path = path.with_stem(f"{path.stem}-{name.replace(',', '_')}")
            sound = impact_sound(
                row["frequencies_hz"],
                row["damping_per_s"],
                options.sample_rate_hz,
                options.decay_db,
                options.max_s,
            )
            wav, _ = wav_bytes(sound.samples, sound.sample_rate_hz, options.subtype)
            with products.whole(path) as partial:
                partial.write_bytes(wav)
            facts["sounds"][name] = {"file": str(path), "duration_s": sound.duration_s}
            said = sound_warnings(vars(sound), len(row["frequencies_hz"]), "give smaller alpha and beta")
            facts["warnings"] += [f"{name}: {sentence}" for sentence in said]


def _stages(last: str) -> list[str]:
    """Return the names of the stages that a stage of a body needs, itself included."""
    solidity = "hollow" if BY_NAME[last].per == BODY else ""
    return [made.step.name for made in needed(Paths(), "any", solidity, last)]


def _best(paths: Paths) -> Path:
    """Return the folder of the best model of a run: trained on all families if there is one, then by validation."""
    from vibraverse.learn.trained import TASK, read

    place = {"task": TASK, "split": "*", "model": "*", "seed": "*"}
    found = [Path(one).parent for one in sorted(glob.glob(paths.at(paths.training_record, **place)))]
    if not found:
        raise UsageError(
            f"{paths.results} holds no trained model of the task {TASK!r}; train one with `snakemake learn`, or name "
            "the folder of one with --model"
        )
    usable, wrong = [], None
    for folder in found:
        try:
            usable.append(read(folder))
        except UsageError as error:
            wrong = wrong or error
    if not usable:
        raise wrong
    return min(usable, key=lambda one: (one.options.split != OBJECT, one.validation)).folder


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Add what a part of the work takes to the times."""
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began
