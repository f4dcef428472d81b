"""Checkpoints: whole, of one training only, and safe from damage and full disks."""

from __future__ import annotations

import hashlib
import json
import os
import stat

import pytest

from vibraverse.contract.errors import NotStored, UsageError

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from toy_task import Toy, in_processes, options, run, same  # noqa: E402

from vibraverse.learn.checkpoint import Checkpoints  # noqa: E402
from vibraverse.learn.facts import identity  # noqa: E402

pytestmark = pytest.mark.learn

FACTS = {"config": {"depth": 5, "words": ["a", "b"]}, "data": "abc"}


def state(number: float) -> dict:
    return {
        "weights": {"w": torch.full((1000,), number)},
        "step": 3,
        "rows": [{"loss": 0.5, "validation": None}],
    }


@pytest.fixture
def kept(tmp_path) -> Checkpoints:
    return Checkpoints(tmp_path / "work", FACTS, {"torch": "2"})


def names(kept: Checkpoints) -> list[str]:
    return sorted(path.name for path in kept.folder.iterdir())


def test_the_last_two_are_kept(kept):
    assert kept.newest() is None
    for step in (5, 10, 100):
        kept.save(step, state(step))
    assert names(kept) == ["step-00000010", "step-00000100"]
    assert kept.newest() == 100
    loaded = kept.load(100)
    assert torch.equal(loaded["weights"]["w"], torch.full((1000,), 100.0))
    assert (loaded["step"], loaded["rows"]) == (3, [{"loss": 0.5, "validation": None}])


def test_a_checkpoint_says_whose_it_is(kept):
    folder = kept.save(5, state(1))
    record = json.loads((folder / "checkpoint.json").read_text())
    assert (record["step"], record["facts"], record["versions"]) == (5, FACTS, {"torch": "2"})
    assert record["sha256"] == hashlib.sha256((folder / "state.pt").read_bytes()).hexdigest()


def test_files_are_flushed_before_they_get_their_name(kept, monkeypatch):
    flushed, renamed = [], []
    fsync, replace = os.fsync, os.replace

    def note(handle):
        assert stat.S_ISREG(os.fstat(handle).st_mode)
        flushed.append(os.path.basename(os.readlink(f"/proc/self/fd/{handle}")))
        fsync(handle)

    def rename(old, new):
        renamed.append((os.path.basename(new), sorted(flushed)))
        replace(old, new)

    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(os, "replace", rename)
    kept.save(5, state(1))
    assert renamed == [("step-00000005", ["checkpoint.json", "state.pt"])]


@pytest.mark.parametrize("name", ["state.pt", "checkpoint.json"])
@pytest.mark.parametrize("damage", ["cut", "flipped", "gone", "empty"])
def test_a_damaged_checkpoint_gives_way_to_the_one_before(kept, name, damage):
    kept.save(5, state(5))
    file = kept.save(10, state(10)) / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x80
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes({"cut": content[: len(content) // 2], "flipped": content, "empty": b""}[damage])
    said = []
    assert kept.newest(said.append) == 5
    assert len(said) == 1
    assert said[0].startswith(f"warning: the checkpoint {file.parent} is damaged ({name} ")
    # The damaged one must not count as one of the last two.
    kept.save(8, state(8))
    assert names(kept) == ["step-00000005", "step-00000008"]


def test_without_a_whole_checkpoint_training_begins_anew(kept):
    for step in (5, 10):
        (kept.save(step, state(step)) / "state.pt").write_bytes(b"x")
    said = []
    assert kept.newest(said.append) is None
    assert len(said) == 2
    assert names(kept) == []


def test_leftovers_of_a_killed_run_go(kept):
    kept.save(5, state(5))
    (kept.folder / ".77.partial.step-00000010").mkdir()
    (kept.folder / ".77.partial.step-00000010" / "state.pt").write_bytes(b"half")
    (kept.folder / ".77.gone.partial.step-00000001").mkdir()
    assert kept.newest() == 5
    assert names(kept) == ["step-00000005"]


def test_a_checkpoint_of_other_facts_is_refused(kept):
    path = kept.save(5, state(5))
    other = {"config": {"depth": 6, "words": ["a", "b"]}, "data": "abc", "width": 2}
    with pytest.raises(UsageError) as refused:
        Checkpoints(kept.folder, other, {}).newest()
    assert str(refused.value) == (
        f"the checkpoint {path} belongs to another training: config.depth was 5 and is 6; width was null and is 2. A "
        f"checkpoint continues only the training that wrote it; undo the change, or remove {kept.folder} to train anew"
    )
    assert names(kept) == ["step-00000005"]


def test_nothing_but_plain_content_is_loaded(kept):
    """A checkpoint from somebody else must not run code."""

    class Evil:
        def __reduce__(self):
            return (os.system, ("true",))

    kept.save(5, {"model": Evil()})
    with pytest.raises(Exception, match="Weights only load failed"):
        kept.load(5)


def test_the_identity_depends_on_content_not_on_order():
    assert identity({"a": 1, "b": (1, 2)}) == identity({"b": [1, 2], "a": 1})
    assert identity({"a": 1}) != identity({"a": 2})
    assert len(identity({})) == 12


def test_a_full_disk_leaves_the_older_checkpoints(small_disk):
    kept = Checkpoints(small_disk("size=64k") / "work", FACTS, {})
    kept.save(5, state(5))
    kept.save(10, state(10))
    before = names(kept)
    with pytest.raises(NotStored) as refused:
        kept.save(15, {**state(15), "more": torch.zeros(20_000)})
    place = kept.folder / "step-00000015"
    assert str(refused.value) == (
        f"{place} cannot be written: No space left on device; free some space, then repeat the command."
    )
    assert names(kept) == before
    assert kept.newest() == 10
    assert torch.equal(kept.load(10)["weights"]["w"], state(10)["weights"]["w"])


def test_training_on_a_full_disk_ends_in_a_sentence_and_goes_on_later(small_disk, tmp_path):
    disk, filler, task, calls = small_disk("size=1m"), tmp_path / "disk" / "filler", Toy(), iter(range(99))

    def fill_up():
        if next(calls) == 5:
            free = os.statvfs(disk)
            filler.write_bytes(b"x" * (free.f_bavail * free.f_frsize - 4096))

    task.at_losses = fill_up
    with pytest.raises(
        NotStored, match=r"step-00000006 cannot be written: No space left on device; free some"
    ):
        run(disk / "work", task)
    assert sorted(path.name for path in (disk / "work").glob("*step*")) == ["step-00000004", "step-00000005"]
    filler.unlink()
    same(run(tmp_path / "whole"), run(disk / "work"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"learning_rate": 0.02}, r"training\.learning_rate was 0\.01 and is 0\.02\."),
        ({"seed": 4}, r"seed was 3 and is 4\."),
        ({"facts": {"data": "abd"}}, r'data was "abc" and is "abd"\.'),
    ],
)
def test_training_refuses_the_checkpoint_of_another(tmp_path, changes, said):
    run(tmp_path, steps=4)
    with pytest.raises(UsageError, match=f"belongs to another training: {said}"):
        run(tmp_path, **{"steps": 4, **changes})


def test_limits_and_workers_may_change_between_attempts(tmp_path):
    run(tmp_path, minutes=5)
    trained = run(tmp_path, minutes=6, workers=1, checkpoint_minutes=1)
    assert trained.metrics["steps"] == options().steps


def test_another_processs_refusal_reaches_all(tmp_path):
    run(tmp_path)

    def work(rank):
        with pytest.raises(UsageError, match="belongs to another training: seed was 3 and is 5"):
            run(tmp_path, seed=5)

    assert in_processes(work, 2, group=True) == [0, 0]
