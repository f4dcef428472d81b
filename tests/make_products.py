"""A small but complete results tree, written without running the stages that really make it.

Shapes are stars around their centre, spectra are drawn from the object's seed; everything else agrees as in a real run:
frequencies scale with ``sqrt(E/ρ)/L``, sounds are the modes' impulse responses, pictures are PNG files. One object
is refused by ``clean``, and of another only the hollow body is refused. A stage that nothing here knows gets a record
of its provenance alone.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import h5py
import numpy as np
import trimesh
from PIL import Image

from vibraverse.cli import main
from vibraverse.config.media import Audio
from vibraverse.config.physics import Sampled
from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal
from vibraverse.contract.seeds import rng
from vibraverse.files import meshes
from vibraverse.files.tets import write_tets
from vibraverse.flow.paths import Paths
from vibraverse.media.audio import wav_bytes
from vibraverse.physics.impulse import impact_sound
from vibraverse.physics.materials import MATERIALS, lame, sampled
from vibraverse.upkeep.lineage import jobs

MATERIAL_NAMES = ("ceramic", "glass", "wood", "steel")
LOOKS = ("clay", *MATERIAL_NAMES)
OBJECTS = ("ball-0000", "bar-0000", "leaf")
SIZE_M = 0.18
MODES = 64
#: Sampled materials of every body; none has a sound.
SAMPLED = 3
SOUND = Audio(max_s=1.5)

_SHAPES = {
    "bar-0000": lambda: trimesh.creation.box((1.8, 0.4, 0.3)).subdivide(),
    "ball-0000": lambda: trimesh.creation.icosphere(2, 0.9),
}
_COLOURS = {
    "clay": (205, 196, 184),
    "ceramic": (236, 234, 228),
    "glass": (150, 200, 205),
    "wood": (160, 112, 70),
    "steel": (140, 146, 156),
}


def options(results, objects=OBJECTS, **changes) -> str:
    """Return the options of the stage ``dataset`` for these products."""
    return json.dumps(
        {
            "results": str(results),
            "objects": list(objects),
            "materials": MATERIAL_NAMES,
            "looks": LOOKS,
            **changes,
        }
    )


def make(results: Path, objects=OBJECTS, views: int = 3) -> Paths:
    """Write the products of ``objects``; a name with an unknown shape is drawn as a ball."""
    paths = Paths(results)
    for object_id in objects:
        if object_id == "leaf":
            refuse(paths, object_id, "clean", "not_a_solid", "leaf.obj is flat: it bounds no volume.")
            _others(paths, object_id)
            continue
        shape = _SHAPES.get(object_id, _SHAPES["ball-0000"])()
        vertices, faces = np.asarray(shape.vertices), np.asarray(shape.faces)
        _object(paths, object_id, vertices, faces, views)
        _body(paths, object_id, "solid", vertices, faces)
        if object_id.startswith("ball"):
            refuse(paths, object_id, "hollow", "too_thin", "The wall of ball-0000 would be too thin.")
        else:
            _body(paths, object_id, "hollow", vertices, faces)
        _others(paths, object_id)
    return paths


def pack(results: Path, groups=(("ball-0000", "leaf"), ("bar-0000",))) -> list[Path]:
    """Pack the products into shards with the stage ``dataset``, one for each group of objects."""
    paths = Paths(results)
    made = [Path(paths.at(paths.shard, shard=str(number))) for number in range(len(groups))]
    for shard, objects in zip(made, groups, strict=True):
        call("dataset", "--shard", shard, "--options", options(results, objects))
    return made


def index(results: Path, shards: list[Path], *more) -> None:
    """Write index, splits, refusals and record of the shards with the stage ``index``; ``more`` are arguments."""
    paths = Paths(results)
    tables = ("--index", paths.index, "--splits", paths.splits, "--refusals", paths.refusals)
    about = ("--card", paths.card, "--overview", paths.overview, "--croissant", paths.croissant)
    columns = ("--columns", paths.index_columns, "--parquet", paths.index_parquet)
    others = ("--record", paths.dataset_record, "--sums", paths.dataset_sums)
    call("index", "--shards", *shards, *tables, *columns, *about, *others, *more)


def report(results: Path, **changes) -> Path:
    """Write the page with the stage ``report``; it links that of learning where there is one."""
    paths = Paths(results)
    learning = ("--learning", paths.learn_page) if Path(paths.learn_page).exists() else ()
    inputs = ("--index", paths.index_columns, "--record", paths.dataset_record)
    outputs = (
        "--page",
        paths.report,
        "--times",
        paths.page_times,
        "--options",
        json.dumps({"results": str(results), **changes}),
    )
    call("report", *inputs, *learning, *outputs)
    return Path(paths.report)


def page_data(results: Path, objects=OBJECTS) -> None:
    """Write what the page needs of each object beside it: the record and the thumbnail."""
    folder = Path(Paths(results).report).parent / "data/objects"
    folder.mkdir(parents=True, exist_ok=True)
    for object_id in objects:
        row = {"title": f"The {object_id}", "source": "files", "version": products.text_sha256(object_id)[:8]}
        row["bodies"] = {} if object_id == "leaf" else {"solid": {"worst_error": 0.001}}
        thumbnail = folder / f"{object_id}.thumb.webp"
        Image.open(io.BytesIO(_picture("clay", 0))).save(thumbnail)
        stated = {
            **provenance("page_object", object_id),
            "output_sha256": {"thumbnail": products.sha256(thumbnail)},
        }
        record = {"object": object_id, "row": row, "warnings": [], "provenance": stated}
        products.write_json(folder / f"{object_id}.json", record)


def build(results: Path) -> Paths:
    """Write the products, pack them into two shards and index those; write the data of the page."""
    paths = make(results)
    index(results, pack(results))
    page_data(results)
    return paths


def call(*arguments) -> None:
    """Run the command line, which must succeed."""
    assert main([str(argument) for argument in arguments]) == 0, arguments


def provenance(stage: str, object_id: str, solidity: str = "", **values) -> dict:
    """Return a provenance as a stage states it."""
    return {
        "stage": stage,
        "stage_version": 1,
        "vibraverse": "0.1.0",
        "libraries": {"numpy": np.__version__},
        "object": object_id,
        "solidity": solidity,
        "options": values,
        "input_sha256": {},
    }


def frequencies(object_id: str, solidity: str, material: dict, size_m: float = SIZE_M) -> np.ndarray:
    """Return the stand-in's eigenfrequencies in Hz: those of :func:`stiffness` in a material."""
    omega = np.sqrt(stiffness(object_id, solidity) * lame(1.0, material["poisson"])[1])
    return omega * np.sqrt(material["young_pa"] / material["density_kg_m3"]) / (size_m / 1.8) / (2 * np.pi)


def stiffness(object_id: str, solidity: str) -> np.ndarray:
    """Return the diagonal (MODES,) of the stand-in's reduced stiffness of μ; that of λ is zero.

    Objects of one shape have one spectrum.
    """
    shape = object_id if object_id in _SHAPES else "ball-0000"
    spread = np.sort(rng(shape, "spectrum").uniform(0.16, 1.6, MODES))
    return (spread * (0.72 if solidity == "hollow" else 1.0) * np.pi) ** 2


def refuse(paths: Paths, object_id: str, stage: str, reason: str, message: str) -> None:
    """Write a refusal in place of the products of ``stage`` and of all later stages."""
    text = Refusal(object_id, stage, reason, message, "Use a closed mesh with a thicker wall.").to_text()
    if stage == "clean":
        source = {"object": object_id, "origin": "files", "format": "obj", "file": "leaf.obj"}
        source["provenance"] = provenance("sources", object_id)
        products.write_json(paths.at(paths.source_record, object=object_id), source)
        products.write_text(paths.at(paths.source_mesh, object=object_id), "v 0 0 0\n")
    refused: set[Path] = set()
    for made in jobs(paths, object_id):
        if made.step.name == stage or not refused.isdisjoint(map(made.input, made.step.chained)):
            refused.update(made.places)
            for name, output in made.step.outputs.items():
                products.write_text(output.record_in(made.place(name)), text)


def _others(paths: Paths, object_id: str) -> None:
    """Write the records of the stages that nothing else here makes."""
    for made in jobs(paths, object_id):
        if made.record.exists():
            continue
        stated = provenance(made.step.name, object_id, made.solidity)
        made.record.parent.mkdir(parents=True, exist_ok=True)
        if made.record.suffix == ".json":
            products.write_json(made.record, {"object": object_id, "provenance": stated})
        else:
            with h5py.File(made.record, "w") as h5:
                products.write_provenance(h5, stated)


def _object(paths: Paths, object_id: str, vertices, faces, views: int) -> None:
    def at(pattern: str, **more) -> Path:
        path = Path(paths.at(pattern, object=object_id, **more))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    family = object_id.split("-")[0]
    source = {
        "object": object_id,
        "origin": "generated",
        "format": "ply",
        "file": f"{object_id}.ply",
        "title": f"A {family}",
        "category": family,
        "licence": "CC0-1.0",
        "attribution": None,
        "size_m": SIZE_M,
        "unit_m": None,
        "parameters": {"length": 1.0},
        "provenance": provenance("sources", object_id, seed=object_id),
    }
    products.write_json(at(paths.source_record), source)
    meshes.write_ply(at(paths.source_mesh), vertices, faces)
    meshes.write_ply(at(paths.surface), vertices, faces)
    clean = {
        "object": object_id,
        "rung": "as it is",
        "repairs": [],
        "dropped": {"parts": 0, "volume_share": 0.0},
        "deviation": {"invented": 0.0},
        "vertices": len(vertices),
        "triangles": len(faces),
        "centre": [0.0, 0.0, 0.0],
        "scale": 1.0,
        "genus": 0,
        "provenance": provenance("clean", object_id, max_triangles=2_000_000),
    }
    products.write_json(at(paths.clean_record), clean)
    grid = -1 + (2 * np.arange(16) + 1) / 16
    distance = np.linalg.norm(np.stack(np.meshgrid(grid, grid, grid, indexing="ij")), axis=0) - 0.7
    with h5py.File(at(paths.grids), "w") as h5:
        h5["occupancy"] = (distance < 0).astype(np.uint8)
        h5["signed_distance"] = distance.astype(np.float32)
        products.write_provenance(h5, provenance("grids", object_id, coarse=16))
    box = trimesh.creation.box((1, 1, 1))
    at(paths.coarse).write_text(box.export(file_type="obj"))
    for look in LOOKS:
        for view in range(views):
            at(paths.view, look=look, view=f"{view:02d}").write_bytes(_picture(look, view))
    images = {
        "views": [{"azimuth_deg": 360.0 * view / views, "elevation_deg": 25.0} for view in range(views)],
        "looks": list(LOOKS),
        "size_px": 96,
        "provenance": provenance("images", object_id, views=views),
    }
    products.write_json(at(paths.images_record), images)


def _body(paths: Paths, object_id: str, solidity: str, vertices, faces) -> None:
    def at(pattern: str, **more) -> Path:
        path = Path(paths.at(pattern, object=object_id, solidity=solidity, **more))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    if solidity == "hollow":
        inner = np.concatenate([vertices, 0.5 * vertices])
        both = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
        meshes.write_ply(at(paths.hollow_surface), inner, both)
        record = {"t": 0.5, "s_min": -0.3, "provenance": provenance("hollow", object_id, "hollow")}
        products.write_json(at(paths.hollow_record), record)
    points = np.concatenate([vertices, [[0.0, 0.0, 0.0]]])
    tets = np.column_stack([faces[:, ::-1], np.full(len(faces), len(vertices))])
    write_tets(at(paths.tets), points, tets)
    corners = points[tets]
    volume = float(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6)
    record = {"vertices": len(points), "tetrahedra": len(tets), "volume": volume, "warnings": []}
    angle, layers = {"min": 12.5}, {"p05": 1.25, "median": 2.5}
    record["quality"] = {"wanted": 6000, "min_dihedral_deg": angle, "slivers": 0, "layers": layers}
    record["provenance"] = provenance("tets", object_id, solidity, target_elements=6000)
    products.write_json(at(paths.tets_record), record)

    random = rng(object_id, solidity)
    rank = MODES
    fields = random.normal(size=(len(vertices), 3, rank)).astype(np.float32)
    with h5py.File(at(paths.basis), "w") as h5:
        h5.attrs.update(volume=volume, order=2, n_vertices=len(points), n_tetrahedra=len(tets))
        h5.attrs.update(n_unknowns=3 * len(points), method="dense", factorisation="none", error=1e-6)
        h5["reduced/lambda"], h5["reduced/mu"] = (
            np.zeros((rank, rank)),
            np.diag(stiffness(object_id, solidity)),
        )
        h5["reduced/residual_sketch"], h5["reduced/residuals"] = np.zeros((1, 5, 3 * rank)), np.zeros(MODES)
        h5["reduced/energy_poisson"] = [0.3]
        h5["reduced/poisson_range"] = [0.1, 0.4]
        h5["reduced/poisson_nodes"] = [0.1, 0.4]
        h5["surface/vertices"], h5["surface/faces"] = vertices, faces.astype(np.int32)
        h5["surface/basis"] = fields
        # Far stiffer than the modes, so that they hardly change them.
        h5["correction/lambda"] = h5["correction/mu"] = 1e6 * np.eye(rank + 4)[:, rank:]
        h5["correction/mass"] = np.zeros((rank, 4))
        h5["correction/surface"] = random.normal(size=(len(vertices), 3, 4)).astype(np.float32)
        h5["rigid/centre"], h5["rigid/inertia"] = np.zeros(3), np.eye(3)
        products.write_provenance(h5, provenance("basis", object_id, solidity, order=2))
    sounds = {}
    with h5py.File(at(paths.modes), "w") as h5:
        h5.attrs.update(object=object_id, solidity=solidity, size_m=SIZE_M, size_origin="generated")
        h5.attrs["scale_m"] = SIZE_M / 1.8
        h5.attrs["volume_m3"] = volume * (SIZE_M / 1.8) ** 3
        for name in MATERIAL_NAMES:
            material = MATERIALS[name]
            group = h5.create_group(f"materials/{name}")
            group.attrs.update(material, mass_kg=material["density_kg_m3"] * h5.attrs["volume_m3"])
            hz = frequencies(object_id, solidity, material)
            group.attrs["following_hz"] = 1.1 * hz[-1]
            damping = 0.5 * (material["alpha_per_s"] + material["beta_s"] * (2 * np.pi * hz) ** 2)
            group["frequencies_hz"], group["damping_per_s"] = hz, damping
            group["damped_frequencies_hz"] = np.sqrt(np.maximum(hz**2 - (damping / (2 * np.pi)) ** 2, 0))
            group["relative_error"], group["discretisation_error"] = (
                np.full(MODES, 1e-6),
                np.full(MODES, 1e-3),
            )
            group.attrs["solved_directly"] = False
            size = np.sqrt(material["density_kg_m3"] * h5.attrs["scale_m"] ** 3)
            group["mode_coefficients"] = (np.eye(rank) / size).astype(np.float32)
            sound = impact_sound(hz, damping, SOUND.sample_rate_hz, SOUND.decay_db, SOUND.max_s)
            wav, levels = wav_bytes(sound.samples, sound.sample_rate_hz)
            at(paths.sound, material=name).write_bytes(wav)
            sounds[name] = {**levels, "duration_s": sound.duration_s, "modes_rendered": sound.modes_rendered}
        _sampled(h5, object_id, solidity)
        products.write_provenance(h5, provenance("modes", object_id, solidity, modes=MODES, corrected=False))
    record = {
        "sample_rate_hz": 44_100,
        "sounds": sounds,
        "provenance": provenance("audio", object_id, solidity, **SOUND.model_dump(mode="json")),
    }
    products.write_json(at(paths.audio_record), record)


def _sampled(h5, object_id: str, solidity: str) -> None:
    drawn = sampled(object_id, 0, SAMPLED, Sampled().ranges())
    rows = [dict(zip(drawn, row, strict=True)) for row in zip(*drawn.values(), strict=True)]
    drawn["mass_kg"] = drawn["density_kg_m3"] * h5.attrs["volume_m3"]
    drawn["frequencies_hz"] = np.stack([frequencies(object_id, solidity, row) for row in rows])
    for key, array in drawn.items():
        h5[f"sampled/{key}"] = array
    for key in ("relative_error", "discretisation_error"):
        h5[f"sampled/{key}"] = np.full((SAMPLED, MODES), 1e-4, np.float32)


def _picture(look: str, view: int) -> bytes:
    axis = np.linspace(-1, 1, 96)
    x, y = np.meshgrid(axis, axis)
    inside = x**2 + y**2 < 0.7
    light = np.clip(0.55 + 0.45 * (np.cos(view) * -x - y), 0.2, 1.0)[..., None]
    pixels = np.where(inside[..., None], np.array(_COLOURS[look]) * light, 245).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()
