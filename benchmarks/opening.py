"""What it takes to open a dataset of 800,000 items: rows as dictionaries from the shards' texts, and by column.

    python benchmarks/opening.py [--objects 50000] [--folder FOLDER]

Makes a dataset's folder of indices alone: shards with their texts (index, refusals) and one empty group per object, and
from these, by the library, ``splits.tsv``, ``index.h5``, ``index.parquet`` and ``dataset.json``. No arrays: opening
reads none. Numbers are drawn, so columns pack worse than real ones; a hundredth of the objects is refused. Each side
opens and narrows once, in a process of its own, on warm files; ``import`` is a process that imports and opens nothing,
and the others' memory is above it. ``parquet`` includes the import of pyarrow.
"""

from __future__ import annotations

import argparse
import json
import pickle
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py

import vibraverse.dataset
from vibraverse.dataset import schema
from vibraverse.dataset.read import index as reading
from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.schema.tables import from_tsv, to_tsv

_A_SHARD = 100
_MATERIALS = ("steel", "glass", "wood", "ceramic", "plastic", "aluminium", "brass", "stone")
_SPLITS = ("train", "train", "train", "train", "validation", "test")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", type=int, default=50_000)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--side", choices=SIDES)
    arguments = parser.parse_args()
    if arguments.side:
        print(json.dumps(measured(SIDES[arguments.side], arguments.folder)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        if not (folder / "dataset.json").is_file():
            make(folder, arguments.objects)
        for name in ("index.tsv", "index.h5", "index.parquet"):
            if (folder / name).is_file():
                print(f"{name}: {(folder / name).stat().st_size / 1e6:.1f} MB")
        compare(folder)


def measured(side, folder: Path) -> list[float]:
    """Return seconds to open, seconds to narrow, peak memory in MB up to there, and bytes of the pickled part."""
    start = time.perf_counter()
    narrow = side(folder)
    opened = time.perf_counter()
    part = narrow()
    narrowed = time.perf_counter()
    most = peak_mb()
    return [opened - start, narrowed - opened, most, len(pickle.dumps(part))]


def peak_mb() -> float:
    """Return the most memory that this process held; what getrusage says counts its parent's before it began, too."""
    return int(re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024


def make(folder: Path, objects: int) -> None:
    from vibraverse.contract.products import sha256
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.parquet import write_parquet

    (folder / "shards").mkdir(parents=True)
    draw = random.Random(1)
    splits = []
    for number, first in enumerate(range(0, objects, _A_SHARD)):
        shard = f"{number:05d}.h5"
        names = [f"object-{one:06d}" for one in range(first, min(first + _A_SHARD, objects))]
        rows = [row for name in names for row in rows_of(name, shard, draw)]
        refused = {
            "object": f"refused-{number:06d}",
            "solidity": "",
            "stage": "clean",
            "reason": "not_a_solid",
        }
        refused |= {"message": "It is flat: it bounds no volume.", "advice": "Close it."}
        with h5py.File(folder / "shards" / shard, "w") as h5:
            h5.attrs["format"], h5.attrs["format_version"] = schema.FORMAT, schema.FORMAT_VERSION
            for name in (*names, refused["object"]):
                h5.create_group(f"objects/{name}")
            h5[schema.INDEX] = to_tsv(rows, schema.SHARD_COLUMNS)
            h5[schema.REFUSALS] = to_tsv([refused], schema.REFUSAL_COLUMNS)
        splits += [{"object": name, "split": draw.choice(_SPLITS), "copy_of": ""} for name in names]
    (folder / "splits.tsv").write_text(to_tsv(splits, schema.SPLIT_COLUMNS))
    shards = sorted((folder / "shards").iterdir())
    index = reading.of_shards(shards, reading.splits_at(folder))
    write_index(folder / "index.h5", index)
    write_parquet(folder / "index.parquet", index.items, schema.INDEX_COLUMNS)
    with open(folder / "index.tsv", "w", encoding="utf-8") as file:
        file.writelines(index.items.tsv(schema.INDEX_COLUMNS))
    facts = {path: {"sha256": sha256(path), "bytes": path.stat().st_size} for path in shards}
    tables = [folder / name for name in ("index.h5", "splits.tsv")]
    record = {
        "counts": {"items": len(index.items)},
        "shards": {path.name: about for path, about in facts.items()},
        "files": {path.name: {"sha256": sha256(path), "bytes": path.stat().st_size} for path in tables},
    }
    (folder / "dataset.json").write_text(json.dumps(record))


def rows_of(name: str, shard: str, draw) -> list[dict]:
    """Return the rows of an object: two bodies in every material."""
    about = {
        "object": name,
        "shard": shard,
        "origin": "generated",
        "category": f"family-{int(name[-6:]) % 40}",
    }
    about |= {"title": f"The {name}", "licence": "CC0-1.0", "size_m": draw.uniform(0.05, 0.5)}
    rows = []
    for solidity in ("solid", "hollow"):
        volume, tetrahedra = draw.uniform(1e-6, 1e-3), draw.randrange(4000, 20_000)
        body = {
            "solidity": solidity,
            "size_origin": "generated",
            "volume_m3": volume,
            "tetrahedra": tetrahedra,
        }
        for material in _MATERIALS:
            f1, last, duration, mass = (draw.uniform(0.1, 2) for _ in range(4))
            own = {
                "material": material,
                "mass_kg": mass,
                "modes": 64,
                "f1_hz": 1000 * f1,
                "f_last_hz": 9000 * last,
            }
            rows.append({**about, **body, **own, "duration_s": duration, "sampled": 100})
    return rows


def dictionaries(folder: Path):
    """Open as it was done before: a dictionary for every row, and another one with its split."""
    items, refusals, shard_of = [], [], {}
    for shard in reading.shards_at(folder):
        with h5py.File(shard) as h5:
            items += from_tsv(h5[schema.INDEX].asstr()[()], schema.SHARD_COLUMNS)
            refusals += from_tsv(h5[schema.REFUSALS].asstr()[()], schema.REFUSAL_COLUMNS)
            shard_of.update(dict.fromkeys(h5["objects"], shard))
    items.sort(key=lambda row: row["object"])
    splits = reading.splits_at(folder)
    items = [
        {
            name: splits.get(row["object"], "") if name == "split" else row[name]
            for name in schema.INDEX_COLUMNS
        }
        for row in items
    ]
    return lambda: [row for row in items if row["split"] == "train" and row["material"] == "steel"]


def columns(folder: Path):
    reader = vibraverse.dataset.open(folder)
    return lambda: reader.where(split="train", material="steel")


def shards(folder: Path):
    """Open by column where ``index.h5`` is not there."""
    index = reading.of_shards(reading.shards_at(folder), reading.splits_at(folder))
    index.source = folder
    reader = Reader(index)
    return lambda: reader.where(split="train", material="steel")


def parquet(folder: Path):
    """Read ``index.parquet`` with pyarrow, texts as dictionaries, which ``learn`` and ``report`` lack."""
    import pyarrow.parquet as pq

    texts = [name for name, (kind, _) in schema.INDEX_COLUMNS.items() if kind is str]
    table = pq.read_table(folder / "index.parquet", read_dictionary=texts)
    return lambda: len(table)


SIDES = {
    "import": lambda folder: lambda: None,
    "dictionaries": dictionaries,
    "columns": columns,
    "shards": shards,
    "parquet": parquet,
}


def compare(folder: Path) -> None:
    print("| side | open, s | where, s | MB above the import | pickled part, B |\n|" + 5 * " --- |")
    base, found = 0.0, {}
    for side in SIDES:
        words = [sys.executable, __file__, "--folder", str(folder), "--side", side]
        done = subprocess.run(words, check=True, capture_output=True, text=True)
        opened, narrowed, most, pickled = json.loads(done.stdout)
        base = base or most
        found[side] = opened, most - base
        print(f"| {side} | {opened:.2f} | {narrowed:.3f} | {most - base:.0f} | {pickled:,} |", flush=True)
    (old_s, old_mb), (new_s, new_mb) = found["dictionaries"], found["columns"]
    faster, less = old_s / new_s, old_mb / max(new_mb, 0.1)
    print(f"columns against dictionaries: {faster:.0f} times faster, {less:.0f} times less memory")


if __name__ == "__main__":
    main()
