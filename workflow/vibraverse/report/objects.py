"""What the page knows of an object before one of its bodies is loaded: enough to hear it, and its row of the index.

A ring time is the time in which a mode decays by 60 dB: ``ln(1000) / d`` for the decay rate ``d``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from vibraverse.media.looks import look_of
from vibraverse.physics.materials import MATERIALS, PARAMETERS

#: Parameters of a material on the page, and the keys of the configuration that they come from.
_PARAMETERS = {
    "density": "density_kg_m3",
    "young": "young_pa",
    "poisson": "poisson",
    "alpha": "alpha_per_s",
    "beta": "beta_s",
}
#: Significant digits of stored numbers. A sound of 4 s needs eight of its frequencies.
_HZ_DIGITS, _ERROR_DIGITS, _GAIN_DIGITS, _ROW_DIGITS = 8, 2, 6, 4
#: Ring time times decay rate.
_LN_60_DB = math.log(1000.0)
#: The options of a sound that the page needs.
_AUDIO = ("sample_rate_hz", "decay_db", "max_s", "contact_s", "observable")


def materials_data(materials: Mapping[str, Mapping]) -> dict:
    """Return the parameters of named materials, how they look, and whether every command knows them by that name."""
    return {
        name: {
            **{short: float(values[key]) for short, key in _PARAMETERS.items()},
            "known": all(MATERIALS.get(name, {}).get(key) == values[key] for key in PARAMETERS),
            "look": _look(name),
        }
        for name, values in materials.items()
    }


def _look(name: str) -> dict:
    look = look_of(name)
    clear = look.kind == "clear"
    return {"colour": look.colour, "metallic": look.metallic, "roughness": look.roughness, "clear": clear}


def modes_data(frequencies_hz, errors, mass_kg: float) -> dict:
    """Return the modes of a body in a material: frequencies in Hz, their relative errors by the elements, the mass."""
    return {
        "hz": _rounded(frequencies_hz, _HZ_DIGITS),
        "error": _rounded(errors, _ERROR_DIGITS),
        "mass_kg": _rounded([mass_kg], _ROW_DIGITS)[0],
    }


def strike_data(point: int, position, normal, weights) -> dict:
    """Return a stored strike: the number of its point, where it is and along what, the weight of each mode."""
    return {
        "point": point,
        "position": _rounded(position, _GAIN_DIGITS),
        "normal": _rounded(normal, _GAIN_DIGITS),
        "gains": _rounded(weights, _GAIN_DIGITS),
    }


def audio_data(options: Mapping) -> dict:
    """Return the options with which the sounds were made."""
    return {key: options[key] for key in _AUDIO}


def facts(source: Mapping) -> dict:
    """Return the texts about where an object came from, without those that are not known."""
    found = {
        "title": source.get("title") or source["object"],
        "family": source.get("category"),
        "origin": source["origin"],
        "source": source.get("file"),
        "licence": source.get("licence"),
        "attribution": source.get("attribution"),
    }
    return {name: value for name, value in found.items() if value}


def index_row(object_id: str, data: Mapping, version: str) -> dict:
    """Return what the index says of an object: the object's own facts, and a few numbers of each body.

    ``data`` is the content of the object's script. ``f1_hz`` and ``ring_s`` are those of mode 1, by material; a mode
    that does not ring has a ring time of 0. A refused body has its stage and reason instead.
    """
    bodies = {solidity: _body_row(body, data["materials"]) for solidity, body in data["bodies"].items()}
    for solidity, refusal in data["refused"].items():
        bodies[solidity] = {"refused": {"stage": refusal["stage"], "reason": refusal["reason"]}}
    about = data["facts"]
    return {
        "id": object_id,
        "title": about["title"],
        "source": about["origin"],
        "family": about.get("family", ""),
        "licence": about.get("licence", ""),
        "size_m": data["size_m"],
        "version": version,
        "bodies": bodies,
    }


def _body_row(body: Mapping, materials: Mapping) -> dict:
    rings = {}
    for name, modes in body["modes"].items():
        omega = 2 * math.pi * modes["hz"][0]
        damping = 0.5 * (materials[name]["alpha"] + materials[name]["beta"] * omega**2)
        rings[name] = _LN_60_DB / damping if 0 < damping < omega else 0.0
    return {
        "f1_hz": {name: _rounded(modes["hz"][:1], _ROW_DIGITS)[0] for name, modes in body["modes"].items()},
        "ring_s": {name: _rounded([ring], 3)[0] for name, ring in rings.items()},
        "volume_m3": _rounded([body["volume_m3"]], _ROW_DIGITS)[0],
        "worst_error": max(max(modes["error"]) for modes in body["modes"].values()),
        "warnings": len(body.get("warnings", ())),
    }


def _rounded(values, digits: int) -> list[float]:
    """Return numbers with this many significant digits."""
    return [float(f"{value:.{digits}g}") for value in np.asarray(values, dtype=np.float64).tolist()]
