"""Record schema, shards, splits and readers.

>>> import vibraverse.dataset
>>> with vibraverse.dataset.open("results/dataset") as reader:
...     steel = reader.where(split="train", material="steel")
...     steel[0]["frequencies_hz"]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vibraverse.dataset.reader import Reader


def open(path, fields=None, look: str = "clay") -> Reader:
    """Open a dataset's folder (``results/dataset``), one shard, or a view of several datasets (``vibraverse join``).

    Returns a :class:`~vibraverse.dataset.reader.Reader`.
    ``fields`` names what a sample holds (see ``docs/dataset.md``; ``look`` chooses its pictures).
    """
    from vibraverse.dataset.reader import DEFAULT_FIELDS, Reader, shards_at

    return Reader(shards_at(path), fields or DEFAULT_FIELDS, look)


def torch_dataset(path, fields=None, look: str = "clay", transform=None, **conditions):
    """Return a ``torch.utils.data.Dataset`` of a dataset's folder or of one shard.

    An item is a dictionary: arrays become tensors, texts stay texts. ``conditions`` narrow the items by columns of
    the index: ``torch_dataset("results/dataset", fields=["frequencies_hz", "views"], split="train")``.
    ``transform`` is applied to every item. Needs torch, which nothing else of the dataset does.
    """
    try:
        from vibraverse.dataset.pytorch import TorchDataset
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ModuleNotFoundError(
            "torch_dataset needs PyTorch, which this environment lacks: install it, or use the environment that "
            "`make learn` makes; vibraverse.dataset.open reads everything without it",
            name="torch",
        ) from None
    return TorchDataset(open(path, fields, look).where(**conditions), transform)
