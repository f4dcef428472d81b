"""Slices of the objects: whole shards each, together everything, with locks that only overlapping runs notice."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import chain

import pytest

from vibraverse.config import ConfigError, parse
from vibraverse.contract.slices import shards_of_slice, slice_numbers
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import everything
from workflow_runs import TINY, Run

#: Two solid bars in two of three shards.
TWO = {
    **TINY,
    "sources": {"generated": {"count": 2, "families": ["bar"]}, "bundled": [], "files": []},
    "solidities": ["solid"],
    "dataset": {"shards": 3},
}


@pytest.mark.parametrize(("slices", "shards"), [(1, 1), (3, 7), (5, 5), (4, 100)])
def test_slices_share_the_shards_without_overlap_or_rest(slices, shards):
    parts = [shards_of_slice(f"{i}/{slices}", shards) for i in range(1, slices + 1)]
    assert sorted(chain(*parts)) == list(range(shards))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


@pytest.mark.parametrize("text", ["", "3", "0/5", "6/5", "-1/5", "1/0", "a/b", "1/2/3", "1.0/2", "all"])
def test_what_is_no_slice_is_one_sentence(text):
    with pytest.raises(ValueError, match=r"is not a slice; write 'join', or 3/50"):
        slice_numbers(text)
    with pytest.raises(ConfigError, match=r"^slice: "):
        parse({"slice": text})


def test_more_slices_than_shards_are_refused():
    with pytest.raises(ConfigError, match=r"^slice: .*dataset.shards is 4; raise it to 5 or more"):
        parse({"slice": "1/5"})


def test_a_shard_takes_so_many_objects_at_most():
    def values(count, shards):
        return {"sources": {"generated": {"count": count}, "bundled": []}, "dataset": {"shards": shards}}

    with pytest.raises(ConfigError) as caught:
        Plan(values(5000, 4))
    assert re.fullmatch(
        r"dataset.shards: 4 files for 5,000 objects put 1,\d{3} into one, and 1,000 are the most; set it to 50 .*",
        str(caught.value),
    )
    assert max(map(len, Plan(values(5000, 50)).shards.values())) < 200
    assert len(Plan(values(1000, 1)).objects) == 1000
    with pytest.raises(ConfigError, match="for 5,000 objects put 1,"):
        Plan({**values(5000, 4), "slice": "1/2"})


def test_the_plans_of_all_slices_are_the_whole_plan():
    values = {"sources": {"generated": {"count": 200}}, "dataset": {"shards": 12}}
    whole = Plan(values)
    parts = [Plan({**values, "slice": f"{i}/5"}) for i in range(1, 6)]
    assert sorted(chain(*(part.objects for part in parts))) == sorted(whole.objects)
    assert {shard: ids for part in parts for shard, ids in part.shards.items()} == whole.shards
    shown = [f"results/report/data/objects/{object_}.js" for object_ in whole.objects]
    assert sorted(chain(*map(everything, parts))) == sorted(
        [*(f"results/dataset/shards/{shard}.h5" for shard in whole.shards), *shown]
    )
    for part in parts:
        assert {int(shard) for shard in part.shards} <= set(part.owned)
    assert everything(Plan({**values, "slice": "join"})) == everything(whole)


def locked(folder, shards) -> subprocess.CompletedProcess:
    """Try to hold shards of a folder in another process."""
    program = f"from vibraverse.machine.locks import only_run; only_run({str(folder)!r}, {shards})"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("held", "asked", "refused"),
    [
        ([0, 2, 4], [1, 3], False),
        ([0, 2, 4], [0, 2, 4], True),
        ([0, 2, 4], [4, 5], True),
        ([0, 2, 4], None, True),
        (None, [3], True),
        (None, None, True),
    ],
)
def test_runs_exclude_each_other_where_they_overlap(tmp_path, held, asked, refused):
    holder = subprocess.Popen(
        [sys.executable, "-c",
         "from vibraverse.machine.locks import only_run; "
         f"only_run({str(tmp_path)!r}, {held}); print(1, flush=True); input()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert holder.stdout.readline() == "1\n"
        done = locked(tmp_path, asked)
        assert (done.returncode, f"another run (process {holder.pid})" in done.stderr) == (refused, refused)
    finally:
        holder.kill()
        holder.wait()
    assert locked(tmp_path, asked).returncode == 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory, root):
    """An undisturbed run of everything."""
    run = Run(tmp_path_factory.mktemp("whole"), root, TWO)
    run()
    return run


def test_slices_and_a_join_give_the_bytes_of_one_run(whole, root, tmp_path):
    run = Run(tmp_path, root, TWO)
    early = run("--config", "slice=join", check=False)
    assert early.returncode == 2
    assert "of them do not exist (000" in early.stdout + early.stderr
    # Two slices at once in one folder, from the same command but for its number.
    both = [run.start("--config", f"slice={i}/2") for i in (1, 2)]
    assert [process.wait() for process in both] == [0, 0]
    jobs, _ = run.plan("--config", "slice=join")
    assert jobs == {"index": 1, "report": 1, "verdict": 1, "all": 1}
    run("--config", "slice=join")
    assert run.checksums() == whole.checksums()
    assert run.plan()[0] == {}
    assert run.plan("--config", "slice=2/2")[0] == {}


def test_a_slice_runs_the_jobs_of_its_objects_alone(root, tmp_path):
    run = Run(tmp_path, root, TWO)
    plans = [run.plan("--config", f"slice={i}/3")[0] for i in range(1, 4)]
    assert sum(jobs.get("clean", 0) for jobs in plans) == 2
    assert sum(jobs.get("dataset", 0) for jobs in plans) == len(Plan(TWO).shards)
    assert not any("index" in jobs for jobs in plans)
