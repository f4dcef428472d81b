"""One object's products as fields of the dataset.

Everything comes as pairs of a filled-in path of :mod:`vibraverse.dataset.schema` and its value, one at a time, so
that a shard of any size is written with the memory of its largest array.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import meshio
import soundfile

from vibraverse import products
from vibraverse.config.media import split_sound
from vibraverse.dataset.chain import OBJECT_CHAIN, body_chain
from vibraverse.meshfiles import read_mesh, read_ply
from vibraverse.paths import Paths

Pairs = Iterator[tuple[str, Any]]


def object_fields(paths: Paths, object_id: str, looks) -> Pairs:
    """Yield what belongs to the object itself: records, surface, grids and pictures."""

    def at(pattern: str, **more) -> Path:
        return Path(paths.at(pattern, object=object_id, **more))

    source = products.read_json(at(paths.source_record))
    for key in ("origin", "title", "category", "licence", "attribution"):
        yield f"@{key}", source.get(key) or ""
    yield "source", _text(source)
    yield "clean", _text(products.read_json(at(paths.clean_record)))
    yield from _surface("surface", at(paths.surface))
    yield from _surface("coarse", at(paths.coarse))
    with h5py.File(at(paths.grids)) as grids:
        for name in ("occupancy", "signed_distance"):
            yield f"grids/{name}", grids[name][()]

    views = products.read_json(at(paths.images_record))["views"]
    for angle in ("azimuth_deg", "elevation_deg"):
        yield f"cameras/{angle}", [view[angle] for view in views]
    for look in looks:
        pictures = (at(paths.view, look=look, view=f"{number:02d}") for number in range(len(views)))
        yield f"views/{look}", [picture.read_bytes() for picture in pictures]


def body_fields(paths: Paths, object_id: str, solidity: str, materials) -> Pairs:
    """Yield what belongs to one body: tetrahedra, basis, modes and sounds."""

    def at(pattern: str, **more) -> Path:
        return Path(paths.at(pattern, object=object_id, solidity=solidity, **more))

    if solidity == "hollow":
        yield "hollow/cavity", _text(products.read_json(at(paths.hollow_record)))
        yield from _surface("hollow/boundary", at(paths.hollow_surface))
    tets = products.read_json(at(paths.tets_record))
    mesh = meshio.read(at(paths.tets))
    yield f"{solidity}/tets/record", _text(tets)
    yield f"{solidity}/tets/points", mesh.points
    yield f"{solidity}/tets/cells", mesh.cells_dict["tetra"]

    with h5py.File(at(paths.basis)) as basis:
        yield f"{solidity}/basis/lambda", basis["reduced/lambda"][()]
        yield f"{solidity}/basis/mu", basis["reduced/mu"][()]
        yield f"{solidity}/basis/surface", basis["surface/basis"][()]
        yield f"{solidity}/basis@order", basis.attrs["order"]
        yield f"{solidity}/basis@poisson_nodes", basis.attrs["poisson_nodes"]

    with h5py.File(at(paths.modes)) as modes:
        volume_m3 = tets["volume"] * modes.attrs["scale_m"] ** 3
        yield f"{solidity}@size_m", modes.attrs["size_m"]
        yield f"{solidity}@scale_m", modes.attrs["scale_m"]
        yield f"{solidity}@volume_m3", volume_m3
        yield f"{solidity}/surface/vertices", modes["surface/vertices"][()]
        yield f"{solidity}/surface/faces", modes["surface/faces"][()]
        for name in materials:
            material, place = modes["materials"][name], f"{solidity}/materials/{name}"
            for key in ("density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s"):
                yield f"{place}@{key}", material.attrs[key]
            yield f"{place}@mass_kg", material.attrs["density_kg_m3"] * volume_m3
            for key in (
                "frequencies_hz",
                "damping_per_s",
                "damped_frequencies_hz",
                "relative_error",
                "mode_shapes",
            ):
                yield f"{place}/{key}", material[key][()]

    audio = products.read_json(at(paths.audio_record))
    yield f"{solidity}/audio", _text(audio)
    for name, facts in audio["sounds"].items():
        if split_sound(name, materials)[0] is None:
            continue
        # 24-bit samples are exact in float32; soundfile divides them by 2^23.
        samples, sample_rate_hz = soundfile.read(at(paths.sound, material=name), dtype="float32")
        yield f"{solidity}/sounds/{name}", samples
        yield f"{solidity}/sounds/{name}@sample_rate_hz", sample_rate_hz
        yield f"{solidity}/sounds/{name}@duration_s", len(samples) / sample_rate_hz
        yield f"{solidity}/sounds/{name}@gain", facts["gain"]


def stage_products(paths: Paths, object_id: str, solidities) -> list[Path]:
    """Return one product per stage that worked on the object and on these bodies: those that state their provenance."""
    found = [paths.at(getattr(paths, name), object=object_id) for name in OBJECT_CHAIN]
    for solidity in solidities:
        found += [
            paths.at(getattr(paths, name), object=object_id, solidity=solidity) for name in body_chain(solidity)
        ]
    return [Path(path) for path in found]


def provenance_of(path: Path) -> dict:
    """Return the provenance a product states: a JSON record's, or an HDF5 file's."""
    if path.suffix == ".json":
        return products.read_json(path)["provenance"]
    with h5py.File(path) as file:
        return json.loads(file.attrs["provenance"])


def _surface(place: str, path: Path) -> Pairs:
    mesh = read_mesh(path)
    yield f"{place}/vertices", mesh.vertices
    yield f"{place}/faces", mesh.faces


def _text(record: dict) -> str:
    return json.dumps(record, ensure_ascii=False)

