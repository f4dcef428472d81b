"""Impact sounds: frequencies and damping of every material become WAV files."""

from __future__ import annotations

from vibraverse.config.media import Audio, split_sound
from vibraverse.stage import Job, Stage


def run(job: Job) -> None:
    """Write a sound per material and struck point; the file's stem says of which material, and struck where."""
    import h5py

    from vibraverse.cli import UsageError
    from vibraverse.media import audio
    from vibraverse.modesfile import read_mode_shapes, read_spectrum, read_surface
    from vibraverse.physics.impulse import contact, impact_sound
    from vibraverse.physics.materials import sampled_name

    options = job.options
    record = {}
    with h5py.File(job.inputs["modes"]) as modes, h5py.File(job.inputs["basis"]) as basis:
        sampled = len(modes["sampled/poisson"]) if "sampled" in modes else 0
        materials = [*modes["materials"], *map(sampled_name, range(sampled))]
        contacts = [
            contact(basis["surface/vertices"], basis["surface/faces"], point) for point in options.points
        ]
        moving = [read_surface(basis, struck.corners) for struck in contacts]
        if options.sampled > sampled:
            raise UsageError(
                f"audio.sampled is {options.sampled}, and the modes are of {sampled} sampled materials"
            )
        for name in options.names(modes["materials"]):
            material, point = split_sound(name, materials)
            struck = None if point is None else contacts[point]
            weights = None
            if struck is not None:
                weights = struck.weights(read_mode_shapes(modes, moving[point], material, struck.corners))
            sound = impact_sound(
                *read_spectrum(modes, material),
                options.sample_rate_hz,
                options.decay_db,
                options.max_s,
                weights,
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
            "unit": audio.UNIT,
            "sounds": record,
        }
    )


STAGE = Stage(
    name="audio",
    help="render the impact sounds",
    inputs={
        "basis": "basis.h5, for the surface that is struck",
        "modes": "modes.h5: frequencies and damping of every material",
    },
    outputs={
        "sounds": "folder for MATERIAL.wav, MATERIAL-pK.wav (struck point K) and audio.json: gains, durations, counts"
    },
    run=run,
    options=Audio,
    folders={"sounds": "audio.json"},
    libraries=("numpy", "scipy", "h5py", "soundfile"),
    per_solidity=True,
)
