"""The dataset's card: its content, licences, limits, citation and how to rebuild it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from vibraverse import __version__
from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.split.assignment import emptiness

_READ = """\
```python
import vibraverse.dataset

with vibraverse.dataset.open("{folder}") as reader:
    for sample in reader.where(split="train", material="{material}"):
        print(sample["object"], sample["solidity"], sample["frequencies_hz"][0])
```"""
#: Limits that a user should know before trusting a number, for all objects.
LIMITS = (
    "Sounds are the motion of the modes, not the radiated sound: how well a mode moves the air, the striker's hardness "
    "and the room are not in them.",
    "Bodies are free, homogeneous, linear and isotropic, and damped after Rayleigh; real ceramics and woods are not.",
    "Sizes of objects whose source states none are the default; `size_origin` says so for each.",
    "Frequencies carry the errors stated per mode: `relative_error` by the basis, `discretisation_error` by the "
    "elements. Thin walls, and hollow bodies more than solid ones, have the larger ones.",
    "Hollow bodies have a wall of even thickness by construction; their meshes have more surface than solid ones, and "
    "statistics of the meshes give solidity away: use sounds and pictures to learn it.",
    "Splits keep copies of one shape together within tolerances (`splits.tsv`); similar shapes of one family may stand "
    "on both sides.",
)
_UNITS = {
    "size_m": "m",
    "volume_m3": "m³",
    "mass_kg": "kg",
    "f1_hz": "Hz",
    "f_last_hz": "Hz",
    "duration_s": "s",
}
_NAMES = {
    "size_m": "longest side", "volume_m3": "volume", "mass_kg": "mass", "tetrahedra": "tetrahedra",
    "f1_hz": "lowest frequency", "f_last_hz": "highest frequency kept", "duration_s": "length of a sound",
}  # fmt: skip
_MATERIAL_HEADINGS = ("ρ kg/m³", "E Pa", "ν", "α 1/s", "β s")


def card(record: dict, options, attributions: Iterable[str], sheet: str) -> str:
    """Return the README of a dataset, Markdown.

    ``record`` is the content of ``dataset.json``, ``options`` the section ``dataset.card`` of the configuration.
    ``attributions`` are those that the sources' licences ask for. ``sheet`` is the overview picture ("" for none).
    """
    counts = record["counts"]
    sections = [f"# {options.name}", options.description]
    if sheet:
        sections.append(f"![Some of the objects]({sheet})")
    sections += [
        "## What it holds",
        _table(("what", "count"), [(name.replace("_", " "), f"{count:,}") for name, count in counts.items()]),
        "An item is one material of one body of one object; a sampled material is stored as a row of arrays.",
        _counts("split", record["objects_by_split"]),
        emptiness(record["objects_by_split"]),
        f"{record['copies']['copies']:,} of the objects are copies of another's shape and stand on its side.",
        "## Sources and licences",
        _counts("source", record["objects_by_origin"]),
        _counts("licence of the source", record["objects_by_licence"]),
        _counts("category", record["objects_by_category"]),
    ]
    named = sorted(set(attributions) - {""})
    if named:
        sections += ["The licences ask to name:", "\n".join(f"- {name}" for name in named)]
    sections += [
        "## Materials",
        _table(
            ("material", *_MATERIAL_HEADINGS),
            [
                (name, *(f"{value:.4g}" for value in row.values()))
                for name, row in record["materials"].items()
            ],
        ),
        "## Ranges",
        _table(
            ("quantity", "unit", "least", "most"),
            [
                (_NAMES[name], _UNITS.get(name, "1"), f"{found['min']:.4g}", f"{found['max']:.4g}")
                for name, found in record["ranges"].items()
            ],
        ),
        "## Read it",
        _READ.format(folder=".", material=next(iter(record["materials"]), "steel")),
        "Every array has its unit as an attribute; `index.tsv` has a row per item, `splits.tsv` per object, "
        "`refusals.tsv` per refusal, `dataset.json` the SHA-256 of every shard and how each stage was run.",
        "## Known limits",
        "\n".join(f"- {limit}" for limit in LIMITS),
        f"- {counts['refused_objects']:,} objects and {counts['refused_bodies']:,} bodies more were refused: "
        f"{_listed(record['refusals_by_reason'])}.",
        "## Cite it",
        f"> {cite(options)}",
        "## Rebuild it",
        f"With VibraVerse {__version__} and the configuration of the run: `snakemake --configfile config.yaml`. Seeds "
        "come from the objects' ids, so the same sources give the same bytes on the same kind of processor. The stages "
        "were:",
        _table(
            ("stage", "version", "options"),
            [
                (stage, str(how["stage_version"]), f"`{json.dumps(how['options'], ensure_ascii=False)}`")
                for stage, how in record["made_by"].items()
            ],
        ),
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def cite(options) -> str:
    """Return how to cite the dataset."""
    when = f" ({options.published[:4]})" if options.published else ""
    where = f" {options.url}" if options.url else ""
    version = f", version {options.version}" if options.version else ""
    return f"{', '.join(options.creators)}{when}: {options.name}{version}. Made with VibraVerse {__version__}.{where}"


def licences(record: dict, options) -> list[str]:
    """Return the licence that the configuration states, else those of the sources."""
    return [options.licence] if options.licence else list(record["objects_by_licence"])


def export_card(reader: Reader, kind: str, folder: Path, files: Iterable[Path]) -> str:
    """Return the README of an export; ``datasets.load_dataset(folder)`` reads the splits from its header."""
    names = [path.relative_to(folder).as_posix() for path in files]
    splits = [split or "all" for split in reader.items.column("split").present()]
    tables = [name for name in names if name.startswith("data/")]
    lines = []
    if tables:
        lines = ["---", "configs:", "- config_name: default", "  data_files:"]
        for split in splits:
            lines += [f"  - split: {split}", f"    path: data/{split}-*.parquet"]
        lines += ["---", ""]
    how = (
        f"datasets.load_dataset(this folder): splits {', '.join(splits)}; `sound` plays, `views` shows."
        if kind == "huggingface"
        else "webdataset.WebDataset(files).decode(): json, arrays as npy, the sound as wav, pictures as png."
    )
    found = sorted(reader.items.column("licence").present())
    lines += [
        "# Exported from a VibraVerse dataset", "",
        f"{len(reader):,} items of {len(reader.objects):,} objects. {how}", "",
        f"Licences of the sources: {', '.join(found)}. Fields, units and shapes: `docs/dataset.md` of VibraVerse "
        f"{__version__}.",
        "", f"Fields: {', '.join(f'`{name}`' for name in reader.fields)}. Checksums: `export.json`.",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def overview(reader: Reader, most: int = 24, side: int = 128) -> bytes:
    """Return a PNG file with the first views of some objects; one white tile without objects."""
    import io

    from PIL import Image

    step = max(1, -(-len(reader.objects) // most))
    tiles = []
    for object_id in reader.objects[::step][:most]:
        views = reader.group(object_id).get("views") or {}
        look = reader.look if reader.look in views else next(iter(views), None)
        if look and len(views[look]):
            picture = Image.open(io.BytesIO(views[look][0].tobytes())).convert("RGB")
            tiles.append(picture.resize((side, side), Image.Resampling.LANCZOS))
    across = min(8, max(1, len(tiles)))
    sheet = Image.new("RGB", (side * across, side * max(1, -(-len(tiles) // across))), "white")
    for number, tile in enumerate(tiles):
        sheet.paste(tile, (side * (number % across), side * (number // across)))
    file = io.BytesIO()
    sheet.save(file, format="PNG")
    return file.getvalue()


def _counts(what: str, found: dict[str, int]) -> str:
    return _table((what, "objects"), [(name or "not stated", f"{count:,}") for name, count in found.items()])


def _listed(found: dict[str, int]) -> str:
    return ", ".join(f"{count:,} {reason}" for reason, count in found.items()) or "nothing"


def _table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(headings)} |", "|" + len(headings) * " --- |"]
    lines += [f"| {' | '.join(cell.replace('|', '/') for cell in row)} |" for row in rows]
    return "\n".join(lines) if rows else ""
