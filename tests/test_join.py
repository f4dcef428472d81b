"""``vibraverse join``: one view of several datasets that reads, checks and refuses as it should."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import make_products
from vibraverse.config.dataset import Dataset
from vibraverse.contract.products import sha256
from vibraverse.dataset import open as open_dataset
from vibraverse.dataset.split.assignment import split_of
from vibraverse.flow.paths import Paths


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> tuple[Path, Path]:
    """A workstation's dataset and a cluster's, with shards of the same names and one object in both."""
    folder = tmp_path_factory.mktemp("join")
    workstation, cluster = folder / "workstation", folder / "cluster"
    make_products.build(workstation)
    make_products.make(cluster, objects=("bar-0000", "ball-0007"))
    make_products.index(cluster, make_products.pack(cluster, groups=(("bar-0000",), ("ball-0007",))))
    return workstation / "dataset", cluster / "dataset"


@pytest.fixture
def view(two, tmp_path, vibraverse) -> Path:
    path = tmp_path / "all.h5"
    status, out, _ = vibraverse("join", *two, "-o", path)
    assert (status, out) == (0, f"{path} shows 4 objects of 2 datasets.\n")
    return path


def test_a_view_reads_as_a_dataset(two, view):
    assert view.stat().st_size < 50_000
    with open_dataset(view) as joined, open_dataset(two[1]) as cluster:
        assert joined.objects == ["ball-0000", "ball-0007", "bar-0000"]
        assert len(joined) == 4 + 4 + 8
        place = ("mode_shapes", "ball-0007", "solid", "steel")
        np.testing.assert_array_equal(joined.read(*place), cluster.read(*place))
        assert [row["object"] for row in joined.refusals] == ["ball-0000", "ball-0007", "leaf"]
        assert {row["shard"].rpartition("/")[2] for row in joined.items} == {"0.h5", "1.h5"}
        assert joined.making()[0]["tets"]["options"] == {"target_elements": 6000}


def test_copies_in_several_datasets_stand_on_one_side(two, tmp_path, vibraverse):
    """Balls have one shape: alone each goes where its id says, joined the later one follows the first."""
    shares = Dataset().splits
    names = (f"ball-{number:04d}" for number in range(1, 100))
    later = next(name for name in names if split_of(name, shares) != split_of("ball-0000", shares))
    third = tmp_path / "third"
    make_products.make(third, objects=(later,))
    make_products.index(third, make_products.pack(third, groups=((later,),)))
    assert vibraverse("join", two[0], third / "dataset", "-o", tmp_path / "v.h5")[0] == 0
    with open_dataset(two[0]) as alone, open_dataset(tmp_path / "v.h5") as joined:
        split = {item["object"]: item["split"] for item in joined.items}
        assert {item["object"]: item["split"] for item in alone.items}.items() <= split.items()
        assert split[later] == split["ball-0000"]
        assert joined.where(split=split[later]).objects == ["ball-0000", later]


def test_a_view_is_checked_through_its_links(view, vibraverse):
    assert vibraverse("check", view, "--sample", "0.5")[0] == 0


def test_a_view_joins_the_shards_of_one_dataset(two, tmp_path, vibraverse):
    assert vibraverse("join", two[0], "-o", tmp_path / "one.h5")[0] == 0
    with h5py.File(tmp_path / "one.h5") as h5:  # with nothing of ours
        assert h5["objects/bar-0000/solid/materials/steel/frequencies_hz"].shape == (64,)


def test_a_view_and_its_datasets_move_together(two, tmp_path, vibraverse):
    shutil.copytree(two[0].parent.parent, tmp_path / "moved/data")
    (tmp_path / "moved/views").mkdir()
    datasets = [tmp_path / "moved/data" / folder.parent.name / "dataset" for folder in two]
    assert vibraverse("join", *datasets, "-o", tmp_path / "moved/views/all.h5")[0] == 0
    (tmp_path / "moved").rename(tmp_path / "elsewhere")
    with open_dataset(tmp_path / "elsewhere/views/all.h5") as joined:
        assert joined.read("occupancy", "ball-0007").shape == (16, 16, 16)


def test_a_dataset_that_is_gone_is_one_sentence(two, tmp_path, vibraverse):
    copy = Path(shutil.copytree(two[1], tmp_path / "copy"))
    vibraverse("join", copy, "-o", tmp_path / "v.h5")
    copy.rename(tmp_path / "away")
    with (
        open_dataset(tmp_path / "v.h5") as joined,
        pytest.raises(
            FileNotFoundError, match=r"links to copy/shards/0.h5, which is not there; join the datasets again"
        ),
    ):
        joined.read("occupancy", "bar-0000")


def altered(two, tmp_path, change) -> Path:
    """Return a copy of the cluster's dataset whose shards say that they were made otherwise."""
    folder = Path(shutil.copytree(two[1], tmp_path / "other"))
    for shard in (folder / "shards").iterdir():
        with h5py.File(shard, "r+") as h5:
            making = json.loads(h5["making"].asstr()[()])
            change(making, h5)
            del h5["making"]
            h5["making"] = json.dumps(making)
    return folder


def elements(making, h5):
    making["tets"]["options"]["target_elements"] = 8000


def version(making, h5):
    making["basis"]["stage_version"] = 9


def steel(making, h5):
    making["modes"]["options"]["materials"] = {"steel": {"young_pa": 2.1e11}, "tin": {"young_pa": 5e10}}


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (elements, "tets.target_elements is 6000 and 8000"),
        (version, "basis.version is 1 and 9"),
    ],
)
def test_datasets_made_differently_are_one_sentence(two, tmp_path, vibraverse, change, difference):
    other = altered(two, tmp_path, change)
    status, _, errors = vibraverse("join", two[0], other, "-o", tmp_path / "v.h5")
    assert status == 2
    assert errors == (
        f"vibraverse: {two[0]} and {other} were not made alike: {difference}; only datasets of one configuration "
        "can be joined\n"
    )
    assert not (tmp_path / "v.h5").exists()


def test_what_changes_no_number_may_differ(two, tmp_path, vibraverse):
    def change(making, h5):
        making["clean"]["options"]["limits"] = {"seconds": 7}
        making["modes"]["libraries"] = {"numpy": "9"}

    assert vibraverse("join", two[0], altered(two, tmp_path, change), "-o", tmp_path / "v.h5")[0] == 0


def test_a_material_of_one_name_must_be_one_material(two, tmp_path, vibraverse):
    first = altered(two, tmp_path / "first", steel)

    def change(making, h5):
        steel(making, h5)
        making["modes"]["options"]["materials"]["steel"]["young_pa"] = 1.9e11
        del making["modes"]["options"]["materials"]["tin"]

    second = altered(two, tmp_path / "second", change)
    _, _, errors = vibraverse("join", first, second, "-o", tmp_path / "v.h5")
    assert "modes.materials.steel.young_pa is 210000000000.0 and 190000000000.0" in errors


def test_another_object_of_the_same_name_is_one_sentence(two, tmp_path, vibraverse):
    results = tmp_path / "third"
    make_products.make(results, objects=("bar-0000",), views=2)
    make_products.index(results, make_products.pack(results, groups=(("bar-0000",),)))
    third = Path(Paths(results).dataset)
    status, _, errors = vibraverse("join", two[0], third, "-o", tmp_path / "v.h5")
    assert status == 2
    assert "were not made alike: images.views is 3 and 2" in errors
    for shard in (third / "shards").iterdir():
        with h5py.File(shard, "r+") as h5:
            text = h5["making"].asstr()[()].replace('"views": 2', '"views": 3')
            del h5["making"]
            h5["making"] = text
    _, _, errors = vibraverse("join", two[0], third, "-o", tmp_path / "v.h5")
    assert (
        f"{two[0]} and {third} both hold 'bar-0000', and not the same; make one of them without it" in errors
    )


def test_what_is_joined_is_not_overwritten(two, view, tmp_path, vibraverse):
    shard = Path(shutil.copy(two[1] / "shards/0.h5", tmp_path / "0.h5"))
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "again").symlink_to(view)
    for inputs, out, words in (
        ([shard], shard, "is one of the files to join; name another for the view"),
        ([view], tmp_path / "again", "is one of the files to join"),
        ([two[0]], shard, "is there and no view of datasets; name a new file"),
        ([two[0]], tmp_path / "notes.txt", "is there and no view"),
        ([two[0]], tmp_path, "is there and no view"),
    ):
        before = sha256(out) if out.is_file() else ""
        status, _, errors = vibraverse("join", *inputs, "-o", out)
        assert (status, errors.count("\n")) == (2, 1)
        assert f"{out} {words}" in errors
        assert before == (sha256(out) if out.is_file() else "")
    assert vibraverse("join", two[1], "-o", view)[0] == 0  # a view is made anew


def test_no_dataset_is_one_sentence(tmp_path, vibraverse):
    status, _, errors = vibraverse("join", tmp_path, "-o", tmp_path / "v.h5")
    assert status == 2
    assert "holds no finished dataset" in errors
