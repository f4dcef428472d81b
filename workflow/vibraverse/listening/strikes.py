"""The hit in a recording: where it begins, where the next one ends it, and whether the recording can be used.

A hit raises most of the spectrum within milliseconds. Beats between modes raise a few bands, and slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import UsageError

#: Lowest usable sample rate, and the one below which a warning says what is not heard.
MIN_RATE_HZ, GOOD_RATE_HZ = 8000, 32000
#: Peak, relative to full scale, below which a recording is silent: 80 dB.
_SILENT = 1e-4
#: A recording is clipped if at least so many samples lie within the first share of its peak, and these are at least the
#: given part of those within the second share. A sine has 22 %.
_CLIPPED_SAMPLES, _CLIPPED_SHARES, _CLIPPED_PART = 12, (1e-3, 2e-2), 0.5
#: Length of a frame in seconds, and the number of bands of its spectrum.
_FRAME_S, _BANDS = 0.006, 20
#: A hit raises this part of the bands by so many dB above the frames just before, and is at most so many dB below the
#: loudest frame.
_RISING_PART, _RISE_DB, _FRAMES_BEFORE, _BELOW_LOUDEST_DB = 0.4, 6.0, 3, 30.0
#: Power of the first frame, as a share of the loudest one's, above which a recording begins with a hit.
_CUT_AT_HIT = 0.1
#: Frames after a hit in which no other is looked for.
_DEAD_FRAMES = 4
#: Longest part of a hit that is used, what is left out before the next hit and before the end, which is often faded
#: out, and the length below which a later hit that rings longer is taken instead; in seconds.
_LONGEST_S, _BEFORE_NEXT_S, _FADE_S, _SHORT_S = 6.0, 0.008, 0.012, 0.05
#: Shortest part that says anything, in seconds.
_SHORTEST_S = 0.008


@dataclass(frozen=True)
class Strike:
    """Samples (n,) from a hit on, at ``rate_hz``; ``start_s`` is where they begin in the recording.

    ``notes`` are sentences about what was chosen.
    """

    samples: np.ndarray
    rate_hz: int
    start_s: float
    notes: list[str]


def strike(recording: np.ndarray, rate_hz: int) -> Strike:
    """Return the hit of a recording (n, channels), whose full scale is 1.

    Raises :class:`UsageError` for a recording that is silent, clipped, too short or sampled too slowly.
    """
    notes = []
    if rate_hz < MIN_RATE_HZ:
        raise UsageError(
            f"the sample rate of {rate_hz} Hz is too low: nothing above {rate_hz / 2:g} Hz is in the recording; record "
            f"at 44100 Hz, at least at {MIN_RATE_HZ}"
        )
    if rate_hz < GOOD_RATE_HZ:
        notes.append(
            f"the sample rate is {rate_hz} Hz, so nothing above {rate_hz / 2:g} Hz is heard; record at 44100 Hz"
        )
    samples, chosen = _channel(recording)
    notes += chosen
    peak = np.abs(samples).max(initial=0.0)
    if not peak > _SILENT:
        level = f"{-20 * np.log10(peak):.0f} dB below full scale" if peak > 0 else "zero"
        raise UsageError(f"the recording is silent, its loudest sample is {level}; record louder")
    if clipped := _clipped(samples):
        raise UsageError(
            f"the recording is clipped: {clipped} samples lie at its peak, which adds frequencies that the body does "
            "not have; strike more softly, or record at a lower level"
        )
    hits = _hits(samples, rate_hz)
    ends = [
        *(hit - round(_BEFORE_NEXT_S * rate_hz) for hit in hits[1:]),
        len(samples) - round(_FADE_S * rate_hz),
    ]
    lengths = [end - hit for hit, end in zip(hits, ends, strict=True)]
    used = 0 if lengths[0] >= _SHORT_S * rate_hz else int(np.argmax(lengths))
    if len(hits) > 1:
        at = ", ".join(f"{hit / rate_hz:.3f}" for hit in hits[:6]) + (", …" if len(hits) > 6 else "")
        which = "first" if used == 0 else "one that rings longest"
        notes.append(
            f"there are {len(hits)} hits, at {at} s; the {which} is used, for {lengths[used] / rate_hz:.3f} s"
        )
    if lengths[used] < _SHORTEST_S * rate_hz:
        raise UsageError(
            f"the sound after the hit at {hits[used] / rate_hz:.3f} s lasts "
            f"{max(lengths[used], 0) / rate_hz * 1e3:.0f} ms, at least {1e3 * _SHORTEST_S:g} are needed; "
            "record until it has died away"
        )
    start = hits[used]
    stop = min(ends[used], start + round(_LONGEST_S * rate_hz))
    return Strike(samples[start:stop], rate_hz, start / rate_hz, notes)


def _channel(recording: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the loudest channel, and a note. A sum of channels cancels what reaches them at opposite phase."""
    if not np.isfinite(recording).all():
        raise UsageError("the recording holds samples that are not finite; export it again")
    energy = (recording**2).sum(axis=0)
    best = int(np.argmax(energy))
    count = recording.shape[1]
    notes = [f"channel {best + 1} of {count} is used, the loudest"] if count > 1 else []
    samples = recording[:, best].astype(np.float64)
    return samples - np.median(samples), notes


def _clipped(samples: np.ndarray) -> int:
    """Return how many samples lie at the peak if they are too many for a sound that decays; else 0."""
    size = np.abs(samples)
    top, near = (int(np.count_nonzero(size >= (1 - share) * size.max())) for share in _CLIPPED_SHARES)
    return top if top >= _CLIPPED_SAMPLES and top >= _CLIPPED_PART * near else 0


def _hits(samples: np.ndarray, rate_hz: int) -> list[int]:
    """Return the samples at which hits begin, at least one."""
    level = _levels(samples, rate_hz)
    length = round(_FRAME_S * rate_hz)
    power = np.square(_frames(samples, length)).mean(axis=1)
    # A recording that begins loud was cut at the hit; one that begins softly begins with the noise of the room.
    first = level[0] - 2 * _RISE_DB if power[0] > _CUT_AT_HIT * power.max() else level[0]
    before = np.concatenate([np.tile(first, (_FRAMES_BEFORE, 1)), level])
    highest = np.max([before[k : k + len(level)] for k in range(_FRAMES_BEFORE)], axis=0)
    rising = ((level - highest) > _RISE_DB).mean(axis=1) >= _RISING_PART
    # A hit may begin late in a frame, so the next one counts too.
    loud = np.maximum(power, np.append(power[1:], 0.0)) > power.max() * 10 ** (-_BELOW_LOUDEST_DB / 10)
    frames: list[int] = []
    for frame in np.flatnonzero(rising & loud):
        if not frames or frame - frames[-1] > _DEAD_FRAMES:
            frames.append(int(frame))
    frames = frames or [max(int(power.argmax()) - 1, 0)]
    return [_begin(samples, frame * length, length) for frame in frames]


def _begin(samples: np.ndarray, at: int, length: int) -> int:
    """Return the sample where a hit that shows in a frame has reached half its peak: the contact is over."""
    first = max(at - length // 2, 0)
    size = np.abs(samples[first : at + 2 * length])
    return first + int(np.argmax(size >= 0.5 * size.max()))


def _frames(samples: np.ndarray, length: int) -> np.ndarray:
    """Return the whole frames (t, length) of a signal, at least one. An end amid a frame would look like a hit."""
    count = max(len(samples) // length, 1)
    return np.resize(samples, (count, length))


def _levels(samples: np.ndarray, rate_hz: int) -> np.ndarray:
    """Return levels in dB (t, b) of the bands of each frame, above the background of the band."""
    length = round(_FRAME_S * rate_hz)
    frames = _frames(samples, length) * np.hanning(length)
    power = np.abs(np.fft.rfft(frames, axis=1)) ** 2
    edges = np.unique(np.geomspace(1, power.shape[1], _BANDS + 1).round().astype(int))
    bands = np.add.reduceat(power, edges[:-1], axis=1)
    background = 2 * np.median(bands, axis=0) + 1e-7 * bands.max()
    return 10 * np.log10(bands + background)
