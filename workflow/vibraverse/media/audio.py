"""Sounds as WAV files: peak-normalised, with the gain that recovers physical values.

Float samples would need no gain, but libsndfile writes the time of day into float files. Integer files are
reproducible byte for byte. With 24 bits the dynamic range below the peak is 138 dB.
"""

from __future__ import annotations

import io

import numpy as np
import soundfile

#: Unit of a physical sample by observable (see :mod:`vibraverse.physics.impulse`).
UNITS = {
    "displacement": "kg^0.5 m (sample = stored sample / gain)",
    "velocity": "kg^0.5 m/s (sample = stored sample / gain)",
    "acceleration": "kg^0.5 m/s² (sample = stored sample / gain)",
}
#: Largest sample of a file, in decibels relative to full scale.
PEAK_DBFS = -1.0


def wav_bytes(samples, sample_rate_hz: int, subtype: str = "PCM_24") -> tuple[bytes, dict]:
    """Return a mono WAV file of ``samples`` (n,) with its peak at :data:`PEAK_DBFS`, and its levels.

    The levels are ``gain`` (stored = physical · gain; 1 for silence), ``peak`` (physical), ``peak_dbfs`` and
    ``rms_dbfs`` of the stored samples, and ``loudest_dbfs``, the RMS over the loudest 50 ms. The level of silence is
    None.
    """
    samples = np.asarray(samples, dtype=np.float64)
    peak = float(np.abs(samples).max(initial=0.0))
    gain = 10.0 ** (PEAK_DBFS / 20.0) / peak if peak > 0 else 1.0
    stored = samples * gain
    power = np.concatenate([[0.0], np.cumsum(stored**2)])
    window = min(len(stored), round(0.05 * sample_rate_hz))
    loudest = (power[window:] - power[:-window]).max() / window
    file = io.BytesIO()
    soundfile.write(file, stored, sample_rate_hz, subtype=subtype, format="WAV")
    return file.getvalue(), {
        "gain": gain,
        "peak": peak,
        "peak_dbfs": PEAK_DBFS if peak > 0 else None,
        "rms_dbfs": _decibels(power[-1] / len(stored)),
        "loudest_dbfs": _decibels(loudest),
    }


def _decibels(power: float) -> float | None:
    return round(10.0 * float(np.log10(power)), 3) if power > 0 else None
