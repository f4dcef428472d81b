"""``vibraverse repair``: find products that must be rebuilt, and delete them so that the next run does it."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from vibraverse.commands import run_arguments, run_paths
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import advised, and_more, counted
from vibraverse.flow.chain import objects_in, shards_in
from vibraverse.flow.paths import Paths
from vibraverse.machine import locks
from vibraverse.upkeep.rebuild import in_order, packed_products, wrong_dataset, wrong_page, wrong_products

#: Wrong products that are printed.
_SHOWN_PRODUCTS = 50


def main(argv: list[str]) -> int:
    """Print the wrong products; with ``--delete`` delete them. Return 1 if something wrong is left."""
    parser = argparse.ArgumentParser(
        prog="vibraverse repair",
        parents=[run_arguments()],
        description="Say which products are not as they were made: those of the objects, by the checksums that later "
        "ones state, the dataset's files, as `vibraverse check` does, and the objects' data on the page. Reads "
        "everything once. With --delete these products are deleted, and the next run of the workflow rebuilds them and "
        "what depends on them.",
    )
    parser.add_argument("--delete", action="store_true", help="delete them; run the workflow afterwards")
    chosen = parser.parse_args(argv)
    paths = run_paths(chosen)
    objects, has_dataset = objects_in(paths), Path(paths.dataset_record).is_file()
    if not objects and not has_dataset:
        raise UsageError(
            f"{paths.results} holds no objects and no dataset; give the results folder of a run with --results"
        )
    with locks.only_run(paths.results) if chosen.delete else nullcontext():
        again = advised("repair", "--delete", config=chosen.config, results=chosen.results)
        return _repair(paths, objects, has_dataset, chosen.delete, again)


def _repair(paths: Paths, objects: list[str], has_dataset: bool, delete: bool, again: str) -> int:
    found = _wrong(paths, objects, has_dataset)
    for wrong in found[:_SHOWN_PRODUCTS]:
        by = f"\n    made by {wrong.by}, with {counted(len(wrong.anew), 'product')}" if wrong.by else ""
        print(f"{wrong.path}: {wrong.sentence}{by}")
    for more in and_more(len(found), _SHOWN_PRODUCTS):
        print(more)
    if not found:
        print("Nothing is wrong: every product is what later ones were made from.")
        return 0
    ours = [wrong for wrong in found if wrong.by]
    if not ours:
        return 1
    objects = {wrong.object for wrong in ours if wrong.object}
    gone = in_order(paths, (path for wrong in ours for path in wrong.anew), objects)
    if not delete:
        print(f"{counted(len(gone), 'product')} to rebuild: {again}, then run the workflow.")
        return 1
    for path in gone:
        products.remove(path)
    print(f"Deleted {counted(len(gone), 'product')}; the next run rebuilds them and what depends on them.")
    return int(len(ours) < len(found))


def _wrong(paths: Paths, objects: list[str], has_dataset: bool) -> list:
    found = list(wrong_dataset(paths)) if has_dataset else []
    packed: dict[str, tuple[dict, float]] = {}
    for shard in shards_in(paths.dataset):
        at = shard.stat().st_mtime
        packed.update({name: (held, at) for name, held in (packed_products(shard) or {}).items()})
    for object_id in objects:
        found += wrong_products(paths, object_id, *packed.get(object_id, ({}, 0.0)))
        found += wrong_page(paths, object_id)
    return found
