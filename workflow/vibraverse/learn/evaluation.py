"""Metrics of a network on a whole split, each sample counted once."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader

from vibraverse.config.training import Training
from vibraverse.contract.errors import NotThere, UsageError
from vibraverse.learn import order
from vibraverse.learn.interruption import held_back, obey_parent
from vibraverse.learn.precision import autocast, resolve, tf32
from vibraverse.learn.ranks import Ranks, joined
from vibraverse.learn.task import Task


def seed_all(seed: int, device: torch.device) -> None:
    """Seed the global generators of Python, NumPy and PyTorch, on the CPU and on ``device``."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002  (a task's libraries may draw from it)
    # Not torch.manual_seed, which takes milliseconds where there is CUDA and no GPU.
    torch.default_generator.manual_seed(seed)
    if device.type == "cuda":
        torch.cuda.manual_seed(seed)


def samples(task: Task, split: str):
    """Return the samples of a split; raises :class:`UsageError` if it has none."""
    data = task.dataset(split)
    if not len(data):
        raise UsageError(
            f"the split {split!r} has no samples; add objects, or give the split a larger share (dataset.splits)"
        )
    return data


def batches(task: Task, data, keys, options: Training, ranks: Ranks) -> Iterator:
    """Yield the batches of some lists of keys, in their order whatever the number of workers.

    Raises :class:`NotThere` if the system kills a worker.
    """
    loader = DataLoader(
        data,
        batch_sampler=keys,
        collate_fn=task.collate,
        num_workers=options.workers,
        worker_init_fn=obey_parent,
        pin_memory=ranks.device.type == "cuda",
        # Its own, because the loader would draw from the global one, and once more for every attempt.
        generator=torch.Generator(),
    )
    try:
        yield from _started(loader)
        return
    except RuntimeError as error:
        if not str(error).startswith("DataLoader worker (pid"):
            raise
    # Outside of the handler: as this one's context, the other error would keep the remaining workers.
    raise NotThere(
        f"a process that reads data was killed, probably for lack of memory; lower workers ({options.workers}) or "
        "batch_size, or ask for more memory, then repeat the command"
    )


def _started(loader: DataLoader) -> Iterator:
    """Return the batches of a loader; its workers run."""
    with held_back():
        return iter(loader)


def predictions(
    task: Task,
    model: torch.nn.Module,
    split: str,
    options: Training,
    ranks: Ranks,
    *,
    seed: int = 0,
    data=None,
    pause: Callable[[], None] = lambda: None,
) -> dict[str, np.ndarray]:
    """Return what the task predicts for each sample of a split, each (N, …) in the order of the split.

    Processes take contiguous parts of the split, so none needs padding; each returns the whole. ``data`` are the
    split's samples, if they are open already. ``pause`` is called before each batch and may raise. The network is in
    evaluation mode afterwards.
    """
    data = samples(task, split) if data is None else data
    mine = np.array_split(np.arange(len(data)), ranks.count)[ranks.rank].tolist()
    size = max(1, options.batch_size // ranks.count)
    keys = [[(0, index) for index in mine[first : first + size]] for first in range(0, len(mine), size)]
    # Every validation draws the same numbers; the training's next step seeds anew.
    seed_all(order.named_seed(seed, f"evaluate {split} {ranks.rank}"), ranks.device)
    model.eval()
    found = []
    with torch.no_grad(), closing(batches(task, data, keys, options, ranks)) as read:
        for wanted, batch in zip(keys, read, strict=True):
            pause()
            found.append(_predict(task, model, batch, len(wanted), options, ranks))
    together = [part for parts in ranks.gather(found) for part in parts]
    return {name: np.concatenate([part[name] for part in together]) for name in together[0]}


def evaluate(
    task: Task,
    weights: Mapping[str, torch.Tensor],
    split: str,
    options: Training,
    *,
    seed: int = 0,
    device: str | torch.device | None = None,
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the metrics of a trained network on a split, and its predictions for each sample, each (N, …).

    ``weights`` are those of :class:`~vibraverse.learn.train.Trained`. Raises as
    :func:`~vibraverse.learn.ranks.joined` and :func:`samples` do.
    """
    with joined(device) as ranks, tf32(resolve(options.precision, ranks.device) == "bf16"):
        model = task.model()
        model.load_state_dict(weights)
        found = predictions(task, model.to(ranks.device), split, options, ranks, seed=seed)
        return task.score(found), found


def answers(task, model: torch.nn.Module, side: str, options: Training) -> dict[str, np.ndarray]:
    """Return the answers of a trained network about the bodies of a side, as its task gives them; on the CPU."""
    with joined("cpu") as ranks:
        return task.answers(
            side, lambda name, data: predictions(task, model, name, options, ranks, data=data)
        )


def _predict(task: Task, model, batch: Any, count: int, options: Training, ranks: Ranks) -> dict:
    """Return the predictions of one batch as arrays of ``count`` rows each."""
    batch = task.prepare(batch, ranks.device)
    with autocast(resolve(options.precision, ranks.device), ranks.device):
        predicted = task.predict(model, batch)
    for name, values in predicted.items():
        if values.ndim == 0 or len(values) != count:
            raise TypeError(
                f"{type(task).__name__}.predict: {name!r} must have {count} rows, one for each sample"
            )
    return {name: _array(values) for name, values in predicted.items()}


def _array(values: torch.Tensor) -> np.ndarray:
    """Return a tensor as an array on the CPU; NumPy has no bfloat16."""
    values = values.detach().cpu()
    return (values.float() if values.dtype == torch.bfloat16 else values).numpy()


def names(task: Task, split: str, keys: list[order.Key]) -> Iterator[str]:
    """Return the names of samples by their keys."""
    ids = task.ids(split)
    return (str(ids[index]) for _, index in keys)
