"""Record schema, shards, splits and readers.

>>> import vibraverse.dataset
>>> with vibraverse.dataset.open("results/dataset") as reader:
...     steel = reader.where(split="train", material="steel")
...     steel[0]["frequencies_hz"]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vibraverse.dataset.read.fresh import FreshItems
    from vibraverse.dataset.read.reader import Reader


def open(path, fields=None, look: str = "clay") -> Reader:
    """Open a dataset's folder (``results/dataset``), one shard, or a view of several datasets (``vibraverse join``).

    Returns a :class:`~vibraverse.dataset.read.reader.Reader`.
    ``fields`` names the fields of a sample (see ``docs/dataset.md``); ``look`` chooses its pictures.
    """
    from vibraverse.dataset.read.reader import DEFAULT_FIELDS, Reader

    return Reader.at(path, fields or DEFAULT_FIELDS, look)


def fresh_materials(
    path, fields=None, look: str = "clay", settings: dict | None = None, **conditions
) -> FreshItems:
    """Return the bodies of a dataset with materials and sizes drawn anew in every epoch, and exact labels.

    ``settings`` are the arguments of :class:`~vibraverse.dataset.read.fresh.FreshItems` (``ranges``,
    ``size_m``, ``seed``, ``bases``), ``conditions`` columns of the index. Needs SciPy besides NumPy and h5py.
    """
    from vibraverse.dataset.read.fresh import FreshItems

    return FreshItems(open(path, fields, look).where(**conditions), **(settings or {}))


def torch_dataset(
    path, fields=None, look: str = "clay", transform=None, fresh: dict | bool = False, **conditions
):
    """Return a ``torch.utils.data.Dataset`` of a dataset's folder or of one shard.

    An item is a dictionary: arrays become tensors, texts stay texts. ``conditions`` narrow the items by columns of
    the index: ``torch_dataset("results/dataset", fields=["frequencies_hz", "views"], split="train")``.
    ``transform`` is applied to every item. ``fresh`` (True, or the settings of :func:`fresh_materials`) draws material
    and size of every item anew after each ``set_epoch``. Only this function needs torch.
    """
    try:
        from vibraverse.dataset.read.pytorch import TorchDataset
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ModuleNotFoundError(
            "torch_dataset needs PyTorch, which this environment lacks: install it, or use the environment that "
            "`make learn` makes; vibraverse.dataset.open reads everything without it",
            name="torch",
        ) from None
    if fresh is False:
        return TorchDataset(open(path, fields, look).where(**conditions), transform)
    settings = {} if fresh is True else fresh
    return TorchDataset(fresh_materials(path, fields, look, settings, **conditions), transform)
