"""Stage ``audio``: frequencies and damping of every material in, impact sounds out."""

from __future__ import annotations

from vibraverse.config.media import split_sound
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write a sound per material and struck point; the file's stem names both."""
    import h5py

    from vibraverse.contract.errors import UsageError
    from vibraverse.files.modes import read_mode_shapes, read_spectrum
    from vibraverse.media import audio
    from vibraverse.physics.impulse import impact_sound
    from vibraverse.physics.materials import sampled_name

    options = job.options
    record = {}
    with h5py.File(job.inputs["modes"]) as modes:
        sampled = len(modes["sampled/poisson"]) if "sampled" in modes else 0
        materials = [*modes["materials"], *map(sampled_name, range(sampled))]
        strikes = _strikes(job)
        if options.sampled > sampled:
            raise UsageError(
                f"audio.sampled is {options.sampled}, but the modes hold {sampled} sampled materials; lower it, "
                "or raise sampled.count"
            )
        for name in options.names(modes["materials"]):
            material, point = split_sound(name, materials)
            struck, weights = None, None
            if point is not None:
                struck, moving = strikes[point]
                weights = struck.weights(read_mode_shapes(modes, moving, material, struck.corners))
            sound = impact_sound(
                *read_spectrum(modes, material),
                options.sample_rate_hz,
                options.decay_db,
                options.max_s,
                weights,
                options.contact_s,
                options.observable,
            )
            wav, levels = audio.wav_bytes(sound.samples, sound.sample_rate_hz, options.subtype)
            (job.outputs["sounds"] / f"{name}.wav").write_bytes(wav)
            record[name] = {
                "material": material,
                "struck_at": None if struck is None else struck.position,
                "struck_along": None if struck is None else struck.normal,
                **levels,
                "duration_s": sound.duration_s,
                "decayed": sound.decayed,
                "modes_rendered": sound.modes_rendered,
                "modes_above_nyquist": sound.modes_above_nyquist,
                "modes_overdamped": sound.modes_overdamped,
            }
            if not sound.modes_rendered:
                print(f"{name} is silent: no mode rings below {sound.sample_rate_hz / 2:g} Hz.")
    job.write_record(
        {
            "object": job.object,
            "solidity": job.solidity,
            "sample_rate_hz": options.sample_rate_hz,
            "contact_s": options.contact_s,
            "observable": options.observable,
            "unit": audio.UNITS[options.observable],
            "sounds": record,
        }
    )


def _strikes(job: Job) -> list[tuple]:
    """Return every struck point with the basis vectors of the surface around it."""
    import h5py

    from vibraverse.contract.errors import UsageError
    from vibraverse.contract.products import read_provenance, sha256
    from vibraverse.files.modes import read_surface
    from vibraverse.physics.impulse import contact

    if not job.options.points:
        return []
    if "basis" not in job.inputs:
        raise UsageError("audio: struck points need the surface in the basis; name it with --basis basis.h5")
    right = read_provenance(job.inputs["modes"]).get("input_sha256", {}).get("basis")
    if right not in (None, sha256(job.inputs["basis"])):
        raise UsageError(
            f"audio: {job.inputs['basis']} is not the basis that {job.inputs['modes']} was made from; "
            "name that one with --basis"
        )
    with h5py.File(job.inputs["basis"]) as basis:
        surface = basis["surface/vertices"][()], basis["surface/faces"][()]
        struck = [contact(*surface, point) for point in job.options.points]
        return [(each, read_surface(basis, each.corners)) for each in struck]
