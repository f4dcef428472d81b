"""``vibraverse export``: the dataset as WebDataset tars, or as a folder that ``datasets.load_dataset`` opens."""

from __future__ import annotations

import argparse
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

from vibraverse.contract.errors import UsageError
from vibraverse.contract.products import aside, storing

#: Nearest numbers of a column that a message names for one that occurs in no item.
_SHOWN_NEAREST = 5


def main(argv: list[str]) -> int:
    """Write the export, a README beside it and ``export.json`` with the checksums of its files."""
    parser = argparse.ArgumentParser(
        prog="vibraverse export",
        description="Write a dataset in a form other programs read. Items are one per object, solidity and material.",
    )
    parser.add_argument("dataset", help="the dataset's folder, such as results/dataset, or a shard")
    parser.add_argument("--format", required=True, choices=("webdataset", "huggingface"))
    parser.add_argument("-o", "--output", required=True, type=Path, help="a folder that is new or empty")
    parser.add_argument(
        "--fields", help="what an item holds, separated by commas (docs/dataset.md lists them)"
    )
    parser.add_argument(
        "--where",
        nargs="+",
        default=[],
        metavar="COLUMN=VALUE",
        help="only items of these (A,B, or the column again: either)",
    )
    parser.add_argument(
        "--look", default="clay", help="look of the pictures; 'material' is that of the item's"
    )
    parser.add_argument("--sampled", action="store_true", help="the sampled materials too")
    parser.add_argument("--max-mb", type=float, default=500.0, help="largest size of a file (default 500)")
    chosen = parser.parse_args(argv)
    if chosen.max_mb <= 0:
        raise UsageError(f"export: --max-mb must be greater than 0, not {chosen.max_mb:g}")
    if chosen.output.exists() and (not chosen.output.is_dir() or any(chosen.output.iterdir())):
        raise UsageError(f"export: {chosen.output} is not empty; name a new folder")
    if chosen.output.resolve() == Path.cwd():
        raise UsageError(
            f"export: {chosen.output} is the working folder and cannot be replaced; name a new folder"
        )
    _export(chosen)
    return 0


def _export(chosen) -> None:
    import vibraverse.dataset
    from vibraverse.contract.products import write_json, write_text
    from vibraverse.dataset.publish import export
    from vibraverse.dataset.publish.card import export_card
    from vibraverse.dataset.publish.huggingface import huggingface

    fields = chosen.fields.split(",") if chosen.fields else export.EXPORTED
    try:
        with vibraverse.dataset.open(chosen.dataset, fields, chosen.look) as whole:
            conditions = _conditions(chosen.where)
            reader = whole.where(**conditions)
            _check_values(chosen.dataset, whole, conditions)
            reader = reader.with_sampled() if chosen.sampled else reader
            if not len(reader):
                raise UsageError(
                    f"export: no item of {chosen.dataset} matches --where {' '.join(chosen.where)}: each value occurs, "
                    "but not together; leave out one condition"
                )
            with _new_folder(chosen.output) as folder:
                most = int(chosen.max_mb * 2**20)
                if chosen.format == "webdataset":
                    files = export.webdataset(reader, folder, most)
                else:
                    files = huggingface(reader, folder, most)
                write_text(folder / "README.md", export_card(reader, chosen.format, folder, files))
                record = {"format": chosen.format, "items": len(reader), "fields": list(fields)}
                write_json(folder / "export.json", {**record, "files": export.checksums(folder, files)})
    except (FileNotFoundError, KeyError, export.CannotExport) as error:
        raise UsageError(f"export: {error.args[0] if error.args else error}") from None
    print(f"{record['items']} items in {len(files)} files: {chosen.output}")


@contextmanager
def _new_folder(final: Path):
    """Yield a folder beside ``final``; rename it to ``final`` on success, remove it on failure."""
    partial = aside(final)
    with storing(final):
        try:
            partial.mkdir(parents=True)
            yield partial
            if final.exists():
                final.rmdir()  # it is empty
            partial.rename(final)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _conditions(texts: list[str]) -> dict[str, list]:
    from vibraverse.dataset.schema import INDEX_COLUMNS

    found: dict[str, list] = {}
    for text in texts:
        column, equals, values = text.partition("=")
        if not equals:
            raise UsageError(f"export: --where takes COLUMN=VALUE, not {text!r}")
        kind = INDEX_COLUMNS[column][0] if column in INDEX_COLUMNS else str
        try:
            found.setdefault(column, []).extend(map(kind, values.split(",")))
        except ValueError:
            raise UsageError(f"export: --where {column} must be a number, not {values!r}") from None
    return found


def _check_values(dataset: str, reader, conditions: dict[str, list]) -> None:
    """Raise :class:`UsageError` if no value of a column's condition occurs; warn about single ones that do not."""
    for column, values in conditions.items():
        there = reader.items.values(column)
        absent = [value for value in values if value not in there]
        for value in absent:
            sentence = _absent(column, value, there)
            if len(absent) == len(values):
                raise UsageError(f"export: no item of {dataset} matches --where: {sentence}")
            print(f"vibraverse: export: passed over: {sentence}", file=sys.stderr)


def _absent(column: str, value, there: list) -> str:
    """Return the sentence for a value that no item has in a column, with the values that occur or the nearest."""
    from vibraverse.contract.texts import unknown

    if isinstance(value, str):
        return unknown(column, value, sorted(filter(None, there)))
    near = sorted(there, key=lambda other: abs(other - value))[:_SHOWN_NEAREST]
    return f"{column} is {value} in no item; take one of the nearest values: {', '.join(map(str, near))}"
