"""The content of the page for each object, with its pictures and sounds.

A ring time is the time in which a mode decays by 60 dB: ``ln(1000) / d`` for the decay rate ``d``.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field

import numpy as np
import soundfile
from matplotlib import colormaps
from PIL import Image

from vibraverse.config.media import split_sound
from vibraverse.dataset.read.reader import Reader
from vibraverse.media.spectrogram import FLOOR_DB, mel, mel_levels

#: Ring time times decay rate.
_LN_60_DB = math.log(1000.0)
#: Frequencies marked on a spectrogram.
_MARKS_HZ = {1_000: "1 k", 4_000: "4 k", 16_000: "16 k"}


@dataclass
class Card:
    """One object on the page.

    ``facts`` are texts about the source, ``pictures`` file names by look. ``bodies`` holds size and mesh by solidity,
    ``refused`` the refusals of the other bodies. ``rows`` are the players: one row per sound, one cell per solidity.
    ``modes`` holds ``{material: {solidity: [frequencies, ring times]}}``.
    """

    object: str
    facts: dict[str, str]
    pictures: dict[str, list[str]]
    bodies: dict[str, dict] = field(default_factory=dict)
    refused: dict[str, dict] = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)
    modes: dict[str, dict[str, list]] = field(default_factory=dict)


def card(reader: Reader, object_id: str, assets: dict[str, bytes]) -> Card:
    """Return the card of an object; add its pictures and sounds to ``assets`` by file name."""
    group = reader.group(object_id)
    items = reader.where(object=object_id).items[:]
    facts = {name: group.attrs[name] for name in ("title", "category", "origin", "licence", "attribution")}
    facts["split"] = items[0]["split"]
    materials = list(dict.fromkeys(item["material"] for item in items))
    pictures = {}
    for look in sorted(group["views"], key=lambda look: materials.index(look) if look in materials else -1):
        pictures[look] = [f"{object_id}/{look}-{view:02d}.png" for view in range(len(group["views"][look]))]
        assets.update(zip(pictures[look], (png.tobytes() for png in group["views"][look][()]), strict=True))
    shown = Card(object_id, facts, pictures)
    shown.refused = {row["solidity"]: row for row in reader.refusals if row["object"] == object_id}
    for solidity in dict.fromkeys(item["solidity"] for item in items):
        body = group[solidity]
        errors = [body["materials"][material]["discretisation_error"][()] for material in materials]
        shown.bodies[solidity] = {
            "size_m": float(body.attrs["size_m"]),
            "volume_m3": float(body.attrs["volume_m3"]),
            "tetrahedra": len(body["tets/cells"]),
            "quality": reader.read("tets", object_id, solidity)["quality"],
            "error_median": float(np.median(errors)),
            "error_max": float(np.max(errors)),
        }
        for material in materials:
            shown.modes.setdefault(material, {})[solidity] = _modes(body["materials"][material])
    names = dict.fromkeys(name for solidity in shown.bodies for name in group[solidity]["sounds"])
    names = [name for name in names if split_sound(name, materials)[0]]  # leaves out sampled materials
    for name in sorted(names, key=lambda name: _place(name, materials)):
        material, point = split_sound(name, materials)
        cells = {
            solidity: _cell(group[solidity], object_id, solidity, name, material, assets)
            for solidity in shown.bodies
            if name in group[solidity]["sounds"]
        }
        shown.rows.append({"material": material, "point": point, "cells": cells})
    return shown


def _place(name: str, materials: list[str]) -> tuple[int, int]:
    material, point = split_sound(name, materials)
    return materials.index(material), -1 if point is None else point


def _modes(material) -> list:
    """Return frequencies in Hz and ring times in s (0 for overdamped modes), rounded for the page."""
    hz, damping = material["frequencies_hz"][()], material["damping_per_s"][()]
    rings = np.where(material["damped_frequencies_hz"][()] > 0, _LN_60_DB / np.maximum(damping, 1e-9), 0.0)
    return [[float(f"{value:.6g}") for value in hz], [float(f"{value:.4g}") for value in rings]]


def _cell(body, object_id: str, solidity: str, name: str, material: str, assets: dict[str, bytes]) -> dict:
    stored = body["sounds"][name]
    return {
        **sound(stored[()], int(stored.attrs["sample_rate_hz"]), f"{object_id}/{solidity}-{name}", assets),
        "f1_hz": float(body["materials"][material]["frequencies_hz"][0]),
        "mass_kg": float(body["materials"][material].attrs["mass_kg"]),
    }


def sound(samples, sample_rate_hz: int, stem: str, assets: dict[str, bytes]) -> dict:
    """Return what a player shows of a sound; add its FLAC file and its spectrogram to ``assets``."""
    assets[f"{stem}.flac"] = flac(samples, sample_rate_hz)
    assets[f"{stem}.png"] = spectrogram(samples, sample_rate_hz)
    return {
        "audio": f"{stem}.flac",
        "spectrogram": f"{stem}.png",
        "marks": marks(sample_rate_hz),
        "silent_below_hz": 0.0 if samples.any() else sample_rate_hz / 2,
        "duration_s": len(samples) / sample_rate_hz,
    }


def spectrogram(samples, sample_rate_hz: int) -> bytes:
    """Return a PNG file: levels over time and mel frequency, without axes; the player draws its cursor on it."""
    levels = mel_levels(samples, sample_rate_hz)[::-1]
    picture = Image.fromarray(np.round(255 * (1 - levels / FLOOR_DB)).astype(np.uint8), mode="P")
    picture.putpalette((colormaps["magma"](np.arange(256), bytes=True)[:, :3]).tobytes())
    file = io.BytesIO()
    picture.save(file, format="PNG", optimize=True)
    return file.getvalue()


def marks(sample_rate_hz: int) -> dict[str, float]:
    """Return the frequency marks of a spectrogram: label and height in percent."""
    top_hz = sample_rate_hz / 2
    return {
        text: round(100 * float(mel(hz) / mel(top_hz)), 2)
        for hz, text in _MARKS_HZ.items()
        if hz < 0.95 * top_hz
    }


def flac(samples, sample_rate_hz: int) -> bytes:
    """Return a 16-bit FLAC file: lossless, half the size of WAV, played by every browser, deterministic."""
    file = io.BytesIO()
    soundfile.write(file, samples, sample_rate_hz, format="FLAC", subtype="PCM_16")
    return file.getvalue()
