"""Levels of a mel spectrogram in decibels below the loudest point.

    m(f) = 2595 log10(1 + f / 700)

The mel scale resolves the low partials, which carry the pitch of a struck body, as the ear does.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import hann

#: Lowest level, in decibels relative to the loudest point.
FLOOR_DB = -80.0
_WINDOW_S = 0.046


def mel(frequency_hz):
    """Return the mel value of a frequency in Hz."""
    return 2595.0 * np.log10(1.0 + np.asarray(frequency_hz, dtype=np.float64) / 700.0)


def mel_levels(samples, sample_rate_hz: int, rows: int = 128, columns: int = 256) -> np.ndarray:
    """Return levels in dB relative to the loudest point, (rows, about columns), from 0 Hz to half the sample rate.

    Rows are evenly spaced in mel and columns in time. A row takes the largest power in its band, so no partial is lost
    between rows. The Hann window is 46 ms long, shorter for sounds under 0.2 s. Silence is :data:`FLOOR_DB` everywhere.
    Raises ``ValueError`` unless ``samples`` is a list of at least one number.
    """
    samples = np.asarray(samples, dtype=np.float64)
    if samples.ndim != 1 or not len(samples):
        raise ValueError(f"a spectrogram needs a list of samples, not an array of shape {samples.shape}")
    window = max(16, min(round(_WINDOW_S * sample_rate_hz), len(samples) // 4))
    samples = np.pad(samples, (0, max(0, window - len(samples))))
    transform = ShortTimeFFT(
        hann(window, sym=False),
        hop=max(1, len(samples) // columns),
        fs=sample_rate_hz,
        mfft=max(window, 4096),
    )
    power = transform.spectrogram(samples, p0=0, p1=max(1, len(samples) // transform.hop))
    mels = mel(transform.f)
    first = np.searchsorted(mels, np.linspace(0.0, mels[-1], rows, endpoint=False))
    image = np.maximum.reduceat(power, first, axis=0)
    peak = image.max()
    if peak == 0:
        return np.full(image.shape, FLOOR_DB)
    return np.maximum(10.0 * np.log10(np.maximum(image / peak, 1e-30)), FLOOR_DB)
