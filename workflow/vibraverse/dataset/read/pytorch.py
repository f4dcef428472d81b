"""The dataset as PyTorch sees it: indexable, safe to hand to any number of data-loader workers."""

from __future__ import annotations

import numpy as np
import torch


class TorchDataset(torch.utils.data.Dataset):
    """The items of a reader, or of :class:`~vibraverse.dataset.read.fresh.FreshItems`, as dictionaries of
    tensors and texts.

    Each worker opens its own handles on first access. Fields whose shape differs from body to body (surfaces, mode
    shapes, sounds) need a ``collate_fn`` of your own when the batch holds more than one item.
    """

    def __init__(self, items, transform=None):
        items.close()  # nothing open is carried into the workers
        if len(items):
            items.items.place(0)  # reads what of the index a worker asks for: forked ones share it
        self.items = items
        self.transform = transform
        # Shared, because workers that live on from epoch to epoch keep their own copy of everything else.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> dict:
        self.items.epoch = int(self._epoch)
        item = {name: _tensor(value) for name, value in self.items[index].items()}
        return self.transform(item) if self.transform else item

    def set_epoch(self, epoch: int) -> None:
        """Say which epoch comes, before each pass: fresh materials are drawn anew; stored ones stay as they are."""
        self._epoch.fill_(epoch)


def _tensor(value):
    if isinstance(value, (np.ndarray, np.number)):
        return torch.as_tensor(value)
    return value
