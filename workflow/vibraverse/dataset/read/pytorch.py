"""The dataset for PyTorch: indexable, and safe to use with any number of data-loader workers."""

from __future__ import annotations

import numpy as np
import torch


class TorchDataset(torch.utils.data.Dataset):
    """The items of a reader, or of :class:`~vibraverse.dataset.read.fresh.FreshItems`, as dictionaries of
    tensors and texts.

    Each worker opens its own handles on first access. Fields whose shape differs between bodies (surfaces, mode shapes,
    sounds) need a ``collate_fn`` of your own if a batch holds more than one item.
    """

    def __init__(self, items, transform=None):
        items.close()  # open handles must not be inherited by the workers
        if len(items):
            items.items.place(0)  # reads the columns that workers need, so that forked ones share them
        self.items = items
        self.transform = transform
        # Shared memory, because persistent workers keep their own copies of everything else.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> dict:
        self.items.epoch = int(self._epoch)
        item = {name: _tensor(value) for name, value in self.items[index].items()}
        return self.transform(item) if self.transform else item

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch before each pass: fresh materials are drawn anew; stored ones do not change."""
        self._epoch.fill_(epoch)


def _tensor(value):
    if isinstance(value, (np.ndarray, np.number)):
        return torch.as_tensor(value)
    return value
