"""Plot of errors against unknowns, one panel per body, as SVG that follows the colours of its page."""

from __future__ import annotations

import math

from vibraverse.media import plots

#: Order -> the page's colour variable, the default colour, and the marker.
_STYLES = {"P1": ("--hollow", "#ad5212", "s"), "P2": ("--solid", "#0f7173", "o")}
_MAX_COLUMNS = 4


def svg(bodies: dict[str, dict]) -> str:
    """Return the plot of ``bodies`` as SVG.

    Each body has a ``title`` and a ``convergence`` as of :func:`~vibraverse.validation.table.convergence`.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    with plots.drawing("validation"):
        across = min(_MAX_COLUMNS, len(bodies))
        down = math.ceil(len(bodies) / across)
        figure = Figure(figsize=(2.9 * across, 2.6 * down), layout="constrained")
        figure.patch.set_alpha(0.0)
        panels = figure.subplots(down, across, sharex=True, squeeze=False).ravel()
        for panel, body in zip(panels, bodies.values(), strict=False):
            panel.patch.set_alpha(0.0)
            panel.set_title(body["title"], loc="left", fontsize=10)
            for kind, curve in body["convergence"].items():
                order, _, corrected = kind.partition(" ")
                _, colour, marker = _STYLES[order]
                panel.loglog(
                    curve["unknowns"],
                    [100 * error for error in curve["errors"]],
                    label=kind,
                    color=colour,
                    marker=marker,
                    ms=4,
                    lw=1.5,
                    ls="-" if corrected else (0, (1.5, 1.5)),
                )
                if curve["slope"] is not None:
                    panel.annotate(
                        f"{curve['slope']:.2f}".replace("-", "−"),
                        (curve["unknowns"][-1], 100 * curve["errors"][-1]),
                        (7, 0),
                        textcoords="offset points",
                        va="center",
                        color=colour,
                    )
            panel.margins(x=0.22)
            panel.grid(color=plots.LINE[1], lw=0.6)
            panel.spines[["top", "right"]].set_visible(False)
            panel.yaxis.set_major_locator(LogLocator(numticks=6))
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_minor_formatter(NullFormatter())
            panel.yaxis.set_major_formatter(lambda value, _: f"{value:g} %")
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
            panel.tick_params(which="minor", length=0)
            panel.tick_params(labelbottom=True)
        for panel in panels[len(bodies) :]:
            panel.set_visible(False)
        curves = {line.get_label(): line for panel in panels for line in panel.get_lines()}
        figure.legend(curves.values(), curves, loc="outside upper left", ncols=4, frameon=False)
        figure.supxlabel("unknowns", fontsize=9)
        figure.supylabel("error of the frequencies", fontsize=9)
        return plots.as_svg(figure, dict(style[:2] for style in _STYLES.values()))
