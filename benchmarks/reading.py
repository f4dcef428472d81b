"""Speed of reading a dataset: by field, and as a PyTorch Dataset with 0 and 2 workers.

    .venv-learn/bin/python benchmarks/reading.py results/dataset [--seconds 5] [--workers 0 2] [--device cuda]

Each row reads items in random order for ``--seconds`` and joins them into batches of 16; files are in the page cache.
With ``--device``, batches are pinned and moved there. The last rows draw fresh materials from the stored basis, which
costs a dense solve per item.
"""

from __future__ import annotations

import argparse
import itertools
import time

from vibraverse.machine.threads import set_threads

set_threads(1)

import h5py  # noqa: E402
import numpy as np  # noqa: E402

import vibraverse.dataset  # noqa: E402
from vibraverse.dataset import schema  # noqa: E402

_BATCH = 16
FIELDS = (
    "frequencies_hz", "occupancy", "signed_distance", "views", "sound", "mode_coefficients", "surface_basis",
    "mode_shapes",
)  # fmt: skip
SETS = {
    "frequencies, material": ["frequencies_hz", "young_pa", "density_kg_m3", "poisson"],
    "the same, occupancy": ["frequencies_hz", "young_pa", "density_kg_m3", "poisson", "occupancy"],
    "frequencies, signed distance": ["frequencies_hz", "signed_distance"],
    "frequencies, views": ["frequencies_hz", "views"],
}
FRESH = {
    "fresh: frequencies, material": ["frequencies_hz", "young_pa", "density_kg_m3", "poisson"],
    "fresh: the same, occupancy": ["frequencies_hz", "young_pa", "density_kg_m3", "poisson", "occupancy"],
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 2])
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    _fields(arguments.dataset)
    print(
        f"\n| an item holds | {' | '.join(f'{count} workers, items/s' for count in arguments.workers)} |"
        f"\n|{(1 + len(arguments.workers)) * ' --- |'}"
    )
    for fresh, sets in ((False, SETS), ({}, FRESH)):
        for name, fields in sets.items():
            rates = [_rate(arguments, fields, fresh, workers) for workers in arguments.workers]
            print(f"| {name} | {' | '.join(f'{rate:,.0f}' for rate in rates)} |", flush=True)


def _fields(dataset) -> None:
    """Print the cost of each field: bytes in memory and in the file, and the time of a read."""
    print(
        "| field | kB in memory | kB in the file | ms a read, median | next of the body |\n|" + 5 * " --- |"
    )
    with vibraverse.dataset.open(dataset, FIELDS) as reader:
        for name in FIELDS:
            raw, stored, first, later, body = [], [], [], [], None
            for item in reader.items:
                place = {key: item[key] for key in ("object", "solidity", "material")}
                start = time.perf_counter()
                value = reader.read(name, **place)
                took = time.perf_counter() - start
                (later if body == (item["object"], item["solidity"]) else first).append(took)
                body = item["object"], item["solidity"]
                raw.append(np.asarray(value).nbytes)
                path = schema.BY_NAME[name].path.format(**place, look="clay", sound=item["material"])
                stored.append(_stored(reader.group(item["object"]).get(path)))
            print(
                f"| `{name}` | {np.mean(raw) / 1024:,.0f} | {np.mean(stored) / 1024:,.0f} "
                f"| {1000 * np.median(first):.2f} | {1000 * np.median(later):.2f} |"
            )


def _stored(dataset) -> int:
    if dataset is None:  # made from others
        return 0
    if h5py.check_vlen_dtype(dataset.dtype):
        return sum(len(one) for one in dataset[()])
    return dataset.id.get_storage_size()


def _rate(arguments, fields, fresh, workers: int) -> float:
    """Return items per second, without the start of the workers."""
    import torch

    data = vibraverse.dataset.torch_dataset(arguments.dataset, fields, fresh=fresh)
    order = torch.utils.data.RandomSampler(data, replacement=True, num_samples=1_000_000)
    moved = arguments.device != "cpu"
    loader = torch.utils.data.DataLoader(
        data, batch_size=_BATCH, sampler=order, num_workers=workers, pin_memory=moved
    )
    batches = iter(loader)
    for _ in itertools.islice(
        batches, 4 * max(workers, 1)
    ):  # skips the start of the workers and their prefetched batches
        pass
    start = time.perf_counter()
    count = 0
    while time.perf_counter() - start < arguments.seconds:
        batch = next(batches)
        if moved:
            for value in batch.values():
                if isinstance(value, torch.Tensor):
                    value.to(arguments.device, non_blocking=True)
        count += _BATCH
    if moved:
        torch.cuda.synchronize()
    return count / (time.perf_counter() - start)


if __name__ == "__main__":
    main()
