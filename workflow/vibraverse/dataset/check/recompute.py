"""Recomputation of numbers in the dataset from others in it.

Frequencies and the spectrum that identifies copies are recomputed from the basis, sounds from the modes. This proves
that labels and inputs belong together. It costs a tenth of a second per item, so it covers a sample of the items. A
hash of their names chooses them: the same ones every time, and different ones in every object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from vibraverse.config.media import split_sound
from vibraverse.contract.seeds import stable_hash
from vibraverse.dataset.write.making import VARIES
from vibraverse.flow.paths import SOLIDITIES
from vibraverse.physics.materials import PARAMETERS, sampled_name, sampled_number

#: Largest relative difference of a recomputed frequency: machines round differently, and eigenvalues amplify that.
FREQUENCY_TOLERANCE = 1e-6
#: Largest difference of a recomputed sample relative to full scale: eight steps of 24 bits, or one step of 16 bits.
SAMPLE_TOLERANCE = {"PCM_24": 8 / 2**23, "PCM_16": 2 / 2**15}


def repeats(share: float) -> Callable[[str, object, dict], Iterator[str]]:
    """Return the function that recomputes about this share of an object's items; see :func:`again`."""

    def some(object_id: str, group, making: dict) -> Iterator[str]:
        return again(object_id, group, making, share)

    return some


def again(object_id: str, group, making: dict, share: float = 1.0) -> Iterator[str]:
    """Yield the recomputed numbers of an object that differ from the stored ones.

    ``making`` states how the shard was made. Sounds are skipped if their options vary between objects.
    """

    def asked(*names: str) -> bool:
        return stable_hash(object_id, *names, "check") < share * 2**64

    if "shape/spectrum" in group and asked("spectrum"):
        yield from _spectrum(group)
    for solidity in SOLIDITIES:
        body = group.get(solidity)
        for material in _materials(body) if body is not None else ():
            if asked(solidity, material):
                for sentence in (*_frequencies(body, material, making), *_sounds(body, material, making)):
                    yield f"{solidity}, {material}: {sentence}"


def _materials(body) -> list[str]:
    """Return the names of a body's materials, the sampled ones last."""
    sampled = len(body["sampled/poisson"]) if "sampled" in body else 0
    return [*body.get("materials", ()), *map(sampled_name, range(sampled))]


def _spectrum(group) -> Iterator[str]:
    from vibraverse.dataset.split.copies import scale_free_spectrum
    from vibraverse.files.basis import read_basis

    stored = group["shape/spectrum"][()]
    found = scale_free_spectrum(read_basis(group["solid/basis"], surface=False))
    if len(found) != len(stored) or np.abs(found / stored - 1).max() > FREQUENCY_TOLERANCE:
        yield "shape/spectrum is not that of the solid body's stored basis"


def _frequencies(body, material: str, making: dict) -> Iterator[str]:
    from vibraverse.files.basis import read_basis
    from vibraverse.physics.modes import solve_material

    corrected = making["modes"]["options"].get("corrected", VARIES)
    number = sampled_number(material)
    if number is None:
        stored = body["materials"][material]
        values, directly = dict(stored.attrs), stored.attrs["solved_directly"]
        hz = stored["frequencies_hz"][()]
    else:
        values, directly = {name: body["sampled"][name][number] for name in PARAMETERS}, False
        hz = body["sampled/frequencies_hz"][number]
    if directly or corrected == VARIES:
        return
    basis = read_basis(body["basis"], surface=False)
    found = solve_material(basis, values, float(body.attrs["scale_m"]), len(hz), corrected)
    if len(found.frequencies_hz) != len(hz):
        yield f"the basis has {len(found.frequencies_hz)} modes, frequencies_hz {len(hz)}"
        return
    error = np.abs(found.frequencies_hz / hz - 1)
    if error.max() > FREQUENCY_TOLERANCE:
        worst = int(error.argmax())
        yield (
            f"frequencies_hz[{worst}] = {hz[worst]:.6g} Hz, but the stored basis gives "
            f"{found.frequencies_hz[worst]:.6g} Hz (tolerance {FREQUENCY_TOLERANCE:g} of it)"
        )


def _sounds(body, material: str, making: dict) -> Iterator[str]:
    from vibraverse.files.modes import read_mode_shapes, read_spectrum, read_surface
    from vibraverse.physics.impulse import contact, impact_sound

    options = making["audio"]["options"]
    for name, stored in body["sounds"].items():
        of, point = split_sound(name, [material])
        if of is None or VARIES in options.values():
            continue
        weights = None
        if point is not None:
            surface = body["basis/surface"]
            struck = contact(surface["vertices"], surface["faces"], options["points"][point])
            moving = read_surface(body["basis"], struck.corners)
            weights = struck.weights(read_mode_shapes(body, moving, material, struck.corners))
        sound = impact_sound(
            *read_spectrum(body, material),
            int(stored.attrs["sample_rate_hz"]),
            options["decay_db"],
            options["max_s"],
            weights,
            options.get("contact_s", 0.0),
            options.get("observable", "displacement"),
        )
        if len(sound.samples) != len(stored):
            yield f"the sound {name} has {len(stored)} samples, but the stored modes give {len(sound.samples)}"
            continue
        error = np.abs(sound.samples * stored.attrs["gain"] - stored[()]).max()
        if error > SAMPLE_TOLERANCE[options["subtype"]]:
            yield f"the sound {name} differs by {error:.2g} of full scale from what the stored modes give"
