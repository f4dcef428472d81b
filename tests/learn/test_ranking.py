"""Measures of retrieval: against all orders of ties, against chance, and against bodies that are found or not."""

from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest

from vibraverse.learn import pools, ranking

#: Names of measures of one query.
NAMES = ("top_1", "top_5", "top_10", "mrr", "rank", "map")


def brute_force(scores: np.ndarray, right: np.ndarray) -> dict[str, float]:
    """Return the measures of one query, as means over all orders of the entries that the scores allow."""
    found = []
    for order in permutations(range(len(scores))):
        if (np.diff(scores[list(order)]) > 0).any():
            continue
        places = np.flatnonzero(right[list(order)]) + 1
        precision = np.mean([(number + 1) / place for number, place in enumerate(places)])
        found.append([*(places[0] <= cutoff for cutoff in (1, 5, 10)), 1 / places[0], places[0], precision])
    return dict(zip(NAMES, np.mean(found, axis=0), strict=True))


@pytest.mark.parametrize("levels", [1, 2, 3, 100])
@pytest.mark.parametrize("wanted", [1, 2, 3])
def test_ties_count_as_the_mean_over_all_their_orders(levels, wanted):
    random = np.random.default_rng(levels * 10 + wanted)
    scores = random.integers(levels, size=(6, 6)).astype(float)
    right = np.argsort(random.random((6, 6)), axis=1) < wanted
    found = ranking.of_scores(scores, right)
    for query in range(6):
        expected = brute_force(scores[query], right[query])
        assert {name: found[name][query] for name in NAMES} == pytest.approx(expected, abs=1e-12)


def test_measures_by_hand():
    """The right entries stand at the places 2 and 4 of five."""
    found = ranking.of_scores(np.array([[9.0, 8.0, 7.0, 6.0, 5.0]]), np.array([[0, 1, 0, 1, 0]], dtype=bool))
    assert {name: values[0] for name, values in found.items()} == pytest.approx(
        {"top_1": 0, "top_5": 1, "top_10": 1, "mrr": 1 / 2, "rank": 2, "map": (1 / 2 + 2 / 4) / 2}
    )


def test_a_constant_embedding_scores_as_chance():
    """200 bodies, one right: a share of k/200 within the first k, not all; a random embedding scores about the same."""
    right = np.eye(200, dtype=bool)
    found = ranking.summary(ranking.measures(np.ones((200, 3)), np.ones((200, 3)), right))
    harmonic = np.sum(1 / np.arange(1, 201)) / 200
    expected = {"top_1": 1 / 200, "top_5": 5 / 200, "top_10": 10 / 200, "mrr": harmonic, "map": harmonic}
    assert found == pytest.approx({**expected, "median_rank": 100.5})
    random = np.random.default_rng(0)
    drawn = [
        ranking.summary(ranking.measures(random.normal(size=(200, 8)), random.normal(size=(200, 8)), right))
        for _ in range(40)
    ]
    assert np.mean([one["mrr"] for one in drawn]) == pytest.approx(harmonic, rel=0.1)
    assert np.mean([one["top_10"] for one in drawn]) == pytest.approx(0.05, rel=0.15)


def test_vectors_that_are_no_numbers_score_as_chance():
    right = np.eye(20, dtype=bool)
    found = ranking.of_scores(np.full((20, 20), np.nan), right)
    expected = ranking.of_scores(np.zeros((20, 20)), right)
    for name in NAMES:
        np.testing.assert_array_equal(found[name], expected[name])


def test_parts_of_a_large_pool_are_the_whole(monkeypatch):
    random = np.random.default_rng(0)
    queries, entries = random.normal(size=(2, 30, 4))
    whole = ranking.measures(queries, entries, np.eye(30, dtype=bool))
    monkeypatch.setattr(ranking, "_AT_ONCE", 70)
    for name, values in ranking.measures(queries, entries, np.eye(30, dtype=bool)).items():
        np.testing.assert_array_equal(values, whole[name])


def test_intervals_resample_objects_and_not_queries():
    """A hundred equal queries of each of 20 objects are worth 20 values, with their standard error."""
    values = np.random.default_rng(1).random(20)
    found = {"mrr": np.repeat(values, 100), "rank": np.repeat(values, 100)}
    drawn = ranking.resampled(found, np.repeat(np.arange(20), 100))
    assert drawn["mrr"].std() == pytest.approx(values.std() / np.sqrt(20), rel=0.1)
    assert drawn["mrr"].mean() == pytest.approx(values.mean(), abs=0.01)
    assert set(drawn["median_rank"]) <= set(values)
    assert np.median(drawn["median_rank"]) == pytest.approx(np.median(values), abs=0.05)


def samples(objects: int, originals=None):
    """Return the bodies of some objects, both of each, in three materials."""
    names = np.repeat([f"cup-{number:04d}" for number in range(objects)], 2)
    return SimpleNamespace(
        object=names,
        original=names if originals is None else np.repeat(originals, 2),
        solidity=np.tile(["solid", "hollow"], objects),
        materials=dict.fromkeys(("steel", "glass", "wood")),
    )


def judged(objects: int, answers: dict, originals=None) -> dict[tuple[str, str], float]:
    answers = {"material": np.arange(2 * objects) % 3, **answers}
    rows = pools.judge_retrieval(samples(objects, originals), np.arange(2 * objects), answers)
    assert all(row["count"] == 2 * objects for row in rows)
    return {(row["source"], row["measure"]): row["value"] for row in rows}


def test_what_is_right():
    """Twins look alike and are two bodies; the solid bodies of copies are one body, the hollow ones are not."""
    numbers = pools.alike(samples(3, ["cup-0000", "cup-0000", "cup-0002"]))
    look, body = (own[:, None] == own for own in (numbers["look"], numbers["body"]))
    assert look.sum(axis=1).tolist() == [4, 4, 4, 4, 2, 2]
    assert body.sum(axis=1).tolist() == [2, 1, 2, 1, 1, 1]
    assert body[0, 2]
    assert [pools.key_of(one) for one in pools.DIRECTIONS].count("look") == 4
    assert pools.key_of(("sound", "shape")) == pools.key_of(("shape", "sound")) == "body"


def test_a_perfect_embedding_finds_everything_everywhere():
    same = np.eye(120)[:, None]
    picture = same + np.roll(same.reshape(60, 2, 120), 1, axis=1).reshape(120, 1, 120)
    found = judged(60, {"sound": same, "shape": same, "image": picture})
    for source in (pools.ALL, pools.SOME, pools.SAME):
        for direction in ("sound_to_shape", "shape_to_sound", "sound_to_image", "image_to_shape", "mean"):
            assert found[source, f"{direction}_top_1"] == 1
            assert found[source, f"{direction}_map"] == 1
            assert found[source, f"{direction}_median_rank"] == 1
    assert found[pools.ALL, "pool"] == 120


def test_chance_and_the_material_are_what_can_be_calculated():
    from vibraverse.learn.baselines.correlations import chance, material_oracle

    found = judged(60, chance(120))
    assert found[pools.ALL, "sound_to_shape_top_1"] == pytest.approx(1 / 120)
    assert found[pools.ALL, "sound_to_image_top_1"] == pytest.approx(2 / 120)
    assert found[pools.SAME, "image_to_shape_top_5"] == pytest.approx(1 - (115 * 114) / (120 * 119))
    assert found[pools.ALL, "shape_to_sound_median_rank"] == pytest.approx(60.5)
    known = judged(60, material_oracle(120, 3))
    assert known[pools.ALL, "sound_to_shape_top_1"] == pytest.approx(3 / 120)  # materials / bodies
    assert known[pools.SAME, "sound_to_shape_top_1"] == pytest.approx(1 / 120)
    assert known[pools.SOME, "sound_to_shape_top_1"] == pytest.approx(3 / 100, rel=0.1)


def test_drawn_pools_hold_as_many_objects_as_there_are():
    random = np.random.default_rng(0)
    many = np.repeat(np.arange(150).astype(str), 2)
    assert len(set(many[pools.draw(many, random)])) == 100
    few = np.repeat(np.arange(60).astype(str), 2)
    chosen = pools.draw(few, random)
    assert len(set(chosen)) == 100
    assert len(set(few[chosen])) == 60


def test_small_pools_are_counted_and_not_measured():
    from vibraverse.learn.baselines.correlations import chance

    assert judged(4, chance(8)) == {(pools.ALL, "pool"): 8}
    sources = {source for source, _ in judged(30, chance(60))}
    assert sources == {pools.ALL, pools.SAME}  # 60 bodies are no pool of 100


def test_intervals_are_around_their_values():
    random = np.random.default_rng(0)
    vectors = {name: random.normal(size=(80, 3, 4)) for name in pools.MODALITIES}
    rows = pools.judge_retrieval(samples(40), np.arange(80), {**vectors, "material": np.arange(80) % 3})
    for row in rows:
        assert row.get("low", row["value"]) <= row["value"] <= row.get("high", row["value"])
    one = {row["measure"]: row for row in rows if row["source"] == pools.ALL}
    mean = np.mean([one[f"{a}_to_{b}_mrr"]["value"] for a, b in pools.DIRECTIONS])
    assert one["mean_mrr"]["value"] == pytest.approx(mean)
