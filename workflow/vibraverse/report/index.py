"""The index of the page: a short row for every object, refused ones included, and the words that rows share.

``page/catalogue.js`` reads it. A row holds numbers, short texts and codes: places in the lists of ``names``. What
follows from others is not in it: ring times and masses come from frequencies, volumes and materials.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from vibraverse.contract.refusal import REASONS
from vibraverse.dataset.write.summary import WARNINGS
from vibraverse.flow.paths import SOLIDITIES

#: Columns of a row; after them comes one for each solidity, with a body or 0.
COLUMNS = (
    "id", "title", "source", "family", "licence", "split", "size_m", "version", "thumb", "refused",
)  # fmt: skip
#: Numbers of a body; after them comes its lowest frequency in Hz in each material, 0 where it has none. ``warned`` has
#: a bit for each kind of warning, ``last_hz`` is the highest of ``modes`` frequencies in the first material.
BODY = ("volume_m3", "error", "warned", "modes", "last_hz")
#: Columns that hold codes.
CODED = ("source", "family", "licence", "split")
#: Characters of a refusal's message that a row holds; the object's own file holds all.
MESSAGE_LENGTH = 140
#: Warnings that are listed per kind, besides the count.
SHOWN_WARNINGS = 20


class Names:
    """Texts by code: the place of each in the order of their first appearance."""

    def __init__(self):
        self.texts: list[str] = []
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> int:
        """Return the code of a text; a new one gets the next."""
        if text not in self._codes:
            self._codes[text] = len(self.texts)
            self.texts.append(text)
        return self._codes[text]


def index(
    items: Iterable[Mapping],
    refusals: Iterable[Mapping],
    seen: Mapping[str, Mapping],
    materials: Sequence[str],
) -> dict:
    """Return columns, names, rows and warnings of the page's index.

    ``items`` are the rows of the dataset's index, ``refusals`` those of its refusals. ``seen`` are the records of
    ``page_object``: ``row`` with ``version``, what is known of a refused object (``title``, ``source``, ``family``,
    ``licence``) and ``bodies`` with their ``worst_error`` by solidity, and ``warnings`` with ``solidity``, ``kind`` and
    ``text``. An object without a record has neither picture nor sound.
    """
    about, bodies = _gathered(items)
    refused: dict[str, list[Mapping]] = {}
    for one in refusals:
        refused.setdefault(one["object"], []).append(one)
    named = {name for found in bodies.values() for name in found}
    named |= {one["solidity"] for found in refused.values() for one in found}
    solidities = [name for name in SOLIDITIES if name in named]
    names = {name: Names() for name in (*CODED, "stage", "reason", "advice")}
    rows, thumbs = [], 0
    for object_id in sorted(about.keys() | refused.keys()):
        known, record = about.get(object_id, {}), seen.get(object_id, {})
        shown = record.get("row", {})
        texts = {name: known.get(name) or shown.get(name) or "" for name in ("title", *CODED)}
        pictured = bool(shown.get("version")) and object_id in about
        rows.append(
            [
                object_id,
                "" if texts["title"] == object_id else texts["title"],
                *(names[name].code(texts[name]) for name in CODED),
                short(known.get("size_m", 0.0)),
                shown.get("version", ""),
                thumbs if pictured else -1,
                [_refusal(one, names, solidities) for one in refused.get(object_id, ())] or 0,
                *(_body(bodies.get(object_id, {}).get(name), record, name, materials) for name in solidities),
            ]
        )
        thumbs += pictured
    return {
        "columns": [*COLUMNS, *solidities],
        "body": BODY,
        "solidities": solidities,
        "names": {name: found.texts for name, found in names.items()},
        "reasons": {name: REASONS[name] for name in names["reason"].texts},
        "warnings": warnings(seen),
        "rows": rows,
    }


def pictured(index_: Mapping) -> list[str]:
    """Return the objects with a thumbnail, in the order of their places."""
    place = COLUMNS.index("thumb")
    return [row[0] for row in index_["rows"] if row[place] >= 0]


def warnings(seen: Mapping[str, Mapping]) -> list[dict]:
    """Return the warnings by kind, in the order of their bits: how many there are, and the first of them.

    One that an object's bodies share is shown once, without a solidity.
    """
    found: dict[str, list[list[str]]] = {kind: [] for kind in WARNINGS}
    for object_id, record in sorted(seen.items()):
        said: dict[tuple[str, str], list[str]] = {}
        for one in record.get("warnings", ()):
            said.setdefault((one["kind"], one["text"]), []).append(one["solidity"])
        for (kind, text), solidities in said.items():
            found[kind].append([object_id, solidities[0] if len(solidities) == 1 else "", text])
    return [
        {"kind": kind, "sentence": WARNINGS[kind], "count": len(rows), "shown": rows[:SHOWN_WARNINGS]}
        for kind, rows in found.items()
    ]


def short(value: float, digits: int = 3) -> float | int:
    """Return a number rounded to some significant digits; a whole one as an integer, which takes fewer characters."""
    rounded = float(f"{value:.{digits}g}")
    return int(rounded) if rounded.is_integer() else rounded


def _gathered(items: Iterable[Mapping]) -> tuple[dict[str, dict], dict[str, dict[str, dict]]]:
    """Return texts and size of each object, and the numbers of its bodies by solidity, from the items of a dataset."""
    about: dict[str, dict] = {}
    bodies: dict[str, dict[str, dict]] = {}
    for item in items:
        object_id = item["object"]
        if object_id not in about:
            renamed = {"source": item["origin"], "family": item["category"]}
            about[object_id] = {
                **renamed,
                **{key: item[key] for key in ("title", "licence", "split", "size_m")},
            }
        body = bodies.setdefault(object_id, {}).setdefault(
            item["solidity"],
            {"volume_m3": item["volume_m3"], "modes": item["modes"], "f1_hz": {}, "last_hz": {}},
        )
        body["f1_hz"][item["material"]] = item["f1_hz"]
        body["last_hz"][item["material"]] = item["f_last_hz"]
    return about, bodies


def _body(body: Mapping | None, record: Mapping, solidity: str, materials: Sequence[str]) -> list | int:
    if body is None:
        return 0
    kinds = {one["kind"] for one in record.get("warnings", ()) if one["solidity"] == solidity}
    shown = record.get("row", {}).get("bodies", {}).get(solidity, {})
    return [
        short(body["volume_m3"]),
        short(shown.get("worst_error", 0.0), 2),
        sum(1 << bit for bit, kind in enumerate(WARNINGS) if kind in kinds),
        body["modes"],
        short(body["last_hz"].get(materials[0], 0.0), 4),
        *(short(body["f1_hz"].get(name, 0.0), 4) for name in materials),
    ]


def _refusal(one: Mapping, names: Mapping[str, Names], solidities: Sequence[str]) -> list:
    """Return a refusal as codes: 0 for the whole object or 1 and on for a body, reason, stage, message, advice."""
    message = one["message"]
    if len(message) > MESSAGE_LENGTH:
        message = message[:MESSAGE_LENGTH].rsplit(" ", 1)[0] + " …"
    return [
        solidities.index(one["solidity"]) + 1 if one["solidity"] else 0,
        names["reason"].code(one["reason"]),
        names["stage"].code(one["stage"]),
        message,
        names["advice"].code(one["advice"]),
    ]
