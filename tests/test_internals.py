"""The installed Snakemake and its Slurm plugin are built as ``machine/internals.py`` assumes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import pytest

from stand_ins import said, stub
from vibraverse.machine import internals

#: What the workflow reads of Snakemake while it parses the rules, and when a run starts.
SNAKEFILE = """
import json, sys, threading
from vibraverse.machine import internals

configfile: "lying.yaml"
localrules: near

if config.get("mend"):
    internals.patch_scheduler(workflow)

rule all:
    input: [f"out/{n}" for n in range(30)], "near"
rule far:
    output: "out/{object}"
    container: "docker://nowhere/image"
    retries: 2
    resources: mem_mb=5
    shell: "touch {output}"
rule near:
    output: "near"
    shell: "touch {output}"

def found():
    return {
        "configuration": dict(internals.configuration(workflow, config)),
        "files": [str(path) for path in internals.config_files(workflow)],
        "main": internals.is_main_process(workflow),
        "conda": internals.in_conda(workflow),
        "containers": internals.in_containers(workflow),
        "apptainer": internals.apptainer_arguments(workflow),
        "set": list(internals.rules_with_set_resources(workflow)),
        "rules": sorted(internals.rule_names(workflow)),
    }

print("parsed", json.dumps(found()))

onstart:
    settings = internals.executor_settings(workflow)
    started = {
        "executor": internals.executor(workflow),
        "settings": [getattr(settings, name, "?") for name in ("status_command", "init_seconds_before_status_checks")],
        "jobs": [
            [job.rule, dict(job.wildcards), job.resources.get("mem_mb"), job.image, job.is_local, job.attempts]
            for job in internals.waiting_jobs(workflow)
        ],
        "submitted": [
            [job.rule, job.size, job.resources.get("runtime"), job.is_local, job.attempts]
            for job in internals.submitted_jobs(workflow)
        ],
    }
    print("started", json.dumps(started))
    if started["executor"] == "slurm":
        sys.exit(3)
onsuccess:
    print("timers", sum(type(thread) is threading.Timer for thread in threading.enumerate()))
"""


def snakemake(folder: Path, *arguments: str) -> dict:
    """Run Snakemake; return what the rules printed, by its first word."""
    (folder / "Snakefile").write_text(SNAKEFILE)
    (folder / "lying.yaml").write_text("{lies: 1}")
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", *arguments], cwd=folder, capture_output=True, text=True
    )
    lines = [line.partition(" ") for line in done.stdout.splitlines()]
    return {word: json.loads(rest) for word, _, rest in lines if word in ("parsed", "started", "timers")} | {
        "said": done.stdout + done.stderr
    }


def test_snakemake_and_its_slurm_plugin_are_as_assumed(tmp_path, bin_):
    """The contract test. If it fails after an update, correct ``internals.py`` and set its version bounds."""
    assert internals.is_tested(internals.SNAKEMAKE)
    assert internals.is_tested(internals.SLURM_PLUGIN)

    # What is read, in a local run; with and without the mended scheduler.
    (tmp_path / "own.yaml").write_text("{truth: 2}")
    arguments = (
        "--cores", "4", "--configfile", "own.yaml", "--config", "mend=1", "--set-resources", "far:mem_mb=7",
    )  # fmt: skip
    seen = snakemake(tmp_path, *arguments)
    assert seen["parsed"] == {
        "configuration": {"truth": 2, "mend": 1}, "files": [str(tmp_path / "own.yaml")], "main": True,
        "conda": False, "containers": False, "apptainer": "", "set": ["far"], "rules": ["all", "far", "near"],
    }, seen["said"]  # fmt: skip
    assert seen.get("started", {}).get("executor") == "local", seen["said"]
    assert sorted(job for job in seen["started"]["jobs"] if job[0] != "far") == [
        ["all", {}, None, None, True, 1],
        ["near", {}, None, None, True, 1],
    ]
    far = [job for job in seen["started"]["jobs"] if job[0] == "far"]
    assert len(far) == 30
    assert ["far", {"object": "0"}, 7, "docker://nowhere/image", True, 3] in far
    assert seen["timers"] <= 1
    (tmp_path / "near").unlink()
    unmended = snakemake(tmp_path, "--cores", "4", "--forceall")
    assert unmended["timers"] > 3, "Snakemake leaks no threads any more: the patch can go"

    # What is read in images, and of the plugin for Slurm.
    stub(bin_, "apptainer", "echo apptainer version 1.3.0")
    stub(bin_, "singularity", "echo apptainer version 1.3.0")
    seen = snakemake(tmp_path, "-n", "--sdm", "apptainer", "--apptainer-args=--nv")
    assert seen["parsed"]["configuration"] == {"lies": 1}, seen["said"]
    told = {name: seen["parsed"][name] for name in ("files", "conda", "containers", "apptainer", "set")}
    assert told == {"files": [], "conda": False, "containers": True, "apptainer": "--nv", "set": []}
    seen = snakemake(
        tmp_path, "--forceall", "--executor", "slurm", "--jobs", "1", "--slurm-status-command", "sacct"
    )
    assert seen["started"]["executor"] == "slurm", seen["said"]
    assert seen["started"]["settings"] == ["sacct", 40]
    assert {(job[0], job[4]) for job in seen["started"]["jobs"]} == {
        ("all", True),
        ("near", True),
        ("far", False),
    }
    assert all(job[1] == 1 for job in seen["started"]["submitted"])
    seen = snakemake(
        tmp_path, "--forceall", "--executor", "slurm", "--jobs", "1", "--groups", "far=some",
        "--group-components", "some=10", "--default-resources", "runtime=5",
    )  # fmt: skip
    groups = [job for job in seen["started"]["submitted"] if job[1] > 1]
    assert groups == [["far", 10, 5, False, 3]] * 3, seen["said"]

    # What the plugin makes of Slurm's answers: neither reported nor returned without one, returned where not listed.
    stub(bin_, "sacct", "cat $0.out")
    jobs = [types.SimpleNamespace(external_jobid=name, aux={}) for name in ("17", "18_3")]
    assert look(bin_, None, jobs) == ([], [], None)
    assert look(bin_, "", jobs) == (["17", "18_3"], [], {})
    assert look(bin_, "17|COMPLETED\n18|RUNNING\n", jobs) == (
        ["18_3"],
        ["17"],
        {"17": "COMPLETED", "18": "RUNNING"},
    )


def look(bin_: Path, answer: str | None, jobs: list) -> tuple[list, list, dict | None]:
    """Let the plugin check jobs once; return the ids that it returns and reports, and the answers that it got."""
    import snakemake_executor_plugin_slurm as plugin

    (bin_ / "sacct.out").unlink(missing_ok=True)
    if answer is not None:
        (bin_ / "sacct.out").write_text(answer)
    answers, reported, query = [], [], plugin.query_job_status

    async def noting(command, logger):
        answers.append(await query(command, logger))
        return answers[-1]

    settings = types.SimpleNamespace(
        status_attempts=2, init_seconds_before_status_checks=40, keep_successful_logs=True
    )
    executor = types.SimpleNamespace(
        workflow=types.SimpleNamespace(executor_settings=settings), logger=logging.getLogger("looks"), run_uuid="x",
        get_status_command=lambda: "sacct", status_rate_limiter=contextlib.AsyncExitStack(),
        report_job_success=lambda job: reported.append(job.external_jobid),
        _status_query_failures=0, _status_query_calls=0, _status_query_total_seconds=0.0,
        _status_query_min_seconds=None, _status_query_max_seconds=0.0, _status_query_cycle_rows=[],
        next_seconds_between_status_checks=40,
    )  # fmt: skip

    async def left():
        return [job.external_jobid async for job in plugin.Executor.check_active_jobs(executor, jobs)]

    plugin.query_job_status = noting
    try:
        returned = asyncio.run(left())
    finally:
        plugin.query_job_status = query
    assert callable(plugin.Executor.report_job_success)
    assert callable(plugin.Executor.report_job_error)
    assert plugin._status_lookup_ids("18_3") == ["18_3", "18"]
    return returned, reported, answers[-1][0]


def test_an_untested_version_is_not_patched_and_one_line_says_so(monkeypatch, capsys):
    from snakemake.scheduling.job_scheduler import JobScheduler

    before = JobScheduler._schedule_reevalutation
    monkeypatch.setattr(internals, "TESTED", dict.fromkeys(internals.TESTED, "<1"))
    internals.patch_scheduler(types.SimpleNamespace(is_main_process=False))
    assert capsys.readouterr().err == ""
    internals.patch_scheduler(types.SimpleNamespace(is_main_process=True))
    internals.patch_slurm_plugin()
    assert JobScheduler._schedule_reevalutation is before
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("vibraverse: snakemake 9.")
    assert "is tested with <1 only: every job that ends leaves a thread" in first
    assert second.startswith("vibraverse: snakemake-executor-plugin-slurm 2.")


def test_what_snakemake_does_not_have_is_one_sentence(capsys):
    workflow = types.SimpleNamespace(deployment_settings=types.SimpleNamespace())
    assert "has no SimpleNamespace.deployment_settings.apptainer_args" in said(
        internals._attribute, workflow, "deployment_settings.apptainer_args"
    )
    with pytest.raises(SystemExit) as end:
        internals.apptainer_arguments(workflow)
    assert end.value.code == 2
    assert "is tested with Snakemake >=9.20" in capsys.readouterr().err


class Scheduler:
    """A scheduler that counts its evaluations and requests another one each time, as Snakemake's does."""

    def __init__(self):
        self._open_jobs = threading.Semaphore(0)
        self.looks = 0

    def run(self, seconds: float, delay: float) -> None:
        end = time.monotonic() + seconds
        while self._open_jobs.acquire(timeout=max(0.0, end - time.monotonic())):
            self.looks += 1
            internals._evaluate_later(self, delay)


def test_one_timer_waits_however_many_jobs_have_finished():
    scheduler = Scheduler()
    before = threading.active_count()
    for _ in range(500):
        scheduler._open_jobs.release()
    scheduler.run(0.3, delay=60)
    assert scheduler.looks == 500
    assert threading.active_count() <= before + 1


def test_evaluations_continue_after_a_timer():
    scheduler = Scheduler()
    for _ in range(5):
        scheduler._open_jobs.release()
    scheduler.run(5.0, delay=0.1)
    # A busy machine may make them fewer.
    assert 10 < scheduler.looks <= 5 + 50


def test_a_cluster_job_knows_its_group_by_its_command(monkeypatch):
    """Snakemake has no settings of its targets yet while it reads the rules of such a job."""
    rules = [
        types.SimpleNamespace(name="clean", container_img="geometry.sif"),
        types.SimpleNamespace(name="basis", container_img=None),
    ]
    inner, main = (types.SimpleNamespace(is_main_process=is_main, rules=rules) for is_main in (False, True))
    jobs = [
        "--target-jobs",
        "clean:object=a",
        "basis:object=a,solidity=solid",
        "--allowed-rules",
        "clean",
        "basis",
    ]
    monkeypatch.setattr(sys, "argv", ["snakemake", *jobs])
    assert internals.jobs_of_a_group(inner) == [("clean", "geometry.sif"), ("basis", None)]
    assert internals.jobs_of_a_group(main) == []
    monkeypatch.setattr(sys, "argv", ["snakemake", *jobs, "--executor", "slurm-jobstep"])
    assert internals.jobs_of_a_group(inner) == []
