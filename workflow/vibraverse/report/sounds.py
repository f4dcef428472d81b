"""Sounds that pages play from files: FLAC, with a spectrogram that a player draws its cursor on."""

from __future__ import annotations

import io

import numpy as np
import soundfile
from matplotlib import colormaps
from PIL import Image

from vibraverse.media.spectrogram import FLOOR_DB, mel, mel_levels

#: Frequencies marked on a spectrogram.
_MARKS_HZ = {1_000: "1 k", 4_000: "4 k", 16_000: "16 k"}


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
