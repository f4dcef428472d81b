"""Products of other families' stages, written by hand for the check of an image; see ``check.py``."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from check import Check

OBJECT = "bar-0000"
#: The cheapest body of the validation.
KNOWN = "block"


def box(cells: int = 1) -> tuple:
    """Return points (N, 3) and tetrahedra (6 cells³, 4) of a box with this many cells along each side."""
    import numpy as np

    across = cells + 1
    steps = np.arange(across) / cells * 2 - 1
    points = np.array([(0.9 * x, 0.3 * y, 0.2 * z) for x in steps for y in steps for z in steps])
    corner = np.array([x * across**2 + y * across + z for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    rings = [(1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)]
    one = corner[[(0, 7, b, a) for a, b in rings]]
    at = [x * across**2 + y * across + z for x in range(cells) for y in range(cells) for z in range(cells)]
    return points, np.concatenate([one + first for first in at])


def tets(check: Check, path: Path) -> None:
    """Write a box of tetrahedra."""
    from vibraverse.files.tets import write_tets

    write_tets(path, *box())


def clean_record(check: Check, path: Path) -> None:
    """Write the size of an object, from whose mesh nothing is missing."""
    whole = {"repairs": [], "dropped": {"volume_share": 0.0}, "deviation": {"invented": 0.0}}
    path.write_text(json.dumps({"size_m": 0.2, "size_origin": "generated", **whole}))


def source_record(check: Check, path: Path) -> None:
    """Write where an object came from."""
    path.write_text(json.dumps({"object": OBJECT, "origin": "generated", "licence": "CC0-1.0"}))


def views(check: Check, path: Path) -> None:
    """Write one picture and its record."""
    from PIL import Image

    path.mkdir()
    Image.new("RGB", (64, 64), "teal").save(path / "clay-00.png")
    (path / "images.json").write_text(json.dumps({"views": [{}], "looks": ["clay"]}))


def tets_record(check: Check, path: Path) -> None:
    """Write the counts of a mesh."""
    path.write_text(json.dumps({"tetrahedra": 6, "quality": {"wanted": 6}, "warnings": []}))


def sounds(check: Check, path: Path) -> None:
    """Write the record of sounds without the sounds."""
    options = check.plan.config.audio.model_dump(mode="json")
    path.mkdir()
    (path / "audio.json").write_text(json.dumps({"provenance": {"options": options}}))


def page_body_record(check: Check, path: Path) -> None:
    """Write the record of a body on the page."""
    record = {"order": 2, "measured": {}, "provenance": {"output_sha256": {"script": "0" * 64}}}
    path.write_text(json.dumps(record))


def boundary(cells: list) -> list[tuple]:
    """Return the triangles of tetrahedra that bound one of them alone, outwards."""
    seen: dict[frozenset, tuple] = {}
    for a, b, c, d in cells:
        for face in ((b, c, d), (a, d, c), (a, b, d), (a, c, b)):
            seen[frozenset(face)] = () if frozenset(face) in seen else face
    return [face for face in seen.values() if face]


def surface(check: Check, path: Path) -> None:
    """Write the surface of a box."""
    from vibraverse.files.meshes import write_ply

    points, cells = box()
    write_ply(path, points, boundary(cells.tolist()))


def basis(check: Check, path: Path) -> None:
    """Write a modal basis of random fields on a box."""
    import numpy as np

    from vibraverse.contract.products import hdf5
    from vibraverse.files.basis import write_basis
    from vibraverse.physics.reduced import ModalBasis

    random, (points, cells), rank, corrections = np.random.default_rng(0), box(), 16, 8
    columns = np.vstack([np.zeros((rank, corrections)), np.diag(np.arange(20.0, 28.0))])
    fields = random.normal(size=(len(points), 3, rank + corrections))
    made = ModalBasis(
        a_lambda=np.diag(np.arange(1.0, rank + 1)),
        a_mu=np.diag(np.arange(2.0, rank + 2)),
        sketch=np.zeros((1, 4, 3 * rank)),
        energy_poisson=np.array([0.25]),
        vertices=points,
        faces=np.array(boundary(cells.tolist())),
        surface=fields[..., :rank],
        correction_lambda=columns,
        correction_mu=columns,
        correction_mass=np.zeros((rank, corrections)),
        correction_surface=fields[..., rank:],
        poisson_range=np.array([0.1, 0.4]),
        poisson_nodes=np.array([0.25]),
        error=1e-6,
        residuals=np.zeros(corrections),
        volume=1.8 * 0.6 * 0.4,
        centre=np.zeros(3),
        inertia=np.eye(3),
        order=1,
        n_vertices=len(points),
        n_tetrahedra=len(cells),
        n_unknowns=3 * len(points),
        method="made up",
        factorisation="made up",
    )
    with hdf5(path) as h5:
        write_basis(h5, made)


def modes(check: Check, path: Path) -> None:
    """Write frequencies of a body, which belong to no basis."""
    import numpy as np

    from vibraverse.contract.products import hdf5, write_provenance

    with hdf5(path) as h5:
        write_provenance(h5, {"stage": "modes", "options": {"corrected": True}})
        h5.attrs.update({"size_m": 0.2, "scale_m": 0.2 / 1.8, "volume_m3": 1e-3})
        for name, material in check.plan.config.materials.items():
            group = h5.create_group(f"materials/{name}")
            group["frequencies_hz"] = np.arange(1.0, 9.0) * 1000
            group["discretisation_error"] = np.full(8, 1e-3)
            group.attrs.update({**material.model_dump(), "solved_directly": False, "mass_kg": 1.0})


def known_meshes(check: Check, path: Path) -> None:
    """Write two meshes of a box."""
    import h5py

    with h5py.File(path, "w") as h5:
        h5.attrs["scale_m"] = 0.01
        for number, cells in enumerate((3, 4)):
            h5[f"{number}/points"], h5[f"{number}/cells"] = box(cells)


def comparison(check: Check, path: Path) -> None:
    """Write the comparison of two meshes of a body with one reference."""
    reference = {"mode": "1", "equal": 1, "poisson": 0.3, "reference_hz": 1000.0, "tolerance": 0.1}
    about = {"order": 2, "corrected": "no", "verdict": "met", "published": False, "source": "made up"}
    rows = [
        {"body": KNOWN, **reference, "computed_hz": 1000 * (1 + error), "relative_error": error, **about,
         "tetrahedra": unknowns // 3, "unknowns": unknowns}
        for unknowns, error in ((300, 0.01), (3000, 0.001))
    ]  # fmt: skip
    path.write_text(json.dumps({"body": KNOWN, "rows": rows}))


def configuration(check: Check, path: Path) -> None:
    """Write the configuration with every default filled in, as JSON, which is YAML; images have no YAML library."""
    path.write_text(json.dumps(check.plan.config.model_dump(mode="json")), encoding="utf-8")


def refuse_missing(check: Check, shard: str) -> None:
    """Write a refusal in place of every missing product of a shard's objects."""
    from vibraverse.contract import products
    from vibraverse.contract.refusal import Refusal
    from vibraverse.flow import targets

    refusal = Refusal(OBJECT, "clean", "empty", "nothing to see", "add triangles").to_text()
    for product in map(Path, targets.shard_products(check.plan, shard)):
        if not product.exists():
            products.write_text(product, refusal)
    for object_ in check.plan.shards[shard]:
        record = check.at("source_record", object=object_)
        if record.read_text(encoding="utf-8") == refusal:
            source = {"object": object_, "origin": "files", "format": "off", "file": f"{object_}.off"}
            products.write_json(record, {**source, "provenance": {}})


def packed(check: Check, path: Path) -> None:
    """Write a shard of refused objects with the library."""
    import h5py

    from vibraverse.config.dataset import ShardOptions
    from vibraverse.contract import products
    from vibraverse.dataset.write.pack import finish, pack_object

    refuse_missing(check, path.stem)
    options = ShardOptions.model_validate_json(check.plan.options("dataset", shard=path.stem))
    with h5py.File(path, "w") as h5:
        groups = h5.create_group("objects")
        rows = [pack_object(groups, check.plan.paths, name, options, path.name) for name in options.objects]
        finish(h5, rows)
        products.write_provenance(h5, {"stage": "dataset", "libraries": {}})


def indexed(check: Check, path: Path) -> None:
    """Write the index, the refusals and the record of a dataset with the library."""
    from vibraverse.contract import products
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.summary import summary

    shards = check.all_of("shard")
    for shard in shards:
        if not shard.exists():
            packed(check, shard)
    with Reader(shards) as reader:
        write_index(check.at("index_columns"), reader.index)
        materials = {name: one.model_dump() for name, one in check.plan.config.materials.items()}
        record = {**summary(reader, {}), "materials": materials, "shards": {}}
        products.write_json(check.at("dataset_record"), record)


def bodies(check: Check) -> None:
    """Write features of twelve objects, both bodies, in place of the shard's, and their splits."""
    import numpy as np

    from vibraverse.learn import features, inside

    random, (folder,) = np.random.default_rng(0), check.all_of("features")
    objects = [f"bar-{number:04d}" for number in range(12)]
    count, modes = 2 * len(objects), 8
    steel, mesh = {"density_kg_m3": 7850.0, "young_pa": 2e11, "poisson": 0.25}, inside.describe(*box(2))
    features.write_meshes(folder, [mesh] * count)
    spectra = np.sort(random.normal(size=(count, 3, modes)), axis=-1).astype(np.float32)
    arrays = {
        "points": random.uniform(-0.9, 0.9, (count, 512, 6)).astype(np.float32),
        "invariants": random.uniform(1, 2, (count, 5)).astype(np.float32),
        "log_omega": spectra,
        "ritz": spectra[:, :, None] + np.array([0.3, 0.2, 0.1, 0.05, 0.02], np.float32)[:, None],
        "frequencies_hz": 1000 * np.exp(spectra[:, :1]).astype(float),
        "scales": np.tile(mesh["scales"], (count, 1)),
        **dict.fromkeys(("volume_m3", "size_m"), np.full(count, 0.1)),
        "thickness": np.tile([np.nan, 0.5], len(objects)),
        "object_row": np.repeat(np.arange(len(objects)), 2),
        "views": random.integers(0, 256, (len(objects), 2, 64, 64, 3), dtype=np.uint8),
        "distance_places": random.integers(-30_000, 30_000, (count, 3, 2048, 3), dtype=np.int16),
        "distances": random.uniform(-0.1, 0.5, (count, 2, 2048)).astype(np.float16),
        "voxels": np.pad(np.ones((len(objects), 12, 4, 4), np.uint8), [(0, 0), (2, 2), (6, 6), (6, 6)]),
        "farthest": np.tile(np.arange(64, dtype=np.int32), (len(objects), 1)),
    }
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    both = {"object": np.repeat(objects, 2).tolist(), "solidity": ["solid", "hollow"] * len(objects)}
    both |= {"origin": ["generated"] * count, "family": ["bar"] * count}
    named = {"objects": objects, "materials": {"steel": steel}, "poisson": [0.1, 0.25, 0.4]}
    spaces = {"ritz_degrees": [4, 6, 8], "ritz_unknowns": [1000, 3000], "voxel_points": 32_768}
    (folder / "features.json").write_text(json.dumps({"bodies": both, **spaces, **named}))
    lines = "".join(map("{}\t{}\t\n".format, objects, ["train"] * 8 + ["validation"] * 2 + ["test"] * 2))
    check.at("splits").write_text(f"object\tsplit\tcopy_of\n{lines}")


def features(check: Check, path: Path) -> None:
    """Write features of some bodies."""
    path.mkdir(exist_ok=True)
    bodies(check)


def evaluation(check: Check, path: Path) -> None:
    """Write the measures of a model, made from other data than the features."""
    trained = next(one for one in check.plan.trainings() if check.at("evaluation", **one) == path)
    options = json.loads(check.plan.training(SimpleNamespace(**trained)))
    training = {"kind": "model", "preset": "tiny", "minutes": 1.0, "threads": 1, "hardware": "made up"}
    about = {
        "rows": [],
        "right": {},
        "training": training,
        "config_hash": "0",
        "data_sha256": "0",
        "version": "0",
    }
    values = {**trained, "seed": int(trained["seed"]), **about, "provenance": {"options": options}}
    path.write_text(json.dumps(values))


def curves(check: Check, path: Path) -> None:
    """Write the curves of a training of one step."""
    path.write_text("step,loss,validation\n1,0.5,0.6\n")


def answers(check: Check, path: Path) -> None:
    """Write answers about no body."""
    import numpy as np

    with open(path, "wb") as file:
        np.savez(file, body=np.array([], dtype=str))


def results(check: Check, path: Path) -> None:
    """Write the table of all models without a row."""
    path.write_text(json.dumps({"rows": []}))


#: Functions that write the products of other families' stages, by pattern.
BY_HAND = {
    "tets": tets,
    "clean_record": clean_record,
    "surface": surface,
    "source_record": source_record,
    "views": views,
    "tets_record": tets_record,
    "sounds": sounds,
    "page_body_record": page_body_record,
    "basis": basis,
    "modes": modes,
    "validation_meshes": known_meshes,
    "validation_comparison": comparison,
    "config": configuration,
    "shard": packed,
    "index_columns": indexed,
    "dataset_record": indexed,
    "features": features,
    "splits": features,
    "evaluation": evaluation,
    "training_curves": curves,
    "answers": answers,
    "results_record": results,
}
