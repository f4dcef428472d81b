"""Cost of tracing a wrong byte in a shard: checksums of an object's content, against HDF5's own Fletcher32.

python benchmarks/checksums.py [results/dataset/shards/*.h5]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import h5py

from vibraverse.contract.products import sha256
from vibraverse.dataset import schema
from vibraverse.dataset.check.recompute import repeats
from vibraverse.dataset.check.validator import problems
from vibraverse.dataset.schema.checksums import checksums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("shards", nargs="*", type=Path, help="default: those of results/dataset")
    shards = parser.parse_args().shards or sorted(Path("results/dataset/shards").glob("*.h5"))
    for shard in shards:
        with h5py.File(shard) as h5:
            groups = list(h5["objects"].values())
            arrays = [array for group in groups for array in numbers(group)]
            lists = [len(group[schema.CHECKSUMS].asstr()[()]) for group in groups]
            print(f"{shard}: {shard.stat().st_size} bytes, {len(groups)} objects, {len(arrays)} arrays")
            print(
                f"  checksums: {sum(lists)} bytes, {seconds(lambda g=groups: [checksums(x) for x in g]):.3f} CPU s"
            )
            print(f"  SHA-256 of the file: {seconds(lambda s=shard: sha256(s)):.3f} CPU s")
            for fletcher32 in (False, True):
                print(
                    f"  arrays {'with' if fletcher32 else 'without'} Fletcher32: {copied(arrays, fletcher32)}"
                )
            print(f"  everything but making again: {seconds(lambda h=h5: problems(h)):.2f} CPU s")
            print(
                f"  and making everything again: {seconds(lambda h=h5: problems(h, repeats(1.0))):.2f} CPU s"
            )


def numbers(group) -> list:
    """Return the datasets of a group that hold numbers."""
    found = []
    group.visititems(lambda _, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
    return [item for item in found if item.dtype.kind != "O"]


def copied(arrays, fletcher32: bool) -> str:
    """Write the arrays to a new file and read them; return bytes, arrays that can have the checksum, reading time."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "copy.h5"
        with h5py.File(path, "w") as h5:
            for number, array in enumerate(arrays):
                how = {"chunks": array.chunks, "compression": array.compression, "shuffle": array.shuffle}
                how = {**how, "compression_opts": array.compression_opts, "fletcher32": fletcher32}
                h5.create_dataset(str(number), data=array[()], **(how if array.chunks else {}))
        with h5py.File(path) as h5:
            reading = seconds(lambda: [array[()] for array in h5.values()])
        chunked = sum(array.chunks is not None for array in arrays)
        return f"{path.stat().st_size} bytes, {chunked} of {len(arrays)} chunked, read in {reading:.3f} CPU s"


def seconds(function) -> float:
    """Return the shortest CPU time of three calls in seconds."""
    times = []
    for _ in range(3):
        started = time.process_time()
        function()
        times.append(time.process_time() - started)
    return min(times)


if __name__ == "__main__":
    main()
