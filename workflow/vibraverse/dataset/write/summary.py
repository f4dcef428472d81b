"""The summary of a dataset in numbers: the content of ``dataset.json``."""

from __future__ import annotations

from collections import Counter

import numpy as np

from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.write.making import join
from vibraverse.geometry.cleaning.cautions import cautions as of_surface
from vibraverse.geometry.meshing.cautions import of_wrap
from vibraverse.physics.cautions import cautions as of_modes
from vibraverse.physics.materials import PARAMETERS, sampled_number

#: Kinds of warnings, and the sentence that a summary shows for each.
WARNINGS = {
    "changed_shape": "the surface differs from the mesh it was made of",
    "many_elements": "far more elements than asked for",
    "inaccurate_modes": "frequencies are less accurate than elsewhere",
}
_RANGES = ("size_m", "volume_m3", "mass_kg", "tetrahedra", "f1_hz", "f_last_hz", "duration_s")


def summary(reader: Reader, asked: dict[str, float]) -> dict:
    """Return counts, materials, ranges and how everything was made, for all objects of ``reader``.

    An object counts as refused if nothing of it is left. ``asked`` are the shares of the splits; a split without
    objects is listed with 0.
    """
    items, refusals = reader.items, reader.refusals
    firsts = items.firsts("object", "solidity")
    bodies = _bodies(reader)
    sounds = [name for object_id, solidity in bodies for name in reader.group(object_id)[solidity]["sounds"]]
    kept = set(reader.objects)
    gone = {row["object"] for row in refusals} - kept
    of_objects = items.firsts("object")
    splits, origins, licences, categories = (
        Counter(items.column(column)[of_objects].tolist())
        for column in ("split", "origin", "licence", "category")
    )
    splits.update({name: 0 for name, share in asked.items() if share > 0})
    return {
        "counts": {
            "objects": len(kept),
            "refused_objects": len(gone),
            "bodies": len(bodies),
            "refused_bodies": sum(1 for row in refusals if row["solidity"] and row["object"] in kept),
            "sounds": len(sounds),
            "sampled_sounds": sum(sampled_number(name) is not None for name in sounds),
            "items": len(items),
            "sampled": int(items.column("sampled")[firsts].sum()),
        },
        "objects_by_split": dict(sorted(splits.items())),
        "objects_by_origin": dict(sorted(origins.items())),
        "objects_by_licence": dict(sorted(licences.items())),
        "objects_by_category": dict(sorted(categories.items())),
        "refusals_by_reason": dict(sorted(Counter(row["reason"] for row in refusals).items())),
        "warnings_by_kind": dict(sorted(Counter(row["kind"] for row in warnings(reader)).items())),
        "materials": _materials(reader),
        "ranges": {name: _range(items.column(name)) for name in _RANGES if len(items)},
        "made_by": join(reader.making()),
    }


def warnings(reader: Reader) -> list[dict[str, str]]:
    """Return the warnings: ``object``, ``solidity`` ("" for both bodies), ``kind`` and ``message``."""
    found = []
    for object_id in reader.objects:
        found += [
            {"object": object_id, "solidity": "", "kind": "changed_shape", "message": message}
            for message in of_surface(reader.read("clean", object_id))
        ]
    for object_id, solidity in _bodies(reader):
        materials = reader.group(object_id)[solidity]["materials"].values()
        tets = reader.read("tets", object_id, solidity)
        said = {
            "changed_shape": of_wrap(tets["quality"]),
            "many_elements": tets["warnings"],
            "inaccurate_modes": of_modes(material["discretisation_error"][()] for material in materials),
        }
        found += [
            {"object": object_id, "solidity": solidity, "kind": kind, "message": message}
            for kind, messages in said.items()
            for message in messages
        ]
    return found


def _bodies(reader: Reader) -> list[tuple[str, str]]:
    """Return object and solidity of every body, in the order of the items."""
    firsts = reader.items.firsts("object", "solidity")
    columns = (reader.items.column(name)[firsts].tolist() for name in ("object", "solidity"))
    return list(zip(*columns, strict=True))


def _materials(reader: Reader) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for position in reader.items.firsts("material").tolist():
        place = reader.items.place(position)
        found[place["material"]] = {key: float(reader.read(key, **place)) for key in PARAMETERS}
    return found


def _range(values: np.ndarray) -> dict:
    return {"min": values.min().item(), "max": values.max().item()}
