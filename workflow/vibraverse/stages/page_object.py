"""Stage ``page_object``: the records, pictures and modes of an object in, what the page shows of it out.

A refused object has a file too, which says why. So the stage reads refusals itself.
"""

from __future__ import annotations

from pathlib import Path

from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write the script, the pictures, and the record with the object's row of the index."""
    import hashlib
    import json

    from vibraverse.contract import products
    from vibraverse.report.objects import facts, index_row
    from vibraverse.report.packing import call

    source = _record(job.inputs["source_record"]) or {"object": job.object, "origin": "unknown"}
    clean = _record(job.inputs["clean_record"])
    frames = _write_pictures(job)
    data = {
        "facts": facts(source),
        "turn": f"{job.object}.webp" if frames else None,
        "turn_frames": frames,
        "mesh": _mesh(job.object, source, clean),
        **_bodies(job, clean),
    }
    script = call("vibraverse.object", job.object, data)
    job.outputs["script"].write_text(script, encoding="ascii")
    shown = [script.encode(), job.outputs["turn"].read_bytes()]
    shown += [products.sha256(path).encode() for path in job.inputs["page_body_record"]]
    version = hashlib.sha256(b"\0".join(shown)).hexdigest()[:8]
    row = index_row(job.object, data, version)
    warnings = [
        {"solidity": solidity, **one}
        for solidity, body in data["bodies"].items()
        for one in body.get("warnings", ())
    ]
    job.write_record({"object": job.object, "bytes": len(script), "row": row, "warnings": warnings})
    print(f"{len(script) / 1000:.1f} kB, {len(json.dumps(row))} bytes of the index")


def prepare() -> None:
    """Load the readers and writers of pictures."""
    from PIL import Image

    Image.preinit()


def _record(path: Path) -> dict | None:
    """Return the content of a JSON record; None where a refusal stands in its place."""
    from vibraverse.contract.products import read_json

    return None if read_refusal(path) else read_json(path)


def _mesh(object_id: str, source: dict, clean: dict | None) -> dict:
    """Return the file that ``vibraverse strike`` reads: the user's own, else the cleaned surface; and where it lies."""
    if source["origin"] == "files" and clean:
        return {"file": source["file"], "centre": clean["centre"], "scale": clean["scale"]}
    return {"file": f"objects/{object_id}/surface.ply", "centre": [0.0, 0.0, 0.0], "scale": 1.0}


def _write_pictures(job: Job) -> int:
    """Write the turn and the thumbnail; return the number of frames, 0 for an object without pictures."""
    from vibraverse.report.turn import blank, thumbnail, turn

    record = _record(job.inputs["views"])
    if not record or not record["looks"]:
        job.outputs["turn"].write_bytes(blank())
        job.outputs["thumbnail"].write_bytes(blank())
        return 0
    look = "clay" if "clay" in record["looks"] else record["looks"][0]
    folder = job.inputs["views"].parent
    views = [(folder / f"{look}-{number:02d}.png").read_bytes() for number in range(len(record["views"]))]
    sprite, frames = turn(views)
    job.outputs["turn"].write_bytes(sprite)
    job.outputs["thumbnail"].write_bytes(thumbnail(views[0]))
    return frames


def _bodies(job: Job, clean: dict | None) -> dict:
    """Return the part of the script about materials, bodies and refusals."""
    from vibraverse.config.media import Audio
    from vibraverse.contract import products
    from vibraverse.contract.errors import UsageError
    from vibraverse.geometry.cleaning.cautions import cautions
    from vibraverse.geometry.meshing.cautions import of_wrap
    from vibraverse.report.objects import audio_data

    found: dict = {
        "size_m": None,
        "scale_m": None,
        "materials": {},
        "bodies": {},
        "refused": {},
        "audio": None,
    }
    several = [job.inputs[name] for name in ("modes", "tets_record", "sounds", "page_body_record")]
    bases = job.inputs.get("basis") or [None] * len(several[0])
    if len({len(paths) for paths in (*several, bases)}) > 1:
        raise UsageError("page_object: name the files of the same bodies in the same order")
    changed = [{"kind": "changed_shape", "text": text} for text in cautions(clean)] if clean else []
    for modes, tets, sounds, page_body, basis in zip(*several, bases, strict=True):
        solidity = modes.parent.name
        if refusal := next(filter(None, map(read_refusal, (modes, sounds, page_body))), None):
            found["refused"][solidity] = _refused(refusal)
            continue
        audio = products.read_json(sounds)
        about, body = _body(job, modes, basis, audio)
        record, meshed = products.read_json(page_body), products.read_json(tets)
        warnings = [
            *changed,
            *({"kind": "changed_shape", "text": text} for text in of_wrap(meshed["quality"])),
            *({"kind": "many_elements", "text": text} for text in meshed["warnings"]),
        ]
        warnings += body.pop("warnings")
        options = Audio.model_validate(audio["provenance"]["options"])
        found.update(about, audio=audio_data(options.model_dump()))
        found["bodies"][solidity] = {
            **body,
            "tetrahedra": meshed["tetrahedra"],
            "elements": meshed["quality"]["wanted"],
            "order": record["order"],
            "measured": record["measured"],
            "version": record["provenance"]["output_sha256"]["script"][:8],
            **({"warnings": warnings} if warnings else {}),
        }
    if "hollow" in found["bodies"] and "hollow_record" in job.inputs:
        found["bodies"]["hollow"]["wall"] = products.read_json(job.inputs["hollow_record"])["t"]
    return found


def _body(job: Job, path: Path, basis: Path | None, audio: dict) -> tuple[dict, dict]:
    """Return what modes.h5 says of the object, and of the body."""
    import h5py

    from vibraverse.physics.cautions import cautions
    from vibraverse.report.objects import materials_data, modes_data

    with h5py.File(path) as h5:
        groups = h5["materials"]
        errors = {name: group["discretisation_error"][()] for name, group in groups.items()}
        about = {
            "size_m": float(h5.attrs["size_m"]),
            "scale_m": float(h5.attrs["scale_m"]),
            "materials": materials_data({name: group.attrs for name, group in groups.items()}),
        }
        body = {
            "volume_m3": float(h5.attrs["volume_m3"]),
            "modes": {
                name: modes_data(group["frequencies_hz"][()], errors[name], group.attrs["mass_kg"])
                for name, group in groups.items()
            },
            "strikes": _strikes(h5, basis, audio),
            "warnings": [{"kind": "inaccurate_modes", "text": text} for text in cautions(errors.values())],
        }
    return about, body


def _strikes(modes, basis: Path | None, audio: dict) -> dict:
    """Return the stored strikes by material, as the stage ``audio`` renders them."""
    import h5py

    from vibraverse.contract.errors import UsageError
    from vibraverse.files.modes import read_mode_shapes, read_surface
    from vibraverse.physics.impulse import contact
    from vibraverse.report.objects import strike_data

    points = audio["provenance"]["options"].get("points", ())
    found: dict = {name: [] for name in modes["materials"]}
    if not points:
        return found
    if basis is None:
        raise UsageError(
            "page_object: struck points need the surface in the basis; name it with --basis basis.h5"
        )
    with h5py.File(basis) as h5:
        surface = h5["surface/vertices"][()], h5["surface/faces"][()]
        struck = [contact(*surface, point) for point in points]
        moving = [read_surface(h5, one.corners) for one in struck]
    for name, strikes in found.items():
        for number, (one, around) in enumerate(zip(struck, moving, strict=True)):
            weights = one.weights(read_mode_shapes(modes, around, name, one.corners))
            strikes.append(strike_data(number, one.position, one.normal, weights))
    return found


def _refused(refusal: Refusal) -> dict:
    return {
        "stage": refusal.stage,
        "reason": refusal.reason,
        "message": refusal.message,
        "advice": refusal.advice,
    }
