"""What a dataset holds, in numbers: the content of ``dataset.json``."""

from __future__ import annotations

from collections import Counter

from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.write.making import join
from vibraverse.geometry.cleaning.cautions import cautions as of_surface
from vibraverse.physics.cautions import cautions as of_modes
from vibraverse.physics.materials import PARAMETERS, sampled_number

#: Kinds of warnings and the sentence a summary shows for each.
WARNINGS = {
    "changed_shape": "the surface differs from the mesh it was made of",
    "many_elements": "far more elements than asked for",
    "inaccurate_modes": "frequencies are less accurate than elsewhere",
}
_RANGES = ("size_m", "volume_m3", "mass_kg", "tetrahedra", "f1_hz", "f_last_hz", "duration_s")


def summary(reader: Reader, asked: dict[str, float]) -> dict:
    """Return counts, materials, ranges and how everything was made, of all that ``reader`` holds.

    An object counts as refused when nothing of it is left. ``asked`` are the shares of the splits: of one that should
    hold objects and holds none it is said that it holds 0.
    """
    items, refusals = reader.items, reader.refusals
    bodies = {(item["object"], item["solidity"]) for item in items}
    sounds = [name for object_id, solidity in bodies for name in reader.group(object_id)[solidity]["sounds"]]
    kept = set(reader.objects)
    gone = {row["object"] for row in refusals} - kept
    splits = Counter({item["object"]: item["split"] for item in items}.values())
    splits.update({name: 0 for name, share in asked.items() if share > 0})
    origins, licences, categories = (
        Counter({item["object"]: item[column] for item in items}.values())
        for column in ("origin", "licence", "category")
    )
    return {
        "counts": {
            "objects": len(kept),
            "refused_objects": len(gone),
            "bodies": len(bodies),
            "refused_bodies": sum(1 for row in refusals if row["solidity"] and row["object"] in kept),
            "sounds": len(sounds),
            "sampled_sounds": sum(sampled_number(name) is not None for name in sounds),
            "items": len(items),
            "sampled": sum({(item["object"], item["solidity"]): item["sampled"] for item in items}.values()),
        },
        "objects_by_split": dict(sorted(splits.items())),
        "objects_by_origin": dict(sorted(origins.items())),
        "objects_by_licence": dict(sorted(licences.items())),
        "objects_by_category": dict(sorted(categories.items())),
        "refusals_by_reason": dict(sorted(Counter(row["reason"] for row in refusals).items())),
        "warnings_by_kind": dict(sorted(Counter(row["kind"] for row in warnings(reader)).items())),
        "materials": _materials(reader),
        "ranges": {name: _range([item[name] for item in items]) for name in _RANGES if items},
        "made_by": join(reader.making()),
    }


def warnings(reader: Reader) -> list[dict[str, str]]:
    """Return what there is to act on: ``object``, ``solidity`` ("" for both bodies), ``kind`` and ``message``."""
    found = []
    for object_id in reader.objects:
        found += [
            {"object": object_id, "solidity": "", "kind": "changed_shape", "message": message}
            for message in of_surface(reader.read("clean", object_id))
        ]
    for object_id, solidity in dict.fromkeys((item["object"], item["solidity"]) for item in reader.items):
        materials = reader.group(object_id)[solidity]["materials"].values()
        said = {
            "many_elements": reader.read("tets", object_id, solidity)["warnings"],
            "inaccurate_modes": of_modes(material["discretisation_error"][()] for material in materials),
        }
        found += [
            {"object": object_id, "solidity": solidity, "kind": kind, "message": message}
            for kind, messages in said.items()
            for message in messages
        ]
    return found


def _materials(reader: Reader) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for item in reader.items:
        if item["material"] not in found:
            place = {name: item[name] for name in ("object", "solidity", "material")}
            found[item["material"]] = {key: float(reader.read(key, **place)) for key in PARAMETERS}
    return found


def _range(values: list) -> dict:
    return {"min": min(values), "max": max(values)}
