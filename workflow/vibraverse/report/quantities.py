"""Quantities as people read them: three significant digits and a suitable unit."""

from __future__ import annotations

import math

_LENGTHS = ((1e-2, 1e-3, "mm"), (1.0, 1e-2, "cm"), (math.inf, 1.0, "m"))
_VOLUMES = ((1e-6, 1e-9, "mm³"), (1e-3, 1e-6, "cm³"), (1.0, 1e-3, "L"), (math.inf, 1.0, "m³"))
_MASSES = ((1e-3, 1e-6, "mg"), (1.0, 1e-3, "g"), (1e3, 1.0, "kg"), (math.inf, 1e3, "t"))
_FREQUENCIES = ((1e4, 1.0, "Hz"), (math.inf, 1e3, "kHz"))
_TIMES = ((1.0, 1e-3, "ms"), (math.inf, 1.0, "s"))
_SIZES = ((1e6, 1e3, "kB"), (1e9, 1e6, "MB"), (math.inf, 1e9, "GB"))


def number(value: float, digits: int = 3) -> str:
    """Return a number with this many significant digits, thousands separators and no exponent.

    >>> number(0.12345), number(1234.5), number(2.0)
    ('0.123', '1,230', '2')
    """
    if value == 0:
        return "0"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, decimals):,.{max(decimals, 0)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _scaled(value: float, units) -> str:
    for below, unit, name in units:
        if value < below:
            return f"{number(value / unit)}\u202f{name}"
    raise ValueError(f"{value} has no unit")


def length(metres: float) -> str:
    """Return a length, e.g. ``18 cm``."""
    return _scaled(metres, _LENGTHS)


def volume(cubic_metres: float) -> str:
    """Return a volume, e.g. ``216 cm³``."""
    return _scaled(cubic_metres, _VOLUMES)


def mass(kilograms: float) -> str:
    """Return a mass, e.g. ``583 g``."""
    return _scaled(kilograms, _MASSES)


def frequency(hertz: float) -> str:
    """Return a frequency, e.g. ``2,720 Hz``."""
    return _scaled(hertz, _FREQUENCIES)


def duration(seconds: float) -> str:
    """Return a duration, e.g. ``393 ms``."""
    return _scaled(seconds, _TIMES)


def file_size(count: float) -> str:
    """Return a number of bytes, e.g. ``862 kB``."""
    return _scaled(count, _SIZES)
