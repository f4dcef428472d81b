"""Plots of the page of learning, in the colours of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vibraverse.media import plots

#: Colours of the methods, which repeat: the page's variables and what stands for them in a plot.
INKS = {
    "--c0": "#2b6cb8",
    "--c1": "#c0392b",
    "--c2": "#2a7d3f",
    "--c3": "#8553b5",
    "--c4": "#a8690f",
    "--c5": "#b83b82",
    "--c6": "#5b6b17",
    "--c7": "#0d7c99",
}
#: Colours of the truth, and of baselines.
TRUTH, BASELINE = "--ink", "--quiet"
_COLOURS = {**INKS, TRUTH: "#1d1e22", BASELINE: "#6f717a"}
_DASHES = (0, (3.2, 1.8))


@dataclass(frozen=True)
class Line:
    """A line of a plot: its points, the variable of its colour, and for intervals ``low`` and ``high``."""

    x: Sequence[float]
    y: Sequence[float]
    ink: str
    dashed: bool = False
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    width: float = 1.5


@dataclass(frozen=True)
class Panel:
    """Axes with lines. ``unit`` follows the numbers on the vertical axis; ``marks`` are texts on the horizontal one."""

    title: str
    lines: Sequence[Line]
    x_title: str = ""
    unit: str = ""
    logarithmic: bool = True
    marks: Mapping[float, str] = field(default_factory=dict)


def ink(number: int) -> str:
    """Return the variable of the colour of a method."""
    return list(INKS)[number % len(INKS)]


def chart(panels: Sequence[Panel], salt: str, height_in: float = 2.6) -> str:
    """Return panels above each other, as SVG for the page."""
    from matplotlib.figure import Figure

    with plots.drawing(salt):
        figure = Figure(figsize=(4.4, height_in), layout="constrained")
        figure.patch.set_alpha(0.0)
        rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
        for axes, panel in zip(rows, panels, strict=True):
            _draw(axes, panel)
            axes.label_outer()
        return plots.as_svg(figure, _COLOURS, inside_html=True)


def _draw(axes, panel: Panel) -> None:
    from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

    axes.patch.set_alpha(0.0)
    axes.set_title(panel.title, loc="left", fontsize=9)
    for line in panel.lines:
        style = {"color": _COLOURS[line.ink], "lw": line.width, "ls": _DASHES if line.dashed else "-"}
        if line.low is None:
            axes.plot(line.x, line.y, marker="o" if len(line.x) == 1 else "", ms=3.5, **style)
        else:
            around = np.abs(np.subtract([line.low, line.high], line.y))
            axes.errorbar(line.x, line.y, around, marker="o", ms=3.5, capsize=2, elinewidth=0.9, **style)
    heights = np.concatenate([np.asarray(line.y, dtype=float) for line in panel.lines] or [np.zeros(0)])
    if panel.logarithmic and (heights > 0).any():
        axes.set_yscale("log")
        _few_marks(axes.yaxis, heights[heights > 0])
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}{panel.unit}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    if panel.marks:
        axes.set_xticks(list(panel.marks), panel.marks.values())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.set_xlabel(panel.x_title)
    axes.grid(color=plots.LINE[1], lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(which="minor", length=0)


def _few_marks(axis_, values: np.ndarray) -> None:
    """Mark a logarithmic axis with a handful of numbers, whatever its range."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    decades = np.log10(values.max() / values.min())
    if decades < 0.5:
        axis_.set_major_locator(MaxNLocator(5))
    else:
        axis_.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2 else (1.0,), numticks=7))


def spectra(rows: Sequence[tuple[str, str, np.ndarray]], true_hz: np.ndarray, salt: str) -> str:
    """Return spectra below each other on one axis, as SVG: each a name, the variable of its colour, frequencies in Hz.

    The axis reaches an octave beyond the true frequencies; what lies outside is not drawn.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator, NullLocator

    low, high = axis(float(true_hz.min()) / 1.5, float(true_hz.max()) * 1.5)
    with plots.drawing(salt):
        figure = Figure(figsize=(6.4, 0.55 + 0.3 * len(rows)), layout="constrained")
        figure.patch.set_alpha(0.0)
        axes = figure.subplots()
        axes.patch.set_alpha(0.0)
        axes.eventplot(
            [hz[(hz > low) & (hz < high)] for _, _, hz in rows],
            lineoffsets=-np.arange(len(rows)),
            linelengths=0.72,
            linewidths=0.9,
            colors=[_COLOURS[one] for _, one, _ in rows],
        )
        axes.set_xscale("log")
        axes.set_xlim(low, high)
        shown = ticks(low, high)
        axes.xaxis.set_major_locator(FixedLocator(shown))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(shown, [f"{hz / 1000:g} kHz" if hz >= 1000 else f"{hz:g} Hz" for hz in shown])
        axes.set_yticks(-np.arange(len(rows)), [name for name, _, _ in rows])
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color=plots.LINE[1], lw=0.6)
        axes.set_axisbelow(True)
        return plots.as_svg(figure, _COLOURS, inside_html=True)


def axis(lowest_hz: float, highest_hz: float) -> tuple[float, float]:
    """Return the ends in Hz of a logarithmic frequency axis, with an eighth of a decade of margin on both sides."""
    return float(f"{lowest_hz / 1.33:.3g}"), float(f"{highest_hz * 1.33:.3g}")


def ticks(low_hz: float, high_hz: float) -> list[float]:
    """Return the multiples 1, 2 and 5 of every power of ten between two frequencies in Hz."""
    decades = range(math.floor(math.log10(low_hz)), math.ceil(math.log10(high_hz)) + 1)
    found = [step * 10**decade for decade in decades for step in (1, 2, 5)]
    return [hz for hz in found if low_hz <= hz <= high_hz]
