"""The dataset as PyTorch sees it: indexable, safe to hand to any number of data-loader workers."""

from __future__ import annotations

import numpy as np
import torch

from vibraverse.dataset.reader import Reader


class TorchDataset(torch.utils.data.Dataset):
    """The items of a reader as dictionaries of tensors and texts.

    Each worker opens its own handles on first access. Fields whose shape differs from body to body (surfaces, mode
    shapes, sounds) need a ``collate_fn`` of your own when the batch holds more than one item.
    """

    def __init__(self, reader: Reader, transform=None):
        reader.close()  # nothing open is carried into the workers
        self.reader = reader
        self.transform = transform

    def __len__(self) -> int:
        return len(self.reader)

    def __getitem__(self, index: int) -> dict:
        item = {name: _tensor(value) for name, value in self.reader[index].items()}
        return self.transform(item) if self.transform else item


def _tensor(value):
    if isinstance(value, (np.ndarray, np.number)):
        return torch.as_tensor(value)
    return value
