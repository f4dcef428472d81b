"""A page of invented objects, as many as a test asks for, without the stages that really make them.

Every tenth object is refused, or as many as asked for; every ninth lacks a hollow body; every seventh has a warning.
"""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from vibraverse.config.dataset import ReportOptions
from vibraverse.contract.seeds import rng
from vibraverse.physics.materials import MATERIALS
from vibraverse.report import assembly
from vibraverse.report.facts import PARAMETERS, facts, times
from vibraverse.report.index import index, pictured
from vibraverse.report.packing import call
from vibraverse.stages.report import write_assets

NAMES = ("ceramic", "glass", "steel", "wood")
FAMILIES = ("bowl", "bell", "bar", "plate", "vase", "star", "fork", "ring", "cup", "shell", "knot", "gear")
STAGES = ("sources", "clean", "grids", "hollow", "tets", "basis", "modes", "audio", "images")
ADVICE = "Use a closed mesh with a thicker wall."


def invented(count: int, refused: int | None = None) -> dict:
    """Return the arguments of :func:`vibraverse.report.index.index` for ``count`` objects."""
    refused = count // 10 if refused is None else refused
    items, refusals, seen = [], [], {}
    random = rng("invented page")
    gone = set(random.permutation(count)[:refused].tolist())
    for number in range(count):
        family = FAMILIES[number % len(FAMILIES)]
        object_id = f"{family}-{number // len(FAMILIES):04d}"
        row = {"title": f"A {family} {number}", "family": family, "source": "generated", "bodies": {}}
        seen[object_id] = {"row": {**row, "version": f"{number:08x}"}, "warnings": []}
        if number in gone:
            stage, reason = (("clean", "not_a_solid"), ("tets", "meshing_failed"), ("hollow", "too_thin"))[
                number % 3
            ]
            message = (
                f"{object_id}.obj is flat: it bounds no volume, or a wall of its is too thin for elements."
            )
            refusals.append(refusal(object_id, "", stage, reason, message))
            continue
        size = float(np.exp(random.uniform(np.log(0.02), np.log(1.2))))
        for solidity in ("solid", "hollow"):
            if solidity == "hollow" and number % 9 == 0:
                refusals.append(
                    refusal(
                        object_id, "hollow", "hollow", "too_thin", f"The wall of {object_id} is too thin."
                    )
                )
                continue
            error = float(random.gamma(2.0, 0.003))
            volume = size**3 * float(random.uniform(0.02, 0.5)) * (0.6 if solidity == "hollow" else 1)
            row["bodies"][solidity] = {"worst_error": error}
            if error > 0.02 or number % 7 == 0:
                text = f"the estimated frequency error by the elements reaches {100 * error:.1f} % in mode 7"
                warning = {"solidity": solidity, "kind": "inaccurate_modes", "text": text}
                seen[object_id]["warnings"].append(warning)
            pitch = float(random.uniform(0.1, 1.2)) / size
            items += [item(object_id, family, solidity, name, size, volume, pitch, number) for name in NAMES]
    return {"items": items, "refusals": refusals, "seen": seen, "materials": NAMES}


def costs(objects) -> dict[str, dict[str, float]]:
    """Return CPU seconds by object and stage."""
    random = rng("invented times")
    scales = (0.1, 1, 4, 6, 9, 30, 3, 2, 5)
    return {name: dict(zip(STAGES, random.gamma(2.0, scales).tolist(), strict=True)) for name in objects}


def item(object_id, family, solidity, material, size, volume, pitch, number) -> dict:
    """Return a row of the index of a dataset."""
    speed = np.sqrt(MATERIALS[material]["young_pa"] / MATERIALS[material]["density_kg_m3"])
    return {
        "object": object_id, "solidity": solidity, "material": material, "origin": "generated", "category": family,
        "title": f"A {family} {number}", "licence": "CC0-1.0", "size_m": size, "volume_m3": volume, "modes": 64,
        "split": ("train", "train", "train", "validation", "test")[number % 5],
        "f1_hz": pitch * speed * 0.2, "f_last_hz": pitch * speed * 1.6,
    }  # fmt: skip


def refusal(object_id: str, solidity: str, stage: str, reason: str, message: str) -> dict:
    """Return a row of the refusals of a dataset."""
    return {
        "object": object_id, "solidity": solidity, "stage": stage, "reason": reason, "message": message,
        "advice": ADVICE,
    }  # fmt: skip


def record(given: dict) -> dict:
    """Return what ``dataset.json`` says of the invented objects."""
    kept = {one["object"]: one["split"] for one in given["items"]}
    whole = [one for one in given["refusals"] if not one["solidity"]]
    splits = list(kept.values())
    bodies = len({(one["object"], one["solidity"]) for one in given["items"]})
    libraries = {"numpy": np.__version__, "scipy": "1.16"}
    return {
        "counts": {
            "objects": len(kept),
            "bodies": bodies,
            "sounds": bodies * len(NAMES),
            "sampled_sounds": 0,
            "refused_objects": len(whole),
            "refused_bodies": len(given["refusals"]) - len(whole),
        },
        "objects_by_split": {name: splits.count(name) for name in ("train", "validation", "test")},
        "objects_by_licence": {"CC0-1.0": len(kept)},
        "materials": {
            name: {key: MATERIALS[name][key] for key in PARAMETERS.values()} for name in given["materials"]
        },
        "shards": {f"{number:05d}.h5": {"bytes": 12_345_678, "sha256": f"{number:064x}"} for number in range(4)},
        "made_by": {
            name: {"stage_version": 1, "options": {"seed": "by id", "limit": {"max_s": 60}}, "libraries": libraries}
            for name in STAGES
        },
    }  # fmt: skip


def validation() -> dict:
    """Return a record of a validation of four bodies, one of them with a missed tolerance."""
    unknowns = [600, 2_400, 9_800, 40_000]

    def curve(power: float, start: float) -> dict:
        return {
            "unknowns": unknowns,
            "errors": [start * (n / 600) ** power for n in unknowns],
            "slope": power,
        }

    kinds = {"P1": curve(-0.66, 0.3), "P2": curve(-1.3, 0.02), "P2 corrected": curve(-1.5, 0.01)}
    line = {"elements": "P2", "source": "exact", "unknowns": 40_000, "frequencies": 20, "tolerance": 0.002}
    titles = {"ball": "Ball", "block": "Block", "tube": "Thin tube", "plate": "Plate"}
    return {
        "missed": ["plate, mode 3: 102.00 Hz instead of 100.00 Hz is off by 2 %, and 0.2 % is accepted (exact)."],
        "bodies": {
            name: {
                "title": title,
                "convergence": kinds,
                "summary": [{**line, "largest_error": 0.0004, "missed": name == "plate"}],
            }
            for name, title in titles.items()
        },
    }  # fmt: skip


def thumb(object_id: str) -> bytes:
    """Return the thumbnail (WebP) of an object: one of some blobs."""
    return _blob(len(object_id) + sum(map(ord, object_id)) % 20)


@cache
def _blob(number: int) -> bytes:
    random = rng(str(number), "blob")
    axis = np.linspace(-1, 1, 96)
    x, y = np.meshgrid(axis, axis)
    inside = (np.abs(x) ** random.uniform(1, 6) + np.abs(y) ** random.uniform(1, 6) < 0.6)[..., None]
    light = np.clip(0.6 - 0.3 * x - 0.3 * y, 0.2, 1)[..., None]
    pixels = np.where(inside, light * random.uniform(120, 230, 3), 240).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="WEBP", quality=80)
    return file.getvalue()


def write(folder: Path, given: dict, scripts: str = "", validated: dict | None = None, **options) -> Path:
    """Write the page of what :func:`invented` returns, with more scripts before the last one; return its path."""
    chosen = ReportOptions(**{"title": "Things that ring", **options})
    found = index(**given)
    said = facts(record(given), chosen)
    data = {**said, **found, "validation": validated, "learning": ""}
    files = assembly.files(data, map(thumb, pictured(found)))
    if scripts:
        files["main.js"] = scripts.encode() + files["main.js"]
    place = f"page/{write_assets(folder / 'page', files)}"
    (folder / "data").mkdir(exist_ok=True)
    spent = times({} if chosen.kind == "dataset" else costs(given["seen"]))
    (folder / "data/times.js").write_text(call("vibraverse.times", spent), encoding="ascii")
    page = folder / "index.html"
    page.write_text(assembly.html(chosen.title, chosen.kind, place, files), encoding="utf-8")
    return page
