"""The files of the page: its shell, own scripts and styles, the index, and the sheets of thumbnails.

All but the shell lie in one folder, whose name the shell states. So it is the shell alone that turns an old page into a
new one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from vibraverse.report import library, shell
from vibraverse.report.packing import call
from vibraverse.report.sheets import sheets

#: Styles and scripts in the order in which the shell names them; all lie in this room.
STYLES = ("style.css", "page/shell.css", "page/explorer.css", "page/object.css")
SCRIPTS = (
    "shared.js",
    *(f"page/{name}" for name in library.SCRIPTS),
    "page/catalogue.js",
    "page/plots.js",
    "page/grid.js",
    "page/explore.js",
    "page/overview.js",
    "page/run.js",
    "page/main.js",
)
#: Name of the library's file; there is none where it could not be fetched.
_LIBRARY = "three.js"
#: The views that the head links, by kind of page; the first one opens.
VIEWS = {
    "run": (("overview", "Overview"), ("explore", "Explore"), ("run", "Run")),
    "dataset": (("explore", "Explore"), ("overview", "About"), ("run", "How it was made")),
}


def files(data: Mapping, thumbs: Iterable[bytes]) -> dict[str, bytes]:
    """Return the files of the page by name; ``data`` is its index, ``thumbs`` are the thumbnails it numbers."""
    found = {_name(path): library.small(path).encode() for path in (*STYLES, *SCRIPTS)}
    if bundle := library.bundle():
        found[_LIBRARY] = bundle.encode()
    found["index.js"] = call("vibraverse.index", data).encode("ascii")
    found.update((f"thumbs-{number}.webp", sheet) for number, sheet in enumerate(sheets(thumbs)))
    return found


def html(title: str, kind: str, place: str, named: Iterable[str], learning: str = "") -> str:
    """Return the shell.

    ``place`` is the folder of the files ``named``, ``learning`` is the page of learning, both relative to it.
    """
    library_first = [_LIBRARY] if _LIBRARY in named else []
    return shell.fill(
        "explorer.html",
        title=title,
        kind=kind,
        folder=place,
        learning=learning,
        views=VIEWS[kind],
        styles=[_name(path) for path in STYLES],
        scripts=[*library_first, *map(_name, SCRIPTS)],
    )


def _name(path: str) -> str:
    return path.rpartition("/")[2]
