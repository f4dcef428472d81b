"""The search for changed products, so that they can be rebuilt.

Every product states the checksums of its inputs and of the outputs written with it; a shard states those of the
products in it. A file that differs from the checksum in a later product has changed since. If it is newer than that
product, nothing is wrong: the next run remakes the later product.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from vibraverse.contract import products
from vibraverse.contract.refusal import read_refusal
from vibraverse.flow.chain import shards_in
from vibraverse.flow.page import PAGE_STEPS
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.flow.steps import BY_NAME
from vibraverse.upkeep.lineage import Made, after, jobs, makers


class Wrong(NamedTuple):
    """A wrong product: its path, the reason, the job that remakes it, and all files and folders to remake.

    For a file that does not belong to the run, ``by`` is empty.
    """

    path: Path
    sentence: str
    by: str
    anew: list[Path]
    object: str = ""


def last_products(paths: Paths, shards: Iterable[Path]) -> list[Path]:
    """Return the existing products that are made from shards, last ones first, and the shards.

    Snakemake looks only at the targets of a run, and remakes nothing as long as they all exist.
    """
    last = (*BY_NAME["report"].outputs.values(), *BY_NAME["index"].outputs.values())
    made = (paths.verdict, *(getattr(paths, output.pattern) for output in last))
    return [path for path in (*map(Path, made), *shards) if path.is_file()]


def in_order(paths: Paths, files: Iterable[Path], objects: Iterable[str]) -> list[Path]:
    """Return these files and the last products that depend on these objects, in the order in which to delete them.

    The last products and the shards come first. Otherwise, after an interruption, Snakemake would find all its targets
    and remake nothing. Files of an object stay in the order of the chain, because later ones show that an earlier one
    is wrong until it is deleted.
    """
    return list(dict.fromkeys([*last_products(paths, shards_of(paths, objects)), *files]))


def shards_of(paths: Paths, objects: Iterable[str]) -> list[Path]:
    """Return the shards that hold any of these objects, and those that cannot be read."""
    wanted, found = set(objects), []
    for shard in shards_in(paths.dataset):
        held = packed_products(shard)
        if held is None or wanted & set(held):
            found.append(shard)
    return found


def wrong_products(paths: Paths, object_id: str, packed: dict[str, str], packed_at: float) -> Iterator[Wrong]:
    """Yield the products of an object that changed after they were made.

    ``packed`` maps products, as paths below the object's folder, to the checksums that its shard states. ``packed_at``
    is the modification time of that shard.
    """
    every = jobs(paths, object_id)
    chain = [made for made in every if made.record.is_file() and not read_refusal(made.record)]
    made_by = makers(chain)
    digest = cache(products.sha256)
    reported: set[Made] = set()

    def report(made: Made, path: Path, sentence: str) -> Iterator[Wrong]:
        if made not in reported:
            reported.add(made)
            anew = [place for later in after(made) for place in later.places if place.exists()]
            yield Wrong(path, sentence, str(made), anew, object_id)

    for made in every:
        if made.record.parent in made.places and made.record.parent.is_dir() and not made.record.is_file():
            yield from report(made, made.record, "it is missing")
    for made in chain:
        if not made.provenance:
            yield from report(made, made.record, "its provenance cannot be read")
        for name, stated in made.provenance.get("output_sha256", {}).items():
            for path in made.output(name):
                right = stated.get(path.name) if isinstance(stated, dict) else stated
                if path.is_file() and right is not None and digest(path) != right:
                    yield from report(made, path, f"it is not what {made.step.name} wrote")
                elif made.place(name).is_dir() and not path.is_file():
                    yield from report(made, path, "it is missing")
        for name, right in made.provenance.get("input_sha256", {}).items():
            path = made.input(name) if name in made.step.chained else None
            if path in made_by and _changed(path, right, made.record.stat().st_mtime, digest):
                yield from report(made_by[path], path, f"it is not what {made} was made from")
    folder = Path(paths.at(paths.object, object=object_id))
    for name, right in packed.items():
        path = folder / name
        if path in made_by and _changed(path, right, packed_at, digest):
            yield from report(made_by[path], path, "it is not what its shard was made from")


def wrong_page(paths: Paths, object_id: str) -> Iterator[Wrong]:
    """Yield the data of an object on the page that changed after they were written, by the records beside them.

    No shard holds them, so no object is named that would have its shard made again.
    """
    page_body, page_object = PAGE_STEPS
    last = Made(paths, page_object, object_id)
    read = last.provenance.get("input_sha256", {}).get("page_body_record", {})
    for made in (*(Made(paths, page_body, object_id, one) for one in SOLIDITIES), last):
        if not made.record.is_file() or read_refusal(made.record):
            continue
        anew = [place for place in dict.fromkeys([*made.places, *last.places]) if place.exists()]
        if not made.provenance:
            yield Wrong(made.record, "its provenance cannot be read", str(made), anew)
            continue
        right = read.get(made.record.name)
        if right and _changed(made.record, right, last.record.stat().st_mtime, products.sha256):
            yield Wrong(made.record, f"it is not what {last} was made from", str(made), anew)
            continue
        for name, right in made.provenance.get("output_sha256", {}).items():
            path = made.place(name)
            if path.is_file() and products.sha256(path) != right:
                yield Wrong(path, f"it is not what {made.step.name} wrote", str(made), anew)
                break  # one is enough to make all of them again


def _changed(path: Path, right: str, used_at: float, digest) -> bool:
    return path.is_file() and path.stat().st_mtime <= used_at and digest(path) != right


def packed_products(shard: Path) -> dict[str, dict[str, str]] | None:
    """Return object -> product -> checksum as a shard states them; None if it cannot be read."""
    import h5py

    try:
        with h5py.File(shard) as h5:
            return {
                name: json.loads(group["products"].asstr()[()]) if "products" in group else {}
                for name, group in h5["objects"].items()
            }
    except (OSError, ValueError, LookupError, RuntimeError):
        return None


def wrong_dataset(paths: Paths) -> Iterator[Wrong]:
    """Yield the files of the dataset that changed after they were written, each once."""
    from vibraverse.dataset.check.folder import SHARDS, findings

    seen = set()
    for finding in findings(paths.dataset):
        if finding.file in seen:
            continue
        seen.add(finding.file)
        path, is_shard = Path(paths.dataset) / finding.file, finding.file.startswith(SHARDS)
        if finding.stranger:
            yield Wrong(path, finding.sentence, "", [])
            continue
        sentence = f"{finding.object}: {finding.sentence}" if finding.object else finding.sentence
        files = last_products(paths, [path] if is_shard else [])
        yield Wrong(path, sentence, "dataset" if is_shard else "index", files)
