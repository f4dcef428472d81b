"""Checks of Slurm before the first job, with stand-ins for its commands, and no lost jobs while it is silent."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import types

import pytest

from stand_ins import said, stub
from vibraverse.machine import internals, slurm


@pytest.fixture
def cluster(bin_):
    """A Slurm with two partitions, one of them with GPUs, and an empty queue."""
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
def test_what_a_cluster_lacks(cluster, resources, sentence):
    assert sentence in said(slurm.check, [("sources", {"mem_mb": 1000}, 1), ("tets", resources, 1)])


def test_what_a_cluster_has(cluster):
    slurm.check([("train", {"gpu": 1, "slurm_partition": "gpu"}, 1), ("tets", {"mem_mb": 4000}, 1)])


@pytest.mark.parametrize("resources", [{"runtime": 900}, {"mem_mb": 90_000}])
def test_a_group_that_no_node_takes(cluster, resources):
    sentence = said(slurm.check, [("basis, tets", resources, 40)])
    assert sentence.startswith("a group of 40 jobs (basis, tets) asks for 9")
    assert "lower group-components" in sentence


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
        "import os, sys; from vibraverse.machine import preflight, slurm; del os.environ[sys.argv[1]];"
        "preflight.stop_without(slurm.check, [], sys.argv[2])"
    )
    done = subprocess.run([sys.executable, "-c", call, variable, tmp_path], capture_output=True, text=True)
    assert done.returncode == 2
    assert "still has 2 Slurm jobs in" in done.stderr
    assert "`scancel 170 171`" in done.stderr


def test_more_time_with_every_attempt_is_said_and_no_error(cluster, capsys):
    jobs = [
        ("basis", {"runtime": 60}, 1),
        ("tets", {"runtime": 40}, 1),
        ("train", {"runtime": 9999, "slurm_partition": "gpu"}, 1),
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
    """Otherwise the run would silently wait for its first job for ever."""
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
    """As Snakemake's: where its questions fail, it neither reports a job nor gives it back.

    ``answers`` are Slurm's: what each job does, by its id; None where it does not answer.
    """

    def __init__(self, module, answers):
        self.module, self.answers, self.ended, self.warned = module, answers, [], []
        self.logger = types.SimpleNamespace(warning=self.warned.append)

    def report_job_success(self, job):
        self.ended.append(job.external_jobid)

    def report_job_error(self, job, msg=None):
        self.ended.append(f"{job.external_jobid}: {msg}")

    async def check_active_jobs(self, active_jobs):
        states, _ = await self.module.query_job_status(self.answers.pop(0), self.logger)
        for job in active_jobs if states is not None else ():
            state = states.get(job.external_jobid)
            if state == "done":
                self.report_job_success(job)
            elif state == "failed":
                self.report_job_error(job, msg="no")
            else:
                yield job

    def looks(self, jobs) -> list[int]:
        """Check jobs once per answer; return the number of jobs left after each."""

        async def left():
            return [job async for job in self.check_active_jobs(jobs)]

        counts = []
        while self.answers:
            jobs = asyncio.run(left())
            counts.append(len(jobs))
        return counts


@pytest.fixture
def plugin(monkeypatch):
    """A function that returns the patched plugin with these answers."""

    async def query(answer, logger):
        return answer, None if answer is None else 0.1

    class Executor(Plugin):
        pass

    module = types.SimpleNamespace(
        Executor=Executor, query_job_status=query, _status_lookup_ids=lambda name: [name, name.split("_")[0]]
    )
    monkeypatch.setitem(sys.modules, "snakemake_executor_plugin_slurm", module)
    internals.patch_slurm_plugin()
    internals.patch_slurm_plugin()
    return lambda *answers: Executor(module, list(answers))


def jobs(*ids: str) -> list:
    return [types.SimpleNamespace(external_jobid=name) for name in ids]


RUNNING = {"a": "running", "b": "running", "c": "running"}


def test_a_slurm_that_is_away_for_a_while_loses_no_job(plugin):
    away = plugin(None, RUNNING, None, {**RUNNING, "a": "done", "b": "failed"}, None, {"c": "done"})
    assert away.looks(jobs("a", "b", "c")) == [3, 3, 3, 1, 1, 0]
    assert away.ended == ["a", "b: no", "c"]
    assert away.warned[0] == "Slurm does not answer; the run waits for its 3 jobs."
    assert len(away.warned) == 3


def test_a_slurm_that_stays_away_is_waited_for(plugin, bin_):
    stub(bin_, "squeue", "exit 1")
    away = plugin(*[None] * (3 * internals.MAX_MISSING_ANSWERS))
    assert away.looks(jobs("a", "b")) == [2] * (3 * internals.MAX_MISSING_ANSWERS)
    assert away.ended == []


def test_a_job_that_slurm_has_lost_fails(plugin, bin_):
    """Jobs 1 and 3_7 (of an array) are lost; 2 is listed, and 4 is in the queue but not in the accounting."""
    stub(bin_, "squeue", "echo 2; echo 4")
    silence = internals.MAX_MISSING_ANSWERS
    lossy = plugin(*[{"2": "running"}] * (silence - 1), None, {"2": "running"}, {"2": "done"})
    assert lossy.looks(jobs("1", "2", "3_7", "4")) == [4] * silence + [2, 1]
    assert [line.split(":")[0] for line in lossy.ended] == ["1", "3_7", "2"]
    assert f"Slurm has lost job 1: {silence} answers in a row and the queue do not list it" in lossy.ended[0]


def test_a_job_that_is_listed_again_was_not_lost(plugin, bin_):
    stub(bin_, "squeue", "true")
    almost = [{}] * (internals.MAX_MISSING_ANSWERS - 1)
    late = plugin(*almost, {"3": "running"}, *almost, {"3_1": "done"})
    assert late.looks(jobs("3_1"))[-2:] == [1, 0]
    assert late.ended == ["3_1"]


def test_no_job_is_lost_while_the_queue_does_not_answer(plugin, bin_):
    stub(bin_, "squeue", f"[ -e {bin_}/works ]")
    slow, waiting = plugin(*[{}] * (2 * internals.MAX_MISSING_ANSWERS)), jobs("1")
    assert set(slow.looks(waiting)) == {1}
    (bin_ / "works").touch()
    slow.answers.append({})
    assert slow.looks(waiting) == [0]
