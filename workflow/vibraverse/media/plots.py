"""Plots as SVG that follow the colours of the page they lie in.

matplotlib writes plain colours. :func:`as_svg` puts the page's colour variables before them, so a plot follows the
page's theme, and keeps its own colours as a file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The page's variables of texts and of lines, each with the colour that stands for it in the plot.
TEXT, LINE = ("--soft", "#63656f"), ("--line", "#e5e3dd")
#: Additions by matplotlib: metadata, and a style rule that would apply to the whole page.
_MATPLOTLIB_EXTRAS = re.compile(r"<metadata>.*?</metadata>|<style .*?</style>", re.DOTALL)


@contextmanager
def drawing(salt: str) -> Iterator[None]:
    """Draw and write figures with the settings of all plots.

    Texts stay texts, and dollar signs in names are no formulas. ``salt`` makes the ids within the SVG; two plots on
    one page need different ones.
    """
    import matplotlib

    settings = {
        "svg.fonttype": "none",
        "svg.hashsalt": salt,
        "text.parse_math": False,
        "font.size": 9,
        "axes.edgecolor": LINE[1],
        "text.color": TEXT[1],
        "xtick.color": TEXT[1],
        "ytick.color": TEXT[1],
        "axes.labelcolor": TEXT[1],
    }
    with matplotlib.rc_context(settings):
        yield


def as_svg(figure: Figure, colours: Mapping[str, str], inside_html: bool = False) -> str:
    """Return a figure as SVG; ``colours`` maps variables of the page to the colours drawn for them.

    With ``inside_html`` the namespaces are left out, which HTML does not need, and so are the ids that nothing refers
    to, which several plots on a page would share.
    """
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    for variable, colour in (*colours.items(), TEXT, LINE):
        text = text.replace(f": {colour}", f": var({variable}, {colour})")
    text = _MATPLOTLIB_EXTRAS.sub("", text[text.index("<svg") :])
    if not inside_html:
        return text
    referred = set(re.findall(r"#([\w.-]+)", text))
    text = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in referred else "", text)
    return re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
