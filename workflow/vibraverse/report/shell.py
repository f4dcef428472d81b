"""What all pages share: their style, scripts and templates, and numbers as people read them."""

from __future__ import annotations

from importlib import resources

import jinja2
from markupsafe import Markup

from vibraverse import __version__
from vibraverse.report import quantities


def text(name: str) -> str:
    """Return a file of this room: a template, a style, a script."""
    return resources.files("vibraverse.report").joinpath(name).read_text(encoding="utf-8")


def fill(template: str, **values) -> str:
    """Return a page: a template, filled with values. Texts are escaped; the page needs no network."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(text),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    environment.filters.update(
        {
            "count": "{:,}".format,
            "number": quantities.number,
            "length_text": quantities.length,
            "volume_text": quantities.volume,
            "mass_text": quantities.mass,
            "frequency_text": quantities.frequency,
            "duration_text": quantities.duration,
            "file_size_text": quantities.file_size,
        }
    )
    return environment.get_template(template).render(
        version=__version__, style=Markup(text("style.css")), shared=Markup(text("shared.js")), **values
    )
