"""Modal frequencies and decay rates of an impact sound, with standard errors.

The spectrum is cut into octaves, and an octave into halves until a band holds few enough samples of ringing for a
subspace method (:mod:`vibraverse.listening.poles`). So a mode that decays in a millisecond is found in a wide band and
one that rings for seconds in a narrow one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.listening import poles
from vibraverse.listening.bands import Band, extract

#: The lowest band begins here: no body of a metre or less rings below, and rooms and hands do.
LOWEST_HZ = 40.0
#: Highest frequency as a share of half the sample rate, because converters filter what lies above.
_HIGHEST = 0.98
#: Samples of ringing above which a band is cut into halves, and the width at which it no longer is.
_MAX_SAMPLES, _MIN_WIDTH_HZ = 320, 12.0
#: A band rings until its power is this many times the noise, in segments of this share of its length.
_ABOVE_NOISE, _SEGMENTS = 2.5, 24
#: A band is widened by this share on both sides, and peaks within it are kept only in the band proper.
_MARGIN = 0.15
#: Peaks so many dB below the loudest one are left out: what a filter lets through of loud modes lies 70 dB below.
_RANGE_DB = 50.0
#: A peak so many times louder, within this distance in log frequency, masks a peak.
_MASKED_BY, _MASKED_WITHIN = 10.0, 0.025
#: Peaks whose damping ratio is above this are no modes: noise, a thud, the end of a filter.
_MAX_DAMPING_RATIO = 0.12
#: Standard errors of a peak's frequency and decay rate above which it says nothing, relative to frequency and rate.
_MAX_FREQUENCY_ERROR, _MAX_DECAY_ERROR = 0.02, 0.7

#: Standard errors of frequencies and decay rates that come in a list, as shares.
LISTED_ERROR, LISTED_DECAY_ERROR = 1e-4, 0.02


@dataclass(frozen=True)
class Peaks:
    """Modes heard, ascending: undamped frequencies in Hz (n,), decay rates in 1/s (n,), amplitudes (n,) at the start.

    ``frequency_error_hz`` and ``decay_error_per_s`` (n,) are standard errors. ``highest_hz`` bounds what was listened
    to.
    """

    frequency_hz: np.ndarray
    decay_per_s: np.ndarray
    amplitude: np.ndarray
    frequency_error_hz: np.ndarray
    decay_error_per_s: np.ndarray
    highest_hz: float

    def __len__(self) -> int:
        return len(self.frequency_hz)

    def chosen(self, which: np.ndarray) -> Peaks:
        """Return some of the peaks, by a mask or by indices."""
        arrays = (self.frequency_hz, self.decay_per_s, self.amplitude, self.frequency_error_hz)
        return Peaks(*(one[which] for one in (*arrays, self.decay_error_per_s)), self.highest_hz)


def find(signal: np.ndarray, rate_hz: float) -> Peaks:
    """Return the peaks of a real signal (n,) that begins with a hit."""
    highest = _HIGHEST * rate_hz / 2
    rows = []
    edge = highest
    while edge > LOWEST_HZ:
        low = edge / 2 if edge / 2 > 2 * LOWEST_HZ else LOWEST_HZ
        rows += _of_band(signal, rate_hz, low, edge)
        edge = low if low > LOWEST_HZ else 0.0
    found = np.array(sorted(rows)).reshape(-1, 5)
    peaks = Peaks(*found.T, highest_hz=highest)
    peaks = peaks.chosen(peaks.amplitude > 10 ** (-_RANGE_DB / 20) * peaks.amplitude.max(initial=0.0))
    return peaks.chosen(~_masked(peaks))


def _masked(peaks: Peaks) -> np.ndarray:
    """Return which peaks (n,) may be echoes of a far louder one nearby, because a room blurs it over its neighbours."""
    near = np.abs(np.subtract.outer(np.log(peaks.frequency_hz), np.log(peaks.frequency_hz))) < _MASKED_WITHIN
    return (near & (peaks.amplitude > _MASKED_BY * peaks.amplitude[:, None])).any(axis=1)


def listed(frequency_hz: np.ndarray, decay_per_s: np.ndarray) -> Peaks:
    """Return peaks that somebody else measured: frequencies (n,), ascending, and decay rates (n,), NaN if unknown."""
    error = LISTED_ERROR * frequency_hz, LISTED_DECAY_ERROR * decay_per_s
    return Peaks(frequency_hz, decay_per_s, np.ones(len(frequency_hz)), *error, highest_hz=np.inf)


def _of_band(signal: np.ndarray, rate_hz: float, low_hz: float, high_hz: float) -> list[tuple[float, ...]]:
    """Return the peaks of a band as rows in the order of :class:`Peaks`."""
    margin = _MARGIN * (high_hz - low_hz)
    wide = max(low_hz - margin, 0.5 * LOWEST_HZ), min(high_hz + margin, rate_hz / 2)
    band = extract(signal, rate_hz, *wide)
    samples = band.samples[: _ringing(band.samples)]
    width = high_hz - low_hz
    if len(samples) > _MAX_SAMPLES and width > 2 * _MIN_WIDTH_HZ:
        middle = 0.5 * (low_hz + high_hz)
        return _of_band(signal, rate_hz, low_hz, middle) + _of_band(signal, rate_hz, middle, high_hz)
    rows = _rows(band, poles.find(samples[:_MAX_SAMPLES]))
    return [row for row in rows if low_hz <= row[0] < high_hz]


def _ringing(samples: np.ndarray) -> int:
    """Return how many samples of a band ring: until its power, in segments, no longer stands out of the noise."""
    length = max(len(samples) // _SEGMENTS, 4)
    count = len(samples) // length
    if count < 3:
        return len(samples)
    power = (np.abs(samples[: count * length]) ** 2).reshape(count, length).mean(axis=1)
    floor = np.sort(power)[: max(count // 6, 1)].mean()
    above = np.flatnonzero(power > _ABOVE_NOISE * floor)
    # As much again of noise tells the noise.
    return len(samples) if not len(above) else min(len(samples), 2 * (above[-1] + 1) * length)


def _rows(band: Band, found: poles.Poles) -> list[tuple[float, ...]]:
    """Return the poles of a band as rows, without those that are no modes."""
    exponents = found.exponents * band.rate_hz
    error = found.error * band.rate_hz
    decay = -exponents.real
    omega = 2 * np.pi * band.centre_hz + exponents.imag
    undamped = np.hypot(omega, decay)
    amplitude = 2 * np.abs(found.amplitudes / band.gain(exponents))
    good = (decay > 0) & (decay < _MAX_DAMPING_RATIO * undamped) & (error < _MAX_DECAY_ERROR * decay)
    good &= error < _MAX_FREQUENCY_ERROR * undamped
    columns = undamped / (2 * np.pi), decay, amplitude, error / (2 * np.pi), error
    return [tuple(float(one) for one in row) for row in np.column_stack(columns)[good]]
