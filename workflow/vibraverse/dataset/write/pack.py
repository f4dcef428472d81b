"""The writer of a shard: fields with the paths, types and units of the schema, and the same bytes every time.

Arrays are chunked and compressed with gzip after a byte shuffle. Pictures keep the bytes of their PNG files, and small
arrays are not compressed, because neither would get smaller.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from vibraverse.config.dataset import ShardOptions
from vibraverse.contract.products import read_provenance, sha256
from vibraverse.contract.refusal import Refusal
from vibraverse.contract.texts import storable
from vibraverse.dataset import schema
from vibraverse.dataset.schema.checksums import checksums
from vibraverse.dataset.schema.tables import to_tsv
from vibraverse.dataset.write import collect
from vibraverse.dataset.write.making import join, making_of
from vibraverse.flow.chain import refusals_of, stage_products
from vibraverse.flow.paths import Paths

#: Arrays of fewer bytes than this are not compressed.
_MIN_COMPRESSED_BYTES = 4096
#: Arrays of up to this many bytes are one chunk: samples are read whole, and a grid in one chunk is 40 % smaller.
_MAX_CHUNK_BYTES = 32 * 2**20
_GZIP_LEVEL = 4


class Packed(NamedTuple):
    """A shard's entries about one object: rows of the index and of the refusals, and how it was made."""

    rows: list[dict]
    refusals: list[dict]
    making: dict


def pack_object(groups, paths: Paths, object_id: str, options: ShardOptions, shard: str) -> Packed:
    """Write one object's group into the group ``groups`` of a shard; return the shard's entries about it.

    A refused object becomes a group that states the refusal, and so does a refused body. Raises
    :class:`FileNotFoundError` if a product does not exist.
    """
    group = groups.create_group(object_id)
    refusals = refusals_of(paths, object_id, options.solidities)
    _write_refusal(group, "", refusals.object)
    for solidity, refusal in refusals.bodies.items():
        _write_refusal(group, solidity, refusal)
    if refusals.object is not None:
        write_field(group, schema.CHECKSUMS, json.dumps(checksums(group)))
        return Packed([], refusals.rows(object_id), {})

    bodies = [solidity for solidity in options.solidities if solidity not in refusals.bodies]
    made = [Path(path) for path in stage_products(paths, object_id, bodies)]
    for path in made:
        path.stat()  # raises an error that names the file; HDF5's own does not
    write_fields(group, collect.object_fields(paths, object_id, options.looks))
    for solidity in bodies:
        write_fields(group, collect.body_fields(paths, object_id, solidity, options.materials))
    folder = paths.at(paths.object, object=object_id)
    write_field(
        group, "products", json.dumps({path.relative_to(folder).as_posix(): sha256(path) for path in made})
    )
    rows = [
        index_row(group, object_id, solidity, material, shard)
        for solidity in bodies
        for material in options.materials
    ]
    write_field(group, schema.CHECKSUMS, json.dumps(checksums(group)))
    making = join(making_of(read_provenance(path)) for path in made)
    return Packed(rows, refusals.rows(object_id), making)


def finish(h5, packed: list[Packed]) -> None:
    """Mark an open HDF5 file as a shard; write its index, its refusals and how it was made."""
    h5.attrs["format"] = schema.FORMAT
    h5.attrs["format_version"] = schema.FORMAT_VERSION
    rows = [row for one in packed for row in one.rows]
    refusals = [row for one in packed for row in one.refusals]
    h5.create_dataset(schema.INDEX, data=to_tsv(rows, schema.SHARD_COLUMNS))
    h5.create_dataset(schema.REFUSALS, data=to_tsv(refusals, schema.REFUSAL_COLUMNS))
    h5.create_dataset(schema.MAKING, data=json.dumps(join(one.making for one in packed), ensure_ascii=False))


def _write_refusal(group, place: str, refusal: Refusal | None) -> None:
    for name in ("reason", "stage", "message", "advice") if refusal else ():
        write_field(group, f"{place}@refusal_{name}", getattr(refusal, name))


def write_fields(group, pairs) -> None:
    """Write pairs of a filled-in path and a value into an object's group.

    Pairs are written one by one, so their source must hold no HDF5 file open when it yields one: HDF5 crashes when it
    closes a file after another could not be written. Raises :class:`KeyError` for a path that is not in the schema.
    """
    for path, value in pairs:
        write_field(group, path, value)


def write_field(group, path: str, value) -> None:
    """Write one field of an object: an attribute, a text, pictures or an array."""
    field = schema.field_at(path)
    if field.is_attribute:
        place, name = path.split("@")
        holder = group.require_group(place) if place and place not in group else group[place or "."]
        holder.attrs[name] = (
            storable(str(value)) if field.is_text else np.asarray(value, dtype=field.dtype)[()]
        )
        return
    if field.is_text:
        group.create_dataset(path, data=storable(value))
        return
    if field.dtype == "png":
        dataset = group.create_dataset(path, (len(value),), dtype=h5py.vlen_dtype(np.uint8))
        for number, picture in enumerate(value):
            dataset[number] = np.frombuffer(picture, dtype=np.uint8)
    else:
        array = np.asarray(value, dtype=field.dtype)
        compressed = array.nbytes >= _MIN_COMPRESSED_BYTES
        dataset = group.create_dataset(
            path,
            data=array,
            chunks=array.shape if compressed and array.nbytes <= _MAX_CHUNK_BYTES else None,
            compression="gzip" if compressed else None,
            compression_opts=_GZIP_LEVEL if compressed else None,
            shuffle=compressed,
        )
    dataset.attrs["unit"] = field.unit


def index_row(group, object_id: str, solidity: str, material: str, shard: str) -> dict:
    """Return the row of the index for one material of one body of an object's group, all but the split."""
    body = group[solidity]
    made_of = body["materials"][material]
    frequencies = made_of["frequencies_hz"]
    return {
        "object": object_id,
        "solidity": solidity,
        "material": material,
        "shard": shard,
        **{key: group.attrs[key] for key in ("origin", "category", "title", "licence")},
        **{key: body.attrs[key] for key in ("size_m", "size_origin", "volume_m3")},
        "mass_kg": made_of.attrs["mass_kg"],
        "tetrahedra": len(body["tets/cells"]),
        "modes": len(frequencies),
        "f1_hz": frequencies[0],
        "f_last_hz": frequencies[-1],
        "duration_s": body["sounds"][material].attrs["duration_s"],
        "sampled": len(body["sampled/poisson"]) if "sampled" in body else 0,
    }
