"""Bands of a real signal as complex signals of a lower rate, in which exponentials stay exponentials.

A filter that looks back mixes the silence before a hit into its first samples. One that looks ahead makes each sample
a weighted sum of this and later ones, and ``Σ h_m z^(n+m) = H(z) z^n``: an exponential keeps its pole from the first
sample on, and only its amplitude changes. A filter of minimum phase weighs near samples most, so that quickly decaying
modes are not averaged away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.signal

#: Sampling rate of a band as a multiple of its width.
_OVERSAMPLING = 1.5
#: Attenuation of the rest of the spectrum in dB.
_STOP_DB = 70.0


@dataclass(frozen=True)
class Band:
    """Complex samples (n,) of the band from ``low_hz`` to ``high_hz`` around ``centre_hz``, at ``rate_hz``.

    ``gain`` is the filter's gain for an exponent relative to the centre, both per sample of the original rate.
    """

    samples: np.ndarray
    low_hz: float
    high_hz: float
    centre_hz: float
    rate_hz: float
    taps: np.ndarray
    original_rate_hz: float

    def gain(self, exponents: np.ndarray) -> np.ndarray:
        """Return the filter's gain (k,) for exponents (k,) in 1/s relative to the band's centre."""
        return np.exp(np.arange(len(self.taps)) * exponents[:, None] / self.original_rate_hz) @ self.taps


def extract(signal: np.ndarray, rate_hz: float, low_hz: float, high_hz: float) -> Band:
    """Return a band of a real signal (n,); modes in it have half their amplitude."""
    centre, width = 0.5 * (low_hz + high_hz), high_hz - low_hz
    factor = max(1, int(rate_hz / (_OVERSAMPLING * width)))
    taps = _taps(0.5 * width / rate_hz, 0.5 / factor)
    moved = signal * np.exp(-2j * np.pi * centre / rate_hz * np.arange(len(signal)))
    filtered = moved[:0]
    if len(signal) >= len(taps):
        filtered = scipy.signal.oaconvolve(moved, taps[::-1], mode="valid")[::factor]
    return Band(filtered, low_hz, high_hz, centre, rate_hz / factor, taps, rate_hz)


@lru_cache(maxsize=64)
def _taps(edge: float, nyquist: float) -> np.ndarray:
    """Return a low-pass filter of minimum phase: passes up to ``edge``, stops what aliases onto that; per sample."""
    stop = min(2 * nyquist - edge, 0.5)
    if stop - edge < 1e-9 or nyquist >= 0.5:
        return np.ones(1)
    count, beta = scipy.signal.kaiserord(_STOP_DB, 2 * (stop - edge))
    count |= 1
    linear = scipy.signal.firwin(count, edge + stop, window=("kaiser", beta))
    return linear if count < 3 else scipy.signal.minimum_phase(linear, half=False)
