"""Chains through a real Slurm, every job in its image: undisturbed, and after accidents; always the same checksums."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cluster_runs import CHAIN, HOLLOW, QUICK, call, running, slurm_script, wait_for

from stand_ins import stub
from workflow_runs import Run

#: Two jobs that wait for each other, and one that wants both their GPUs; each says which it sees.
GPU_RULES = """
rule all:
    input:
        "one.seen",
        "other.seen",
        "both.seen",


rule train:
    input:
        lambda wildcards: ["one.seen", "other.seen"] if wildcards.name == "both" else [],
    output:
        "{name}.seen",
    resources:
        gpu=lambda wildcards: 2 if wildcards.name == "both" else 1,
        slurm_partition="gpu",
        mem_mb=500,
        runtime=5,
    shell:
        "touch {wildcards.name}.began;"
        "vibraverse gpus --claim {resources.gpu} --wait 9 timeout 60 sh -c '"
        "until [ -e one.began ] && [ -e other.began ]; do sleep 1; done; echo $CUDA_VISIBLE_DEVICES; sleep 2"
        "' > {output}"
"""


def queue(*options: str) -> list[str]:
    """Return the jobs in the queue, as ``squeue`` lists them."""
    return call("squeue", "-h", *options).stdout.split()


def state(job: str) -> str:
    """Return the state of a job, ended or not."""
    return call("squeue", "-h", "-j", job, "-t", "all", "-o", "%T").stdout.strip()


def kept(run: Run) -> str:
    """Return what Snakemake's own logs of a folder's runs keep."""
    return "".join(log.read_text() for log in (run.folder / ".snakemake/log").glob("*.log"))


def test_a_chain_through_slurm_in_containers_gives_the_workstations_bytes(cluster_run, expected):
    cluster_run(*QUICK)
    assert cluster_run.checksums() == expected
    assert len([name for name in expected if name.endswith(".wav")]) == 2
    assert len(set(re.findall(r"SLURM jobid (\d+)", kept(cluster_run)))) == 8


def test_runs_with_and_without_images_continue_each_other(images, expected, root, tmp_path):
    """Run in images up to the hollow body, then without; check in between that the image's loops are compiled."""
    run = Run(tmp_path, root, HOLLOW, profile="apptainer")
    run("--until", "hollow")
    (image,) = images.glob("vibraverse-geometry-*.sif")
    for stage in ("clean", "grids", "hollow"):
        log = (run.folder / f"results/logs/bar-0000/{stage}.log").read_text()
        said = call(
            "apptainer", "exec", "--env", "NUMBA_DEBUG_CACHE=1", str(image), "bash", "-c", log.splitlines()[0],
            cwd=run.folder,
        )  # fmt: skip
        assert "data saved to" not in said.stdout + said.stderr, stage
    run.profile = "default"
    before = kept(run)
    run(*CHAIN)
    assert ": clean the surface" in before
    assert kept(run).count(": clean the surface") == before.count(": clean the surface")
    assert run.checksums() == expected


@pytest.mark.long
def test_a_cancelled_job_is_made_again(cluster_run, expected):
    process = cluster_run.start(*QUICK)
    job = wait_for(lambda: running("tets"))[0]
    call("scancel", job)
    assert process.wait(600) == 0
    assert state(job) == "CANCELLED"
    assert "Trying to restart" in kept(cluster_run)
    assert cluster_run.checksums() == expected


@pytest.mark.long
def test_a_job_killed_for_its_memory_gets_more(cluster_run, expected):
    done = cluster_run(*QUICK, "--set-resources", "tets:mem_mb=100 * 10 ** (attempt - 1)")
    assert "Trying to restart" in done.stdout + done.stderr
    assert cluster_run.checksums() == expected


@pytest.mark.long
def test_a_lost_node_costs_no_run(cluster_run, expected):
    process = cluster_run.start(*QUICK)
    job = wait_for(lambda: running("grids"))[0]
    node = call("squeue", "-h", "-j", job, "-o", "%N").stdout.strip()
    slurm_script("kill", node)
    try:
        wait_for(lambda: "down" in call("sinfo", "-h", "-n", node, "-o", "%t").stdout)
    finally:
        slurm_script("node", node)
    assert process.wait(900) == 0
    # Slurm itself may have queued it again, or left that to the run.
    lost = call("scontrol", "--oneliner", "show", "job", job).stdout
    assert re.search(r"Restarts=[1-9]|JobState=NODE_FAIL", lost), lost
    assert cluster_run.checksums() == expected


@pytest.mark.long
def test_a_controller_that_is_started_anew_costs_no_run(cluster_run, expected):
    """Jobs continue meanwhile, and the run keeps asking."""
    process = cluster_run.start(*QUICK)
    wait_for(lambda: running("grids"))
    slurm_script("away")
    try:
        logs = cluster_run.folder / ".snakemake/log"
        wait_for(
            lambda: any("Slurm does not answer; the run" in log.read_text() for log in logs.glob("*.log"))
        )
    finally:
        slurm_script("back")
    assert process.wait(900) == 0
    assert cluster_run.checksums() == expected


@pytest.mark.long
@pytest.mark.parametrize(("number", "end"), [(signal.SIGKILL, "COMPLETED"), (signal.SIGINT, "CANCELLED")])
def test_a_main_process_that_ends_is_started_again(cluster_run, expected, number, end):
    """SIGINT cancels the jobs; after SIGKILL they continue, and a new run reports them until they are done."""
    process = cluster_run.start(*QUICK)
    job = wait_for(lambda: running("tets"))[0]
    call("scontrol", "suspend", job)  # so that it does not end by itself, however slow the machine
    os.killpg(process.pid, number)
    process.wait(120)
    if number == signal.SIGKILL:
        call("scontrol", "resume", job)
        again = cluster_run(*QUICK, check=False)
        assert again.returncode == 2
        assert "an earlier run still has" in again.stdout + again.stderr
    wait_for(lambda: not queue("-t", "PENDING,RUNNING,COMPLETING"))
    assert state(job) == end
    cluster_run(*QUICK)
    assert cluster_run.checksums() == expected


@pytest.mark.long
@pytest.mark.parametrize(
    "grouping",
    [
        ("--groups", "sources=o", "clean=o", "grids=o", "hollow=o", "--group-components", "o=10"),
        ("--slurm-array-jobs", "all"),
    ],
)
def test_groups_and_arrays_give_the_same(cluster_run, expected, grouping):
    cluster_run(*QUICK, *grouping)
    assert cluster_run.checksums() == expected


@pytest.mark.long
def test_an_array_of_slices_and_its_join_give_the_bytes_of_one_run(slurm, root, tmp_path):
    """Two bodies in two slices, then the join, all submitted at once; nothing is left for a run of everything."""
    config = {
        **HOLLOW,
        "sources": {"generated": {"count": 2, "families": ["bar"]}, "bundled": [], "files": []},
    }
    config["dataset"] = {"shards": 3}  # the two bars are in the second and the third
    whole, parts = (Run(tmp_path / name, root, config) for name in ("whole", "parts"))
    for run in (whole, parts):
        run.folder.mkdir()
    whole()
    parts.command()  # writes the configuration
    vibraverse = str(Path(sys.executable).with_name("vibraverse"))
    said = call(vibraverse, "submit", "--slices", "2", "--cores", "1", "--mem-mb", "9000", cwd=parts.folder)
    again = subprocess.run(
        [vibraverse, "submit", "--slices", "2"], cwd=parts.folder, capture_output=True, text=True
    )
    assert "an earlier run still has" in again.stderr
    join = re.search(r"job (\d+) that joins", said.stdout)[1]
    wait_for(lambda: state(join) == "COMPLETED", 1200)
    assert parts.checksums() == whole.checksums()
    assert parts.plan()[0] == {}


@pytest.mark.long
def test_jobs_with_gpus_get_different_ones_and_one_with_two_gets_both(slurm, root, tmp_path, monkeypatch):
    """A user's own rule from docs/gpu.md, in the partition with two stand-in devices."""
    (tmp_path / "bin").mkdir()
    stub(
        tmp_path / "bin",
        "nvidia-smi",
        "echo '0, GPU-a, NVIDIA A, 81559, 4'; echo '1, GPU-b, NVIDIA A, 81559, 4'",
    )
    monkeypatch.setenv(
        "PATH", f"{tmp_path / 'bin'}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )
    (tmp_path / "Snakefile").write_text(GPU_RULES)
    profile = root / "workflow/profiles/slurm"
    options = QUICK[len(CHAIN) :]
    call("snakemake", "--workflow-profile", str(profile), *options, "--retries", "0", cwd=tmp_path)
    seen = {path.stem: path.read_text().strip() for path in tmp_path.glob("*.seen")}
    assert sorted([seen["one"], seen["other"]]) == ["GPU-a", "GPU-b"]
    assert sorted(seen["both"].split(",")) == ["GPU-a", "GPU-b"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--default-resources", "slurm_partition=fast"], "Slurm has no partition 'fast'"),
        (["--set-resources", "basis:gpu=1"], "asks for a GPU, but the partition cpu has none; GPUs are in: gpu"),
        (["--set-resources", "basis:mem_mb=10000000"], "asks for 10000000 MB, but the largest node"),
        (["--set-resources", "basis:runtime=9999"], "asks for 9999 min, but a job in the partition cpu may take 120"),
        (["--set-resources", "basis:gpu=9", "basis:slurm_partition=gpu"], "no node of gpu has more than 2"),
        (["--slurm-status-command", "sacct"], "this cluster keeps no accounts"),
    ],
)  # fmt: skip
def test_what_the_cluster_lacks_is_one_sentence_before_any_job(cluster_run, arguments, sentence):
    before = queue("-t", "all", "-o", "%i")
    done = cluster_run(*QUICK, *arguments, check=False)
    (said,) = [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("vibraverse: ")]
    assert (done.returncode, sentence in said) == (2, True), said
    assert queue("-t", "all", "-o", "%i") == before


def test_a_stopped_slurm_is_one_sentence(cluster_run):
    slurm_script("stop")
    try:
        done = cluster_run(*QUICK, check=False)
    finally:
        slurm_script("start")
    text = done.stdout + done.stderr
    assert done.returncode != 0
    assert "Slurm does not answer" in text, text
    assert subprocess.run(["sinfo"], capture_output=True).returncode == 0
