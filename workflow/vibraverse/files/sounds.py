"""Sound files to arrays: WAV, FLAC, OGG, MP3, AIFF and what else libsndfile reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable


def read_sound(path: Path, longest_s: float) -> tuple[np.ndarray, int, float]:
    """Return the first ``longest_s`` seconds (n, channels), the rate in Hz, and the length of the whole file in s.

    Full scale is 1. Raises :class:`UsageError` if the file cannot be read.
    """
    import soundfile

    if wrong := unreadable(path, missing="name an existing file"):
        raise UsageError(f"the sound file {path} {wrong}")
    try:
        with soundfile.SoundFile(path) as file:
            rate, count = file.samplerate, file.frames
            samples = file.read(frames=min(count, round(longest_s * rate)), always_2d=True)
    except soundfile.LibsndfileError as error:
        raise UsageError(
            f"the sound file {path} cannot be read ({error.error_string.rstrip('.')}); save it as WAV or FLAC"
        ) from None
    if not len(samples):
        raise UsageError(f"the sound file {path} holds no samples; record again")
    return samples, rate, count / rate


def read_frequencies(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies in Hz (n,), ascending, and decay rates in 1/s (n,), NaN where the file states none.

    A line holds a frequency and, after a comma or a space, its decay rate; ``#`` begins a comment. Raises
    :class:`UsageError` for a file that cannot be read and for lines that hold anything else.
    """
    if wrong := unreadable(path, missing="name an existing file"):
        raise UsageError(f"the list of frequencies {path} {wrong}")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) not in (1, 2) or not all(np.isfinite(values)) or min(values) <= 0:
            raise UsageError(
                f"line {number} of {path} is {line.strip()!r}; write a frequency in Hz, and its decay rate in 1/s "
                "if it is known, such as 1234.5 or 1234.5, 8.1"
            )
        rows.append((values[0], values[1] if len(values) == 2 else np.nan))
    frequencies, decays = np.array(sorted(rows)).reshape(-1, 2).T
    return frequencies, decays
