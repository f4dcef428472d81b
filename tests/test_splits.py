"""Splits: stable while the dataset grows, with the requested shares, and with copies of a shape together."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest

import make_products
import vibraverse.dataset
from vibraverse.config import ConfigError
from vibraverse.config.dataset import Dataset
from vibraverse.contract import products
from vibraverse.contract.slices import shard_of
from vibraverse.dataset.split.assignment import assign, emptiness, split_of
from vibraverse.dataset.split.copies import groups, natural
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import kept_splits

SPLITS = Dataset().splits
TABLES = ("index", "columns", "parquet", "splits", "refusals")
OUTPUTS = (*TABLES, "record", "card", "overview", "croissant", "sums")


def alone(names) -> dict[str, str]:
    return {name: name for name in names}


def names(count: int, prefix: str = "object") -> list[str]:
    return [f"{prefix}-{number:04d}" for number in range(count)]


def test_splits_depend_on_the_id_alone():
    names = [f"object-{number:04d}" for number in range(4000)]
    found = [split_of(name, SPLITS) for name in names]
    shares = {split: found.count(split) / len(names) for split in SPLITS}
    assert shares["train"] == pytest.approx(0.8, abs=0.02)
    assert shares["validation"] == pytest.approx(0.1, abs=0.015)
    # Fixed for ever: these would change only with the hash.
    assert [split_of(name, SPLITS) for name in ("bowl-0007", "ball-0000", "ant")] == [
        "train",
        "test",
        "train",
    ]
    assert split_of("anything", {"all": 1.0}) == "all"
    assert {split_of(name, {"none": 0.0, "a": 0.5, "b": 0.5}) for name in names[:200]} == {"a", "b"}
    # Growing the training share moves objects only into training.
    grown = [split_of(name, {"train": 0.9, "validation": 0.05, "test": 0.05}) for name in names]
    assert all(new == "train" for old, new in zip(found, grown, strict=True) if old == "train")


def test_shards_fill_evenly():
    counts = np.bincount([shard_of(f"object-{number}", 8) for number in range(8000)], minlength=8)
    assert counts.min() > 850
    assert counts.max() < 1150


def test_growing_moves_nothing():
    before, after = (assign(alone(names(count)), SPLITS).split for count in (300, 2000))
    assert before.items() <= after.items()
    assert after == {name: split_of(name, SPLITS) for name in names(2000)}


def test_an_empty_split_is_said_with_what_fills_it():
    assert emptiness({"test": 1, "train": 8}) == ""
    assert emptiness({"test": 0, "train": 0}) == ""
    assert emptiness({"test": 0, "train": 8}).startswith(
        "The split test holds no object: take more objects, give it"
    )
    assert emptiness({"a": 0, "b": 0, "c": 1}).startswith(
        "The splits a and b hold no object: take more objects, give them"
    )
    # What is advised is true: ten objects of a stratum fill every split.
    for count in range(10, 30):
        members = names(count)
        found = assign(alone(members), SPLITS, dict.fromkeys(members, "files"))
        assert set(found.split.values()) == set(SPLITS)


def test_copies_follow_the_first_of_them():
    first = alone(names(400))
    copies = {f"zcopy-{number:04d}": f"object-{number:04d}" for number in range(400)}
    before, after = assign(first, SPLITS), assign({**first, **copies}, SPLITS)
    assert before.split.items() <= after.split.items()
    assert all(after.split[copy] == after.split[original] for copy, original in copies.items())
    # By their own hashes a third of them would stand elsewhere.
    assert sum(split_of(copy, SPLITS) != after.split[copy] for copy in copies) > 80
    assert after.rows()[-1] == {
        "object": "zcopy-0399", "split": after.split["object-0399"], "copy_of": "object-0399",
    }  # fmt: skip
    assert after.summary() == {"shapes": 400, "copies": 400, "most_of_one_shape": 2, "not_kept": []}


@pytest.mark.parametrize("count", [1, 7, 40, 503])
def test_stratified_splits_keep_the_shares_in_every_stratum(count):
    objects = names(count, "mine") + names(1000, "other")
    strata = {name: name.split("-")[0] for name in objects}
    found = assign(alone(objects), SPLITS, strata).split
    for stratum, size in (("mine", count), ("other", 1000)):
        counts = Counter(split for name, split in found.items() if strata[name] == stratum)
        assert all(abs(counts[split] - share * size) <= 1 for split, share in SPLITS.items())


def test_a_stratum_that_grows_moves_one_object_at_each_cut():
    moved = []
    for count in range(50, 250):
        objects = names(count + 1)
        before, after = (
            assign(alone(part), SPLITS, dict.fromkeys(part, "")).split for part in (objects[:-1], objects)
        )
        moved.append(sum(before[name] != after[name] for name in before))
    assert max(moved) <= 2
    # Another stratum's growth is none of its business.
    both = names(200) + names(300, "other")
    strata = {name: name.split("-")[0] for name in both}
    found = assign(alone(both), SPLITS, strata).split
    assert assign(alone(names(200)), SPLITS, strata).split.items() <= found.items()


def test_kept_splits_stay_and_the_others_fill_the_shares():
    kept = assign(alone(names(100)), SPLITS).split
    objects = names(1000)
    found = assign(alone(objects), SPLITS, dict.fromkeys(objects, ""), kept)
    assert kept.items() <= found.split.items()
    counts = Counter(found.split.values())
    assert all(abs(counts[split] - 1000 * share) <= 1 for split, share in SPLITS.items())
    # A smaller id that turns out to have the shape of a kept object follows it.
    kept = {"mug": "test"}
    first = {"a-mug": "a-mug", "mug": "a-mug"}
    assert set(assign(first, SPLITS, kept=kept).split.values()) == {"test"}
    # Two that were kept apart and are copies cannot both stay; it is said which one did not.
    found = assign(first, SPLITS, kept={"a-mug": "train", "mug": "test"})
    assert found.split == {"a-mug": "train", "mug": "train"}
    assert found.moved == ["mug"]
    assert assign(alone(["mug"]), SPLITS, kept={"gone": "test"}).moved == []


def test_a_missing_table_of_kept_splits_is_one_sentence(tmp_path):
    sources = {"generated": {"count": 1}, "bundled": []}
    with pytest.raises(
        ConfigError, match=r"^dataset\.keep_splits: the file nowhere\.tsv does not exist; name the "
    ):
        Plan({"sources": sources, "dataset": {"keep_splits": "nowhere.tsv"}})
    (tmp_path / "splits.tsv").write_text("object\tsplit\tcopy_of\n")
    plan = Plan({"sources": sources, "dataset": {"keep_splits": str(tmp_path / "splits.tsv")}})
    assert kept_splits(plan) == [str(tmp_path / "splits.tsv")]


def test_a_run_does_not_keep_the_table_it_writes(tmp_path):
    (tmp_path / "run/dataset").mkdir(parents=True)
    (tmp_path / "run/dataset/splits.tsv").write_text("object\tsplit\tcopy_of\n")
    (tmp_path / "link").symlink_to("run")
    kept = {"keep_splits": f"{tmp_path}/link/dataset/splits.tsv"}
    with pytest.raises(ConfigError, match=r"this run itself writes; copy it and name the copy$"):
        Plan({"results": f"{tmp_path}/run", "dataset": kept})
    Plan({"results": f"{tmp_path}/next", "dataset": kept})


def test_numbers_in_ids_are_numbers():
    ids = ["bowl-10", "bowl-9", "9", "bowl", "a1b2", "a1b10"]
    assert sorted(ids, key=natural) == ["9", "a1b2", "a1b10", "bowl", "bowl-9", "bowl-10"]


def fingerprint(seed: int) -> tuple:
    random = np.random.default_rng(seed)
    return np.sort(random.uniform(0.01, 0.1, 4)), np.sort(random.uniform(1, 20, 20))


def test_what_counts_as_a_copy():
    moments, spectrum = fingerprint(1)
    noise = np.random.default_rng(2).normal(size=20)
    near = {
        "copy": (moments * 1.002, spectrum * np.exp(0.002 * noise)),
        "mirrored": (moments, spectrum),
        "unknown": (moments * (1 + 1e-4), None),
        "fewer": (moments, spectrum[:12]),
    }
    far = {
        "stretched": (moments * [1, 1, 1.03, 1], spectrum),
        "thicker": (moments, spectrum * 1.02),
        "other-mode": (moments, np.append(spectrum[:19], spectrum[19] * 1.05)),
        "unknown-far": (moments * 1.005, None),
        "elsewhere": fingerprint(3),
    }
    for name, other in (near | far).items():
        found = groups({"0": (moments, spectrum), name: other})
        assert found == {"0": "0", name: "0" if name in near else name}
    assert groups({}) == {}


def test_copies_of_copies_stay_together():
    moments, spectrum = fingerprint(1)
    chain = {f"x{number}": (moments * 1.008**number, spectrum) for number in range(5)}
    assert set(groups(chain).values()) == {"x0"}


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """A dataset with copies of the ball in another shard: ``pebble-…`` have its shape."""
    results = tmp_path_factory.mktemp("grown") / "results"
    pebbles = tuple(f"pebble-{number:04d}" for number in range(6))
    paths = make_products.make(results, objects=(*make_products.OBJECTS, *pebbles))
    shards = make_products.pack(results, groups=(("ball-0000", "leaf"), ("bar-0000",), pebbles))
    make_products.index(results, shards)
    return paths, shards, pebbles


def test_copies_in_other_shards_stand_on_one_side(grown):
    paths, shards, pebbles = grown
    with vibraverse.dataset.open(paths.dataset) as reader:
        split = {item["object"]: item["split"] for item in reader.items}
        assert {split[name] for name in pebbles} == {split["ball-0000"]} == {"test"}
        assert "train" in {split_of(name, SPLITS) for name in pebbles}  # where their own hashes lead
        assert set(reader.where(split="test").objects) == {"ball-0000", *pebbles}
    assert products.read_json(paths.dataset_record)["copies"] == {
        "shapes": 2, "copies": 6, "most_of_one_shape": 7, "not_kept": [],
    }  # fmt: skip
    with vibraverse.dataset.open(shards[2]) as shard:  # inside its dataset
        assert {item["split"] for item in shard.items} == {"test"}


def test_a_shard_alone_knows_no_splits(grown, tmp_path):
    lone = tmp_path / "lone.h5"
    lone.write_bytes(grown[1][2].read_bytes())
    with vibraverse.dataset.open(lone) as reader:
        assert {item["split"] for item in reader.items} == {""}
        with pytest.raises(KeyError, match="open the dataset's folder"):
            reader.where(split="train")


def test_splits_of_an_earlier_dataset_are_kept(grown, tmp_path, vibraverse):
    _, shards, pebbles = grown
    outputs = [(f"--{name}", tmp_path / name) for name in OUTPUTS]

    def index(text: str, **options):
        (tmp_path / "kept.tsv").write_text(text)
        arguments = ("index", "--shards", *shards, "--kept", tmp_path / "kept.tsv")
        return vibraverse(*arguments, *sum(outputs, ()), "--options", json.dumps(options))

    header = "object\tsplit\tcopy_of\n"
    assert index(f"{header}pebble-0003\ttrain\t\nbar-0000\tvalidation\t\n")[0] == 0
    rows = dict(line.split("\t")[:2] for line in (tmp_path / "splits").read_text().splitlines()[1:])
    assert rows == {**dict.fromkeys(("ball-0000", *pebbles), "train"), "bar-0000": "validation"}
    for text, words in (
        ("no table\n", "is not the splits.tsv of a dataset"),
        (f"{header}bar-0000\ttrian\t\n", "unknown split 'trian'; did you mean 'train'?"),
    ):
        status, _, err = index(text)
        assert status == 2
        assert words in err.splitlines()[-1]
        assert "Traceback" not in err
    assert index(header, stratify="category")[0] == 0
