"""The dataset in PyTorch, with workers."""

from __future__ import annotations

import numpy as np
import pytest

import make_products

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

import vibraverse.dataset  # noqa: E402

pytestmark = pytest.mark.learn


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    results = tmp_path_factory.mktemp("torch") / "results"
    make_products.build(results)
    return results / "dataset"


def test_items_are_tensors(folder):
    data = vibraverse.dataset.torch_dataset(
        folder, fields=["frequencies_hz", "views", "young_pa"], material="steel"
    )
    assert isinstance(data, torch.utils.data.Dataset)
    assert len(data) == 3
    item = data[0]
    assert item["object"] == "ball-0000"
    assert item["frequencies_hz"].shape == (64,)
    assert item["frequencies_hz"].dtype == torch.float64
    assert item["views"].shape == (3, 96, 96, 3)
    assert item["views"].dtype == torch.uint8
    assert float(item["young_pa"]) == 2.0e11


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_workers_read_the_same(folder, context):
    data = vibraverse.dataset.torch_dataset(folder, fields=["frequencies_hz", "size_m"])
    data[0]  # an open handle in the parent must not travel to the workers
    loader = torch.utils.data.DataLoader(data, batch_size=4, num_workers=2, multiprocessing_context=context)
    batches = list(loader)
    assert [tuple(batch["frequencies_hz"].shape) for batch in batches] == [(4, 64)] * 3
    with vibraverse.dataset.open(folder) as reader:
        expected = np.stack([sample["frequencies_hz"] for sample in reader])
    np.testing.assert_array_equal(torch.cat([batch["frequencies_hz"] for batch in batches]).numpy(), expected)
    assert batches[0]["size_m"].tolist() == [make_products.SIZE_M] * 4


def test_splits_and_transforms(folder):
    counts = {
        split: len(vibraverse.dataset.torch_dataset(folder, split=split))
        for split in ("train", "validation", "test")
    }
    assert sum(counts.values()) == 12
    doubled = vibraverse.dataset.torch_dataset(folder, transform=lambda item: 2 * item["frequencies_hz"])
    plain = vibraverse.dataset.torch_dataset(folder)
    assert torch.equal(doubled[3], 2 * plain[3]["frequencies_hz"])


def test_fresh_materials_are_the_same_for_any_workers_and_new_in_every_epoch(folder):
    fields = ["frequencies_hz", "young_pa", "size_m"]
    data = vibraverse.dataset.torch_dataset(folder, fields=fields, fresh={"seed": 5})
    assert len(data) == 3
    epochs = {}
    for workers in (0, 2):
        loader = torch.utils.data.DataLoader(
            data, batch_size=1, num_workers=workers, persistent_workers=workers > 0
        )
        for epoch in range(3):
            data.set_epoch(epoch)
            epochs[workers, epoch] = torch.cat([batch["frequencies_hz"] for batch in loader])
            assert epochs[workers, epoch].shape[0] == 3
    for epoch in range(3):
        assert torch.equal(epochs[0, epoch], epochs[2, epoch])
    assert not torch.equal(epochs[0, 0], epochs[0, 1])
    assert not torch.equal(epochs[0, 1], epochs[0, 2])
