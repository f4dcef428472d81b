"""The order of samples and the seeds of training are functions of (seed, epoch, step, rank)."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from vibraverse.learn import order

pytestmark = pytest.mark.learn


@pytest.mark.parametrize(("count", "batch"), [(10, 4), (12, 4), (7, 7), (5, 1)])
def test_every_sample_occurs_once_in_each_epoch(count, batch):
    keys = [key for step in range(count * 3 // batch) for key in order.step_keys(1, step, count, batch)]
    whole = Counter(key for key in keys if key[0] < len(keys) // count)
    assert set(whole.values()) == {1}
    assert len(whole) == len(keys) // count * count
    assert {index for _, index in whole} == set(range(count))


def test_epochs_and_seeds_have_orders_of_their_own():
    orders = [tuple(order.permutation(seed, epoch, 50)) for seed in (1, 2) for epoch in (0, 1)]
    assert len(set(orders)) == 4


@pytest.mark.parametrize("ranks", [2, 4])
def test_processes_share_the_batch_of_one(ranks):
    for step in range(9):
        parts = [order.step_keys(5, step, 21, 8, rank, ranks) for rank in range(ranks)]
        assert [key for part in parts for key in part] == order.step_keys(5, step, 21, 8)
        assert {len(part) for part in parts} == {8 // ranks}


def test_any_step_can_be_had_without_those_before():
    whole = list(order.StepKeys(5, 0, 30, 21, 8))
    order.permutation.cache_clear()
    assert list(order.StepKeys(5, 17, 30, 21, 8)) == whole[17:]
    assert len(order.StepKeys(5, 17, 30, 21, 8)) == 13


def test_the_order_stays_the_same_for_ever():
    assert order.step_keys(3, 4, 10, 4) == [(1, 4), (1, 5), (1, 2), (1, 7)]


def test_randomness_of_an_item_depends_on_its_key_alone():
    def drawn(*key):
        return order.item_rng(*key).standard_normal(3)

    np.testing.assert_array_equal(drawn(1, 2, 3), drawn(1, 2, 3))
    others = [(1, 2, 4), (1, 3, 3), (2, 2, 3), (1, 23, 3), (12, 3, 3)]
    assert not any(np.array_equal(drawn(1, 2, 3), drawn(*other)) for other in others)


def test_steps_and_processes_have_seeds_of_their_own():
    seeds = {order.step_seed(seed, step, rank) for seed in (0, 1) for step in range(20) for rank in (0, 1)}
    assert len(seeds) == 80
    assert all(0 <= seed < 2**64 for seed in seeds)
