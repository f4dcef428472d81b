"""Stage ``report``: the dataset's index and the data of its objects on the page in, the page out.

The records and thumbnails of the objects lie beside the page, where ``page_object`` wrote them; the rule lists them for
Snakemake. The page's own files go into a folder that is named by a hash of their content. The folder of the previous
page stays until the new page is in place. What the run took lies in a file of its own, so that all others have the same
bytes in every run.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from vibraverse.contract import journal, products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write the page's own files, then the page."""
    from vibraverse.contract.errors import UsageError
    from vibraverse.dataset.read.index import read_index
    from vibraverse.report import assembly
    from vibraverse.report.facts import facts, times
    from vibraverse.report.index import index, pictured
    from vibraverse.report.packing import call

    page, record = job.final["page"], products.read_json(job.inputs["record"])
    try:
        dataset = read_index(job.inputs["index"], ())
        objects = list(dataset.shard_of)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"report: {job.inputs['index']} is not the index.h5 of a dataset: {error}; run the workflow again"
        ) from None
    shown = page.parent / "data/objects"
    costs = _costs(job.options.results, objects) if job.options.kind == "run" else {}
    rows = dataset.items.rows()
    found = index(rows, dataset.refusals, _records(shown, objects), list(record["materials"]))
    learning = os.path.relpath(job.inputs["learning"], page.parent) if "learning" in job.inputs else ""
    data = {
        **facts(record, job.options),
        **found,
        "validation": _validation(job),
    }
    named = pictured(found)
    try:
        files = assembly.files(data, _thumbnails(shown, named))
    except ValueError as error:
        damaged = shown / f"{named[error.args[0]]}.thumb.webp"
        raise UsageError(
            f"report: {damaged} is not a picture; delete it and run the workflow again"
        ) from error
    parent = page.parent / "page"
    folder = write_assets(parent, files)
    job.afterwards += [
        lambda: remove_others(parent, folder),
        lambda: shutil.rmtree(page.parent / "assets", ignore_errors=True),  # of the page before version 7
    ]
    text = assembly.html(job.options.title, job.options.kind, f"{parent.name}/{folder}", files, learning)
    job.outputs["times"].write_text(call("vibraverse.times", times(costs)), encoding="ascii")
    job.outputs["page"].write_text(text, encoding="utf-8")


def _records(folder: Path, objects: list[str]) -> dict[str, dict]:
    """Return the records of the objects that the page can show."""
    from vibraverse.contract.errors import UsageError

    found = {}
    for object_id in objects:
        path = folder / f"{object_id}.json"
        try:
            found[object_id] = products.read_json(path)
        except FileNotFoundError:
            continue  # the data of the page were not made
        except ValueError as error:
            raise UsageError(
                f"report: {path} is damaged: {error}; delete it and run the workflow again"
            ) from None
    return found


def _thumbnails(folder: Path, objects: list[str]) -> Iterator[bytes]:
    from vibraverse.contract.errors import UsageError

    for object_id in objects:
        path = folder / f"{object_id}.thumb.webp"
        try:
            yield path.read_bytes()
        except FileNotFoundError:
            raise UsageError(
                f"report: {path} does not exist, and its record does; delete the record and run the workflow again"
            ) from None


def _validation(job: Job) -> dict | None:
    if "validation" not in job.inputs:
        return None
    record = products.read_json(job.inputs["validation"])
    return {name: record[name] for name in ("missed", "bodies")}


def _costs(results: str, objects: list[str]) -> dict[str, dict[str, float]]:
    """Return the CPU seconds of each object by stage, from the journal; jobs that passed on a refusal do not count."""
    found: dict[str, dict[str, float]] = {}
    for object_id in sorted(journal.names(results) & set(objects)):
        of_stages: dict[str, float] = {}
        for one in journal.ended(results, object_id).values():
            if one.outcome != journal.PASSED_ON:
                of_stages[one.stage] = of_stages.get(one.stage, 0.0) + one.cpu_s
        found[object_id] = of_stages
    return found


def write_assets(parent: Path, assets: dict[str, bytes]) -> str:
    """Write files into a folder of ``parent`` named by a hash of their content; return the folder's name.

    A folder that already holds them is left untouched, because an open page may use it.
    """
    final = parent / _name(assets)
    if final.is_dir() and _name(_read(final)) == final.name:
        return final.name
    with products.whole(final) as partial:
        partial.mkdir()
        for name, content in assets.items():
            path = partial / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return final.name


def remove_others(parent: Path, kept: str) -> None:
    """Remove the folders of other pages, and the partial folders of killed runs."""
    for other in parent.iterdir():
        if other.name != kept:
            shutil.rmtree(other)


def _name(assets: dict[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name, content in sorted(assets.items()):
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()[:12]


def _read(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }
