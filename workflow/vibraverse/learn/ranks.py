"""The processes that train together, and the device of each.

``torchrun`` starts them and names them in the environment (``RANK``, ``WORLD_SIZE``, ``LOCAL_RANK``). Without it there
is one process. They talk through NCCL on GPUs and Gloo on CPUs.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
import torch.distributed as dist
from torch.distributed.nn.functional import all_gather

from vibraverse.contract.errors import NotStored, NotThere, UsageError

#: Errors that one process raises for all of them, by name.
_SHARED = {kind.__name__: kind for kind in (NotStored, NotThere, UsageError)}


@dataclass(frozen=True)
class Ranks:
    """This process among ``count``; ``rank`` 0 alone writes and speaks."""

    device: torch.device
    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes."""
        return self.rank == 0

    def total(self, *values: float) -> list[float]:
        """Return the sums of numbers over all processes; every process must call it."""
        if self.count == 1:
            return list(values)
        sums = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.all_reduce(sums)
        return sums.tolist()

    def gather(self, value: Any) -> list:
        """Return the values of all processes in the order of their ranks; every process must call it."""
        if self.count == 1:
            return [value]
        values = [None] * self.count
        dist.all_gather_object(values, value)
        return values

    def lead(self, work: Callable[[], Any]) -> Any:
        """Call ``work`` in the first process; return its result, or raise its error, in every process.

        Otherwise the others would wait for a process that has stopped.
        """
        if self.count == 1:
            return work()
        said: list = [None, "", ""]
        if self.first:
            try:
                said = [work(), "", ""]
            except tuple(_SHARED.values()) as error:
                kind = next(name for name, kind in _SHARED.items() if isinstance(error, kind))
                said = [None, kind, str(error)]
        dist.broadcast_object_list(said, src=0, device=self.device)
        result, kind, message = said
        if kind:
            raise _SHARED[kind](message)
        return result


def gathered(values: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Return the rows of all processes, in the order of their ranks, and where those of this process begin.

    A gradient of the rows goes back to the processes they are from, as its sum over all processes. Each has equally
    many rows, and every process must call it.
    """
    if not dist.is_initialized():
        return values, 0
    return torch.cat(all_gather(values.contiguous())), dist.get_rank() * len(values)


@contextmanager
def joined(device: str | torch.device | None = None) -> Iterator[Ranks]:
    """Yield this process among those that train together, on its device.

    ``device`` is ``cpu``, ``cuda``, ``cuda:1``, or None for a GPU if there is one. Raises :class:`NotThere` if there is
    no such GPU.
    """
    count, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    chosen = choose(device, int(os.environ.get("LOCAL_RANK", rank)) if count > 1 else None)
    if chosen.type == "cuda":
        torch.cuda.set_device(chosen)
    ours = count > 1 and not dist.is_initialized()
    if ours:
        dist.init_process_group("nccl" if chosen.type == "cuda" else "gloo", rank=rank, world_size=count)
    try:
        yield Ranks(chosen, rank, count)
    except (NotStored, NotThere, UsageError):
        _leave(ours)  # every process raises these
        raise
    _leave(ours)


def _leave(ours: bool) -> None:
    """Leave the group of processes. After an error of one process alone this would wait for ever, so do not.

    A network's DistributedDataParallel goes first. If it dropped the last reference to a Gloo group, it would wait for
    a thread of the group that waits for the interpreter lock; torch 2.11 hung so in one training of five.
    """
    if ours:
        gc.collect()
        dist.destroy_process_group()


def choose(device: str | torch.device | None = None, local_rank: int | None = None) -> torch.device:
    """Return the device to train on; several processes on a host take the GPU of their ``local_rank``."""
    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    chosen = torch.device(device or ("cuda" if found else "cpu"))
    if chosen.type != "cuda":
        return chosen
    number = local_rank if local_rank is not None else chosen.index or 0
    if not found:
        raise NotThere(
            "a GPU is asked for, but PyTorch finds none: this machine has none, or lacks its driver, or PyTorch is "
            "built without CUDA; run it where there is one (in a container with --nv), or set learn.gpus to 0"
        )
    if number >= found:
        several = (
            f"{local_rank + 1} processes on this host" if local_rank is not None else f"the GPU {chosen}"
        )
        raise NotThere(
            f"{several} asked for, but PyTorch finds {found} GPU{'s' * (found > 1)} here, counted from cuda:0; lower "
            f"learn.gpus to {found}, or name another device"
        )
    return torch.device("cuda", number)
