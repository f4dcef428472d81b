"""Stage ``sources``: one object's mesh, unchanged, with its origin and licence."""

from __future__ import annotations

import shutil
from pathlib import Path

from vibraverse.contract.errors import Refused
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Fetch or generate the mesh; ``clean``, not this stage, refuses a mesh that cannot be parsed."""
    record = _ORIGINS[job.options.origin](job)
    job.write_record({"object": job.object, "origin": job.options.origin, **record})


def _generated(job: Job) -> dict:
    from vibraverse.files.meshes import write_ply
    from vibraverse.sources.families import generate

    made = generate(job.object)
    write_ply(job.outputs["mesh"], made.vertices, made.faces)
    return {
        "format": "ply",
        "file": f"{job.object}.ply",
        "title": made.title,
        "category": made.category,
        "licence": "CC0-1.0",
        "attribution": None,
        "size_m": made.size_m,
        "size_origin": "generated",
        "unit_m": 1.0,
        "family": made.family,
        "parameters": made.parameters,
    }


def _bundled(job: Job) -> dict:
    from vibraverse.sources.bundled import BUNDLED, locate

    about = BUNDLED.get(job.object)
    if about is None:
        raise Refused(
            "unavailable",
            f"The bundled mesh {job.object} does not exist.",
            f"Choose one of {', '.join(BUNDLED)}.",
        )
    shutil.copyfile(locate(job.object), job.outputs["mesh"])
    return {
        "format": "ply",
        "file": about.file,
        "title": about.title,
        "category": about.category,
        "licence": about.licence,
        "attribution": about.attribution,
        "size_m": about.size_m,
        "size_origin": "bundled",
        "unit_m": None,
        "parameters": None,
    }


def _files(job: Job) -> dict:
    from vibraverse.files.opening import as_one_file

    path: Path | None = job.inputs.get("file")
    if path is None:
        raise Refused("unavailable", "No mesh file is given.", "Name it with --file.")
    format, unit_m = as_one_file(path, job.outputs["mesh"])
    return {
        "format": format,
        "file": path.name,
        "title": path.stem,
        "category": job.options.category,
        "licence": job.options.licence,
        "attribution": None,
        "size_m": None,
        "size_origin": None if unit_m is None else "file",
        "unit_m": unit_m,
        "parameters": None,
    }


def _objaverse(job: Job) -> dict:
    from vibraverse.sources.objaverse import fetch

    if not job.options.uid:
        raise Refused("unavailable", "No Objaverse UID is given.", "Name it in --options, as uid.")
    model = fetch(job.options.uid, job.options.cache)
    shutil.copyfile(model.path, job.outputs["mesh"])
    return {
        "format": "glb",
        "file": model.path.name,
        "title": model.title,
        "category": model.category,
        "licence": model.licence,
        "attribution": model.attribution,
        "size_m": None,
        "size_origin": None,
        "unit_m": None,  # uploads come in any scale, whatever the format says
        "parameters": None,
    }


_ORIGINS = {"generated": _generated, "bundled": _bundled, "files": _files, "objaverse": _objaverse}


def prepare() -> None:
    """Import the modules of all shape families."""
    import importlib

    from vibraverse.sources.families import FAMILIES

    for module in {family.module for family in FAMILIES.values()}:
        importlib.import_module(module)
