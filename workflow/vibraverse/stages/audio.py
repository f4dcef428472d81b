"""Impact sounds: frequencies and damping of every material become WAV files."""

from __future__ import annotations

from vibraverse.config.media import Audio, split_sound
from vibraverse.stage import Job, Stage


def run(job: Job) -> None:
    """Write one sound per output file; the file's stem says of which material, and struck where."""
    import h5py

    from vibraverse.cli import UsageError
    from vibraverse.media import audio
    from vibraverse.modesfile import read_spectrum
    from vibraverse.physics.impulse import contact, impact_sound
    from vibraverse.physics.materials import sampled_name
    from vibraverse.texts import unknown

    for path in job.final["sounds"]:
        if path.suffix != ".wav":
            raise UsageError(f"sounds: {path.name!r} is not NAME.wav")
    options = job.options
    names = [path.stem for path in job.final["sounds"]]
    record = {}
    with h5py.File(job.inputs["modes"]) as modes:
        sampled = len(modes["sampled/poisson"]) if "sampled" in modes else 0
        materials = [*modes["materials"], *map(sampled_name, range(sampled))]
        contacts = [
            contact(modes["surface/vertices"], modes["surface/faces"], point) for point in options.points
        ]
        for name, path in zip(names, job.outputs["sounds"], strict=True):
            material, point = split_sound(name, materials)
            if material is None:
                raise UsageError(f"sounds: {unknown('material', name, modes['materials'])}")
            if point is not None and material not in modes["materials"]:
                raise UsageError(f"sounds: {name!r} asks for mode shapes, which no sampled material has")
            if point is not None and point >= len(contacts):
                raise UsageError(
                    f"sounds: {name!r} asks for point {point} of {len(contacts)} in audio.points"
                )
            struck = None if point is None else contacts[point]
            sound = impact_sound(
                *read_spectrum(modes, material),
                options.sample_rate_hz,
                options.decay_db,
                options.max_s,
                None if struck is None else struck.weights(modes[f"materials/{material}/mode_shapes"]),
            )
            wav, levels = audio.wav_bytes(sound.samples, sound.sample_rate_hz, options.subtype)
            path.write_bytes(wav)
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
            "unit": audio.UNIT,
            "sounds": record,
        }
    )


STAGE = Stage(
    name="audio",
    help="render the impact sounds",
    inputs={"modes": "modes.h5: frequencies and damping of every material"},
    outputs={
        "sounds": "WAV files; stem MATERIAL, or MATERIAL-pK for struck point K",
        "record": "audio.json: gains, durations and counts",
    },
    run=run,
    options=Audio,
    many=frozenset({"sounds"}),
    libraries=("numpy", "scipy", "h5py", "soundfile"),
    per_solidity=True,
)
