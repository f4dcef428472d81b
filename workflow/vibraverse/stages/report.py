"""Stage ``report``: the dataset in, a page with its pictures and sounds in a folder beside it out.

The folder of pictures and sounds is named by a hash of their content, so a page never shows those of another. The
folder of the previous page stays until the new page is in place.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

from vibraverse.contract import products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write pictures and sounds, then the page."""
    from vibraverse.contract.errors import UsageError
    from vibraverse.dataset.read.index import read_index
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.dataset.write.summary import warnings
    from vibraverse.report import render

    record = products.read_json(job.inputs["record"])
    try:
        index = read_index(job.inputs["index"], job.inputs["shards"])
    except (OSError, ValueError) as error:
        raise UsageError(
            f"report: {job.inputs['index']} is not the index.h5 of a dataset: {error}; run the workflow again"
        ) from None
    with Reader(index) as reader:
        cards, assets = render.gather(reader, job.options.max_objects)
        warned, refusals = warnings(reader), reader.refusals
    parent = job.final["page"].parent / "assets"
    folder = write_assets(parent, assets)
    job.afterwards.append(lambda: remove_others(parent, folder))
    validation = products.read_json(job.inputs["validation"]) if "validation" in job.inputs else None
    learning = (
        os.path.relpath(job.inputs["learning"], job.final["page"].parent) if "learning" in job.inputs else ""
    )
    page = render.html(
        job.options.title, record, refusals, cards, f"assets/{folder}", validation, warned, learning
    )
    job.outputs["page"].write_text(page, encoding="utf-8")


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
