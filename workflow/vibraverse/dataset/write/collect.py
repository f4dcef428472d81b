"""One object's products as fields of the dataset.

Fields are pairs of a filled-in path of :mod:`vibraverse.dataset.schema` and its value. A product is read whole and
closed before its first value is yielded, so a shard needs only the memory of its largest product. The order matters:
HDF5 crashes when it closes one file after another could not be written.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import soundfile

from vibraverse.config.media import split_sound
from vibraverse.contract import products
from vibraverse.dataset.split.copies import scale_free_spectrum
from vibraverse.files.basis import read_basis
from vibraverse.files.meshes import read_mesh, read_ply
from vibraverse.files.tets import read_tets
from vibraverse.flow.paths import Paths
from vibraverse.geometry.moments import scale_free_moments
from vibraverse.physics.materials import sampled_number

Pairs = Iterator[tuple[str, Any]]


def object_fields(paths: Paths, object_id: str, looks) -> Pairs:
    """Yield the fields of the object itself: records, surface, grids and pictures."""

    def at(pattern: str, **more) -> Path:
        return Path(paths.at(pattern, object=object_id, **more))

    source = products.read_json(at(paths.source_record))
    for key in ("origin", "title", "category", "licence", "attribution"):
        yield f"@{key}", source.get(key) or ""
    yield "source", _text(source)
    yield "clean", _text(products.read_json(at(paths.clean_record)))
    surface = dict(_surface("surface", at(paths.surface)))
    yield from surface.items()
    yield "shape/moments", scale_free_moments(*surface.values())
    yield from _surface("coarse", at(paths.coarse))
    with h5py.File(at(paths.grids)) as grids:
        arrays = [(f"grids/{name}", grids[name][()]) for name in ("occupancy", "signed_distance")]
    yield from arrays

    views = products.read_json(at(paths.images_record))["views"]
    for angle in ("azimuth_deg", "elevation_deg"):
        yield f"cameras/{angle}", [view[angle] for view in views]
    for look in looks:
        pictures = (at(paths.view, look=look, view=f"{number:02d}") for number in range(len(views)))
        yield f"views/{look}", [picture.read_bytes() for picture in pictures]


def body_fields(paths: Paths, object_id: str, solidity: str, materials) -> Pairs:
    """Yield the fields of one body: tetrahedra, basis, modes and sounds."""

    def at(pattern: str, **more) -> Path:
        return Path(paths.at(pattern, object=object_id, solidity=solidity, **more))

    if solidity == "hollow":
        yield "hollow/cavity", _text(products.read_json(at(paths.hollow_record)))
        yield from _surface("hollow/boundary", at(paths.hollow_surface))
    points, cells = read_tets(at(paths.tets))
    yield f"{solidity}/tets/record", _text(products.read_json(at(paths.tets_record)))
    yield f"{solidity}/tets/points", points
    yield f"{solidity}/tets/cells", cells

    with h5py.File(at(paths.basis)) as basis:
        found = list(_everything(basis, f"{solidity}/basis"))
        if solidity == "solid":
            found.append(("shape/spectrum", scale_free_spectrum(read_basis(basis, surface=False))))
    yield from found
    with h5py.File(at(paths.modes)) as modes:
        found = list(_modes(modes, solidity, materials))
    yield from found

    audio = products.read_json(at(paths.audio_record))
    yield f"{solidity}/audio", _text(audio)
    for name, facts in audio["sounds"].items():
        if split_sound(name, materials)[0] is None and sampled_number(name) is None:
            continue
        # 24-bit samples are exact in float32; soundfile divides them by 2^23.
        with open(at(paths.sound, material=name), "rb") as wav:
            samples, sample_rate_hz = soundfile.read(wav, dtype="float32")
        yield f"{solidity}/sounds/{name}", samples
        yield f"{solidity}/sounds/{name}@sample_rate_hz", sample_rate_hz
        yield f"{solidity}/sounds/{name}@duration_s", len(samples) / sample_rate_hz
        yield f"{solidity}/sounds/{name}@gain", facts["gain"]


def _surface(place: str, path: Path) -> Pairs:
    if path.suffix == ".ply":
        vertices, faces = read_ply(path)
    else:
        mesh = read_mesh(path)
        vertices, faces = mesh.vertices, mesh.faces
    yield f"{place}/vertices", vertices
    yield f"{place}/faces", faces


def _modes(modes, solidity: str, materials) -> Pairs:
    for key in ("size_m", "size_origin", "scale_m", "volume_m3"):
        yield f"{solidity}@{key}", modes.attrs[key]
    for name in materials:
        material, place = modes["materials"][name], f"{solidity}/materials/{name}"
        yield from ((f"{place}@{key}", value) for key, value in material.attrs.items())
        yield from ((f"{place}/{key}", array[()]) for key, array in material.items())
    for key, array in modes["sampled"].items() if "sampled" in modes else ():
        yield f"{solidity}/sampled/{key}", array[()]


def _everything(h5, place: str) -> Pairs:
    """Yield all attributes and arrays of an HDF5 product except its provenance, in the same layout."""
    found: list[str] = []
    h5.visit(found.append)
    yield from ((f"{place}@{key}", value) for key, value in h5.attrs.items() if key != "provenance")
    yield from ((f"{place}/{name}", h5[name][()]) for name in found if isinstance(h5[name], h5py.Dataset))


def _text(record: dict) -> str:
    return json.dumps(record, ensure_ascii=False)
