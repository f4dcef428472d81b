"""One object in one HTML file: the view of the page with its style, scripts and data inside."""

from __future__ import annotations

import json

from markupsafe import Markup

from vibraverse.report import shell
from vibraverse.report.library import SCRIPTS, bundle, small


def html(
    object_id: str, title: str, data: list[str], address: str = "#/object", library: str | None = None
) -> str:
    """Return the file of an object.

    ``data`` are the scripts that hold the object and its bodies. ``address`` is what the file shows when it is opened
    without one. ``library`` is the bundle with which models are shown, by default the environment's own; "" or an
    environment without one gives pictures.
    """
    library = bundle() if library is None else library
    scripts = [*([library] if library else []), small("shared.js")]
    scripts += [small(f"page/{name}") for name in SCRIPTS]
    inside = [Markup(one.replace("</script", "<\\/script")) for one in (*scripts, *data)]
    own = Markup(small("page/object.css"))
    said = Markup(json.dumps(address).replace("</", "<\\/"))
    return shell.fill(
        "strike.html", object=object_id, title=title, own_style=own, scripts=inside, address=said
    )
