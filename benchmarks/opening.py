"""Cost of opening a dataset of 800,000 items: rows as dictionaries from the shards' texts, and columnar.

    python benchmarks/opening.py [--objects 50000] [--folder FOLDER]

Makes a dataset's folder with indices only: shards with their texts (index, refusals) and one empty group per object,
and ``splits.tsv``, ``index.h5``, ``index.parquet`` and ``dataset.json``, which the library makes from them. There are
no arrays, because opening reads none. Numbers are random, so columns compress worse than real ones. A hundredth of the
objects is refused. Each side runs in a process of its own, with files in the page cache. ``import`` is a process that
only imports; the memory of the others is the difference to it. ``parquet`` includes the import of pyarrow.
"""

from __future__ import annotations

import argparse
import json
import pickle
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

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
        start = time.perf_counter()
        said = SIDES[arguments.side](arguments.folder)
        took = time.perf_counter() - start
        print(json.dumps([took, peak_mb(), said]))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        if not (folder / "dataset.json").is_file():
            make(folder, arguments.objects)
        for name in ("index.tsv", "index.h5", "index.parquet"):
            if (folder / name).is_file():
                print(f"{name}: {(folder / name).stat().st_size / 1e6:.1f} MB")
        compare(folder)


def peak_mb() -> float:
    """Return the peak memory of this process; unlike getrusage, without that of its parent before the fork."""
    return int(re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024


def make(folder: Path, objects: int) -> None:
    from vibraverse.contract.products import sha256
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.parquet import write_parquet

    (folder / "shards").mkdir(parents=True)
    draw = np.random.default_rng(1)
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
        splits += [{"object": name, "split": str(draw.choice(_SPLITS)), "copy_of": ""} for name in names]
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
        volume, tetrahedra = draw.uniform(1e-6, 1e-3), int(draw.integers(4000, 20_000))
        body = {
            "solidity": solidity,
            "size_origin": "generated",
            "volume_m3": volume,
            "tetrahedra": tetrahedra,
        }
        for material in _MATERIALS:
            f1, last, duration, mass = draw.uniform(0.1, 2, 4)
            own = {
                "material": material,
                "mass_kg": mass,
                "modes": 64,
                "f1_hz": 1000 * f1,
                "f_last_hz": 9000 * last,
            }
            rows.append({**about, **body, **own, "duration_s": duration, "sampled": 100})
    return rows


def dictionaries(folder: Path) -> str:
    """Open as earlier versions did: a dictionary for every row, and another one with its split."""
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
    start = time.perf_counter()
    train = [row for row in items if row["split"] == "train" and row["material"] in {"steel"}]
    narrowed = time.perf_counter() - start
    return f"{len(items)} items, where {1000 * narrowed:.0f} ms for {len(train)}, pickle {len(pickle.dumps(items)):,} B"


def columns(folder: Path) -> str:
    return narrowed(vibraverse.dataset.open(folder))


def shards(folder: Path) -> str:
    """Open without ``index.h5``, columnar from the shards."""
    return narrowed(Reader(reading.of_shards(reading.shards_at(folder), reading.splits_at(folder))))


def narrowed(reader: Reader) -> str:
    start = time.perf_counter()
    train = reader.where(split="train", material="steel")
    took = time.perf_counter() - start
    return f"{len(reader)} items, where {1000 * took:.0f} ms for {len(train)}, pickle {len(pickle.dumps(train)):,} B"


def parquet(folder: Path) -> str:
    """Read ``index.parquet`` with dictionary-encoded texts by pyarrow, which ``learn`` and ``report`` lack."""
    import pyarrow.parquet as pq

    texts = [name for name, (kind, _) in schema.INDEX_COLUMNS.items() if kind is str]
    return f"{len(pq.read_table(folder / 'index.parquet', read_dictionary=texts))} items"


SIDES = {
    "import": lambda folder: "",
    "dictionaries": dictionaries,
    "columns": columns,
    "shards": shards,
    "parquet": parquet,
}


def compare(folder: Path) -> None:
    print("| side | s | MB above the import | it holds |\n| --- | --- | --- | --- |")
    base, found = 0.0, {}
    for side in SIDES:
        words = [sys.executable, __file__, "--folder", str(folder), "--side", side]
        took, most, said = json.loads(
            subprocess.run(words, check=True, capture_output=True, text=True).stdout
        )
        base = base or most
        found[side] = took, most - base
        print(f"| {side} | {took:.2f} | {most - base:.0f} | {said or f'{base:.0f} MB'} |", flush=True)
    (old_s, old_mb), (new_s, new_mb) = found["dictionaries"], found["columns"]
    faster, less = old_s / new_s, old_mb / max(new_mb, 0.1)
    print(f"columns against dictionaries: {faster:.0f} times faster, {less:.0f} times less memory")


if __name__ == "__main__":
    main()
