"""Claims on GPUs; a stand-in ``nvidia-smi`` reports two, the locks are real."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from vibraverse import cli
from vibraverse.machine import gpus, preflight

FIRST, SECOND = "GPU-11111111-aaaa", "GPU-22222222-bbbb"
COMMAND = (str(Path(sys.executable).parent / "vibraverse"), "gpus")


@pytest.fixture
def two(tmp_path, monkeypatch):
    """Two GPUs, of which the first is busier."""
    smi = tmp_path / "bin" / "nvidia-smi"
    smi.parent.mkdir()
    smi.write_text(
        f"#!/bin/sh\necho '0, {FIRST}, NVIDIA A, 81559, 900'\necho '1, {SECOND}, NVIDIA A, 81559, 4'\n"
    )
    smi.chmod(0o755)
    monkeypatch.setenv("PATH", f"{smi.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv(gpus.LOCKS, str(tmp_path / "locks"))
    for name in (gpus.VISIBLE, gpus.CLAIMED):
        monkeypatch.setenv(name, "")  # so that what is there later is undone
        monkeypatch.delenv(name)


def holder(count: int, seconds: float = 30.0) -> subprocess.Popen:
    """Start a program that has claimed GPUs; it prints which it sees, then sleeps."""
    program = f"import os, time; print(os.environ['{gpus.VISIBLE}'], flush=True); time.sleep({seconds})"
    return subprocess.Popen(
        [*COMMAND, "--claim", str(count), sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    )


def test_jobs_get_different_ones_the_idlest_first(two):
    with holder(1) as one, holder(1) as other:
        seen = [one.stdout.readline().strip(), other.stdout.readline().strip()]
        assert sorted(seen) == [FIRST, SECOND]
        assert all(map(gpus.claimed, gpus.visible()))
        with pytest.raises(gpus.NoGPU, match=r"a GPU did not come free in 0\.2 s"), gpus.Claim(1, 0.2):
            pass
        # However a job ends, its GPU is free at once, and the one that waits gets it.
        one.send_signal(signal.SIGKILL)
        one.wait()
        with gpus.Claim(1, 5) as claimed:
            assert [gpu.uuid for gpu in claimed] == [seen[0]]
        other.kill()


def test_the_idlest_is_taken_and_the_environment_is_put_back(two):
    with gpus.Claim() as claimed:
        assert [gpu.uuid for gpu in claimed] == [SECOND]
        assert os.environ[gpus.VISIBLE] == SECOND
        assert [gpu.uuid for gpu in gpus.visible()] == [SECOND]
    assert gpus.VISIBLE not in os.environ
    assert not any(map(gpus.claimed, gpus.visible()))


def test_a_partial_claim_claims_nothing(two):
    """A job that wants two and finds one claims nothing while it waits."""
    with holder(1) as one:
        one.stdout.readline()
        with holder(2) as both:
            time.sleep(1.5)
            with gpus.Claim(1, 5) as claimed:  # both's second try is at most a second away
                assert [gpu.uuid for gpu in claimed] == [FIRST]
            one.kill()
            assert sorted(both.stdout.readline().strip().split(",")) == [FIRST, SECOND]
            both.kill()


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        ("1", [SECOND]),
        ("1,0", [SECOND, FIRST]),
        ("GPU-111", [FIRST]),
        ("", []),
        ("0,7,1", [FIRST]),
        ("1,1", [SECOND]),
        ("GPU-", []),
    ],
)
def test_what_a_scheduler_shows_is_obeyed(two, monkeypatch, shown, expected):
    monkeypatch.setenv(gpus.VISIBLE, shown)
    assert [gpu.uuid for gpu in gpus.visible()] == expected


def test_too_few_are_said_in_a_sentence(two, monkeypatch, capsys):
    assert cli.main(["gpus", "--claim", "3", "true"]) == 2
    assert "3 GPUs asked for, but this machine has 2" in capsys.readouterr().err
    monkeypatch.setenv(gpus.VISIBLE, "1")
    assert cli.main(["gpus", "--claim", "2", "true"]) == 2
    assert "2 GPUs asked for, but CUDA_VISIBLE_DEVICES='1' shows 1; ask for fewer" in capsys.readouterr().err
    monkeypatch.delenv(gpus.VISIBLE)
    monkeypatch.setenv("PATH", "/nowhere")
    assert cli.main(["gpus", "--claim", "1", "true"]) == 2
    assert "a GPU asked for, but nvidia-smi finds no GPU here" in capsys.readouterr().err
    assert cli.main(["gpus"]) == 0
    assert "No GPU is visible here" in capsys.readouterr().out


def test_a_name_with_slashes_can_be_claimed(two, monkeypatch):
    monkeypatch.setenv(gpus.VISIBLE, "MIG-GPU-1/1/0")
    with gpus.Claim() as claimed:
        assert [gpu.uuid for gpu in claimed] == ["MIG-GPU-1/1/0"]


def test_a_claim_inside_a_claim_is_refused(two):
    done = subprocess.run(
        [*COMMAND, "--claim", "1", *COMMAND, "--claim", "1", "true"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "claimed already" in done.stderr


def test_temporary_folders_of_ones_own_do_not_matter(tmp_path, monkeypatch):
    monkeypatch.delenv(gpus.LOCKS, raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert gpus._folder() == Path("/tmp/vibraverse-gpus")
    private = tmp_path / "private"
    private.mkdir(mode=0o700)
    monkeypatch.setenv(gpus.LOCKS, str(private))
    assert gpus._folder().stat().st_mode & 0o777 == 0o700


def test_none_claimed_is_none_seen(two):
    seen = f"import os; print(repr(os.environ['{gpus.VISIBLE}']))"
    done = subprocess.run(
        [*COMMAND, "--claim", "0", sys.executable, "-c", seen], capture_output=True, text=True
    )
    assert done.stdout == "''\n", done.stderr
    with gpus.Claim(0) as none:
        assert none == []
        assert not any(map(gpus.claimed, gpus.visible()))


def test_mistakes_in_the_command(two, capsys):
    assert cli.main(["gpus", "--claim", "1"]) == 2
    assert cli.main(["gpus", "train"]) == 2
    assert cli.main(["gpus", "--claim", "1", "no-such-program"]) == 2
    assert "no-such-program cannot be run" in capsys.readouterr().err
    assert gpus.VISIBLE not in os.environ
    assert not any(map(gpus.claimed, gpus.visible()))


def test_the_list(two, capsys):
    with gpus.Claim():
        os.environ.pop(gpus.VISIBLE)
        assert cli.main(["gpus"]) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    assert [line.split()[-2:] for line in lines] == [["no", FIRST], ["yes", SECOND]]


def test_a_run_is_told_before_its_first_job(two, monkeypatch):
    preflight.local_gpus([("train", {"gpu": 2}), ("tets", {"mem_mb": 4000})])
    with pytest.raises(preflight.NotThere, match="the rule train: 4 GPUs asked for, but this machine has 2"):
        preflight.local_gpus([("train", {"gpu": 4}), ("tets", {})])
