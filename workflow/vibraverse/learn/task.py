"""What a task tells the trainer: its network, samples, losses and metrics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset, default_collate

from vibraverse.learn.order import Key, item_rng


class Task(ABC):
    """A learning task. The trainer calls these methods and knows nothing else of it.

    Splits are ``train``, ``validation`` and ``test``. A split that cannot be used (one class only, too few objects)
    raises :class:`UsageError` in :meth:`dataset`.
    """

    #: The metric of :meth:`score` that chooses the best weights; lower is better.
    best: str = "loss"

    @abstractmethod
    def model(self) -> torch.nn.Module:
        """Return a new network on the CPU; the trainer has seeded the global generators.

        Several processes exchange gradients around one call of the network, so its ``forward`` does all the work, and
        :meth:`losses` calls it once.
        """

    @abstractmethod
    def dataset(self, split: str) -> Dataset:
        """Return the samples of a split: ``len()``, and items by keys ``(epoch, index)`` (see :class:`Keyed`).

        A sample may depend on its key alone. Validation and tests read epoch 0.
        """

    @abstractmethod
    def ids(self, split: str) -> Sequence[str]:
        """Return the names of a split's samples, for messages."""

    @abstractmethod
    def losses(self, model: torch.nn.Module, batch: Any) -> torch.Tensor:
        """Return one loss for each sample of a prepared batch, (B,); training minimises their mean."""

    def collate(self, items: list) -> Any:
        """Return a batch of samples, on the CPU and in a data worker."""
        return default_collate(items)

    def prepare(self, batch: Any, device: torch.device) -> Any:
        """Return a batch on ``device``, with what is computed there (labels, octrees); outside autocast."""
        return move(batch, device)

    def predict(self, model: torch.nn.Module, batch: Any) -> dict[str, torch.Tensor]:
        """Return what :meth:`score` needs of each sample of a prepared batch, each (B, …); without gradients.

        Processes have different numbers of batches here, so this must not exchange anything between them.
        """
        return {"loss": self.losses(model, batch)}

    def score(self, predictions: dict[str, np.ndarray]) -> dict[str, float]:
        """Return the metrics of a whole split; each prediction is (N, …) in the order of the split.

        The default is the mean of each.
        """
        return {name: float(np.mean(values)) for name, values in predictions.items()}


class Keyed(Dataset):
    """Samples by ``(epoch, index)``, from items by index.

    ``draw(item, generator)`` returns the item with what is random in it; the generator depends on the seed and the key
    alone. Without it all epochs are alike.
    """

    def __init__(
        self,
        items: Sequence,
        seed: int = 0,
        draw: Callable[[Any, np.random.Generator], Any] | None = None,
    ):
        self.items, self.seed, self.draw = items, seed, draw

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, key: Key) -> Any:
        epoch, index = key
        item = self.items[index]
        return self.draw(item, item_rng(self.seed, epoch, index)) if self.draw else item


def move(batch: Any, device: torch.device) -> Any:
    """Return a batch with all its tensors, and whatever else has a method ``to``, on ``device``."""
    if isinstance(batch, torch.Tensor):
        return batch.to(device, non_blocking=True)
    if isinstance(batch, Mapping):
        return {name: move(value, device) for name, value in batch.items()}
    if isinstance(batch, tuple | list):
        return [move(value, device) for value in batch]
    return batch.to(device) if hasattr(batch, "to") else batch
