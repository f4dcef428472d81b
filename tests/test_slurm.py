"""What is asked of Slurm before the first job, with stand-ins for its commands, and that its silence loses no job."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import types

import pytest

from stand_ins import said, stub
from vibraverse.machine import slurm


@pytest.fixture
def cluster(bin_):
    """A Slurm of two partitions, of which one has GPUs, and an empty queue."""
    stub(bin_, "sinfo", "echo 'cpu*|64000|(null)|2:00:00'; echo 'gpu|32000|gpu:a100:2(S:0-1)|infinite'")
    stub(bin_, "squeue", "true")
    return bin_


@pytest.mark.parametrize(
    ("resources", "sentence"),
    [
        (
            {"slurm_partition": "fast"},
            "no partition 'fast', which the rule tets asks for; set slurm_partition in the profile to one of: cpu, gpu",
        ),
        ({"gpu": 1}, "asks for a GPU, but the partition cpu has none; GPUs are in: gpu;"),
        ({"mem_mb": 64001}, "asks for 64001 MB, but the largest node of the partition cpu has 64000 MB"),
        ({"slurm_partition": "gpu", "mem_mb": 40000}, "the partition gpu has 32000 MB"),
        (
            {"slurm_partition": "gpu", "gpu": 9},
            "asks for 9 GPUs, but no node of gpu has more than 2; no partition",
        ),
        (
            {"runtime": 121},
            "asks for 121 min, but a job in the partition cpu may take 120, and one that asks for",
        ),
    ],
)
def test_what_a_cluster_has_not(cluster, resources, sentence):
    assert sentence in said(slurm.check, [("sources", {"mem_mb": 1000}), ("tets", resources)])


def test_what_a_cluster_has(cluster):
    slurm.check([("train", {"gpu": 1, "slurm_partition": "gpu"}), ("tets", {"mem_mb": 4000})])


def test_a_slurm_that_does_not_answer(bin_, monkeypatch):
    stub(bin_, "sinfo", "echo 'slurm_load_partitions: Unable to contact slurm controller' >&2; exit 1")
    assert "Slurm does not answer (slurm_load_partitions: Unable" in said(slurm.check, [])
    monkeypatch.setenv("PATH", "/nowhere")
    assert "the command sinfo is not on the PATH" in said(slurm.check, [])


def test_jobs_of_an_earlier_run_are_waited_for(cluster, tmp_path):
    stub(cluster, "squeue", f"echo '17|{tmp_path}'; echo '18|/elsewhere'")
    sentence = said(slurm.check, [], tmp_path)
    assert f"an earlier run still has 1 Slurm job in {tmp_path};" in sentence
    assert "`scancel 17`" in sentence


@pytest.mark.parametrize("variable", ["SLURM_JOB_ID", "SLURM_ARRAY_JOB_ID"])
def test_the_job_that_a_run_is_part_of_is_no_earlier_one(cluster, tmp_path, monkeypatch, variable):
    """In a process of its own, which forgets the variable as Snakemake's Slurm plugin makes it."""
    stub(cluster, "squeue", f"for job in 17 17_1 '17_[2-9]' 170 171; do echo \"$job|{tmp_path}\"; done")
    monkeypatch.setenv(variable, "17")
    call = (
        "import os, sys; from vibraverse import preflight, slurm; del os.environ[sys.argv[1]];"
        "preflight.stop_without(slurm.check, [], sys.argv[2])"
    )
    done = subprocess.run([sys.executable, "-c", call, variable, tmp_path], capture_output=True, text=True)
    assert done.returncode == 2
    assert "still has 2 Slurm jobs in" in done.stderr
    assert "`scancel 170 171`" in done.stderr


def test_more_time_with_every_attempt_is_said_and_no_error(cluster, capsys):
    jobs = [
        ("basis", {"runtime": 60}),
        ("tets", {"runtime": 40}),
        ("train", {"runtime": 9999, "slurm_partition": "gpu"}),
    ]
    slurm.check(jobs, ".", None, 2)
    assert capsys.readouterr().err == ""
    slurm.check(jobs, ".", None, 3)
    said = capsys.readouterr().err
    assert said.startswith("vibraverse: a job of basis that fails")
    assert "120 min of the partition cpu" in said


@pytest.mark.parametrize(
    ("gres", "count"),
    [
        ("(null)", 0), ("gpu", 1), ("gpu:2", 2), ("gpu:tesla:4(S:0-1)", 4), ("gpu:1g.5gb", 1),
        ("shard:8,gpu:a100:2(S:0,1)", 2), ("gpu:a100:2,gpu:1g.5gb:7(S:0)", 9),
    ],
)  # fmt: skip
def test_gpus_of_a_node(gres, count):
    assert slurm._gpus(gres) == count


@pytest.mark.parametrize(
    ("limit", "minutes"),
    [("infinite", None), ("n/a", None), ("30:00", 30), ("2:00:00", 120), ("1-12:00:00", 2160), ("5", 5 / 60)],
)
def test_limits_of_time(limit, minutes):
    assert slurm._minutes(limit) == minutes


def test_a_cluster_without_accounts(cluster):
    """The run would wait for its first job for ever, without a word."""
    settings = types.SimpleNamespace(status_command="sacct", init_seconds_before_status_checks=None)
    stub(cluster, "sacct", "true")
    slurm.check([], ".", settings)
    stub(cluster, "sacct", "echo 'Slurm accounting storage is disabled' >&2; exit 1")
    sentence = said(slurm.check, [], ".", settings)
    assert (
        "keeps no accounts, or they do not answer (sacct: Slurm accounting storage is disabled)" in sentence
    )
    assert "write slurm-status-command: squeue and" in sentence
    settings.status_command = "squeue"
    stub(cluster, "scontrol", "echo 'MinJobAge               = 300 sec'")
    slurm.check([], ".", settings)
    stub(cluster, "scontrol", "echo 'MinJobAge               = 60 sec'")
    assert "must be below a third of that, not 40" in said(slurm.check, [], ".", settings)
    settings.init_seconds_before_status_checks = 15
    slurm.check([], ".", settings)


class Plugin:
    """As Snakemake's: where its questions fail, it neither reports a job nor gives it back."""

    def __init__(self, answers):
        self.answers, self.logger, self.ended = answers, types.SimpleNamespace(warning=self.warn), []
        self.warned = []

    def warn(self, text):
        self.warned.append(text)

    def report_job_success(self, job):
        self.ended.append(job)

    def report_job_error(self, job, msg=None):
        self.ended.append(f"{job}, in vain")

    async def check_active_jobs(self, active_jobs):
        state = self.answers.pop(0)
        if state is None:
            return
        for job in active_jobs:
            if state.get(job) == "done":
                self.report_job_success(job)
            elif state.get(job) == "failed":
                self.report_job_error(job, msg="no")
            else:
                yield job


def test_a_slurm_that_is_away_for_a_while_loses_no_job(monkeypatch):
    monkeypatch.setitem(
        sys.modules, "snakemake_executor_plugin_slurm", types.SimpleNamespace(Executor=Plugin)
    )
    slurm.be_patient()
    slurm.be_patient()
    plugin = Plugin([None, {}, None, {"a": "done", "b": "failed"}, None, {"c": "done"}])

    async def left(jobs):
        return [job async for job in plugin.check_active_jobs(jobs)]

    jobs = ["a", "b", "c"]
    counts = []
    while plugin.answers:
        jobs = asyncio.run(left(jobs))
        counts.append(len(jobs))
    assert counts == [3, 3, 3, 1, 1, 0]
    assert plugin.ended == ["a", "b, in vain", "c"]
    assert plugin.warned[0] == "Slurm does not answer; the run waits for its 3 jobs."
    assert len(plugin.warned) == 3


def test_the_plugin_is_built_as_expected():
    code = (
        "from snakemake_executor_plugin_slurm import Executor; from vibraverse import slurm; slurm.be_patient();"
        "assert Executor.check_active_jobs.is_patient and Executor.report_job_success and Executor.report_job_error"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
