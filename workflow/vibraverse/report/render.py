"""The page as HTML: a template filled from the dataset. The page needs no network."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from markupsafe import Markup

from vibraverse.contract.refusal import REASONS
from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.split.assignment import emptiness
from vibraverse.dataset.write.summary import WARNINGS
from vibraverse.flow.steps import VERSIONS
from vibraverse.report import shell
from vibraverse.report.content import Card, card
from vibraverse.validation import plot

#: The look of the cover picture, if the dataset has it.
_COVER_LOOK = "clay"
#: Warnings that are listed per kind.
_SHOWN_WARNINGS = 20


def gather(reader: Reader, max_objects: int) -> tuple[list[Card], dict[str, bytes]]:
    """Return the cards of the first ``max_objects`` objects, and their pictures and sounds by file name."""
    assets: dict[str, bytes] = {}
    return [card(reader, object_id, assets) for object_id in reader.objects[:max_objects]], assets


def html(
    title: str,
    record: dict,
    refusals: list[dict],
    cards: list[Card],
    assets_folder: str,
    validation: dict | None = None,
    warnings: Sequence[dict] = (),
    learning: str = "",
) -> str:
    """Return the page.

    ``record`` is the content of ``dataset.json``, ``refusals`` are the rows of ``refusals.tsv``. ``assets_folder`` is
    the folder of pictures and sounds, relative to the page. ``validation`` is the content of ``validation.json``.
    ``warnings`` are those of :func:`vibraverse.dataset.write.summary.warnings`. ``learning`` is the page of learning,
    relative to this one; "" where there is none.
    """
    return shell.fill(
        "page.html",
        title=title,
        script=Markup(shell.text("page.js")),
        data=Markup(_data(record, cards, assets_folder)),
        assets=assets_folder,
        counts=record["counts"],
        sounds=record["counts"]["sounds"] - record["counts"]["sampled_sounds"],
        materials=record["materials"],
        splits=record["objects_by_split"],
        empty_splits=emptiness(record["objects_by_split"]),
        shards=record["shards"],
        stages={name: _flattened(record["made_by"][name]) for name in VERSIONS if name in record["made_by"]},
        families=sorted({one.facts["category"] for one in cards if one.facts["category"]}),
        cards=[_with_cover(one) for one in cards],
        more=record["counts"]["objects"] - len(cards),
        refusals=_grouped(refusals, "reason", REASONS),
        warnings=_grouped(warnings, "kind", WARNINGS),
        warned=len({row["object"] for row in warnings}),
        most=_SHOWN_WARNINGS,
        learning=learning,
        validation=validation,
        convergence=Markup(plot.svg(validation["bodies"], inside_html=True)) if validation else "",
    )


def _with_cover(one: Card) -> dict:
    look = _COVER_LOOK if _COVER_LOOK in one.pictures else next(iter(one.pictures), "")
    counts = [len(body[0]) for bodies in one.modes.values() for body in bodies.values()]
    return {
        **vars(one),
        "look": look,
        "cover": one.pictures[look][0] if look else "",
        "mode_count": max(counts, default=0),
    }


def _data(record: dict, cards: list[Card], assets_folder: str) -> str:
    """Return the JSON that the page's script reads; ``</`` is escaped so that no text can end the script early."""
    ranges = record["ranges"]
    low, high = axis(ranges["f1_hz"]["min"], ranges["f_last_hz"]["max"]) if ranges else (20.0, 20_000.0)
    value = {
        "assets": assets_folder,
        "materials": list(record["materials"]),
        "range_hz": [low, high],
        "ticks_hz": ticks(low, high),
        "objects": {one.object: {"pictures": one.pictures, "modes": one.modes} for one in cards},
    }
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")


def axis(lowest_hz: float, highest_hz: float) -> tuple[float, float]:
    """Return the ends in Hz of a logarithmic frequency axis, with an eighth of a decade of margin on both sides."""
    return float(f"{lowest_hz / 1.33:.3g}"), float(f"{highest_hz * 1.33:.3g}")


def ticks(low_hz: float, high_hz: float) -> list[float]:
    """Return the multiples 1, 2 and 5 of every power of ten between two frequencies in Hz."""
    decades = range(math.floor(math.log10(low_hz)), math.ceil(math.log10(high_hz)) + 1)
    found = [step * 10**decade for decade in decades for step in (1, 2, 5)]
    return [hz for hz in found if low_hz <= hz <= high_hz]


def _grouped(rows: Sequence[dict], by: str, sentences: dict[str, str]) -> list[dict]:
    """Return rows in groups, each with its sentence, most frequent first."""
    groups: dict[str, list[dict]] = {}
    for row in rows:
        groups.setdefault(row[by], []).append(row)
    ordered = sorted(groups.items(), key=lambda item: (-len(item[1]), item[0]))
    return [{"sentence": sentences[name], "rows": members} for name, members in ordered]


def _flattened(made_by: dict) -> dict:
    """Return a stage's provenance with nested options as flat pairs; materials have a table of their own."""
    options = made_by["options"]
    if isinstance(options, dict):
        options = {key: value for key, value in options.items() if key != "materials"}
    return {**made_by, "options": list(_flat(options)), "libraries": list(_flat(made_by["libraries"]))}


def _flat(value, key: str = ""):
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else name)
    else:
        yield key, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
