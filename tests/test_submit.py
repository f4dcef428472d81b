"""Submitting slices: the scripts for Slurm, and the checks before them."""

from __future__ import annotations

import re
import subprocess

import pytest

SINFO = (
    "#!/bin/sh\necho 'cpu*|24000|(null)|infinite'\necho 'gpu|48000|gpu:2|1-00:00:00'\n"
    "echo 'old|4000|(null)|30:00'\n"
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with a configuration of fifty shards."""
    (tmp_path / "config.yaml").write_text("results: my results\ndataset: {shards: 50}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def slurm(folder, monkeypatch):
    """Stand-ins for Slurm's commands; ``sbatch`` numbers the jobs from 101 and keeps what it gets."""
    commands = folder / "bin"
    commands.mkdir()
    sbatch = (
        f"#!/bin/sh\nn=$(ls {folder}/bin | grep -c job)\ncat > {folder}/bin/job$n\n"
        f'echo "$@" > {folder}/bin/arguments$n\nenv > {folder}/bin/environment$n\necho $((101 + n))\n'
    )
    scancel = f'#!/bin/sh\necho "$@" > {folder}/bin/cancelled\n'
    stubs = {"sinfo": SINFO, "squeue": "#!/bin/sh\n", "sbatch": sbatch, "scancel": scancel}
    for name, text in stubs.items():
        (commands / name).write_text(text)
        (commands / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(commands), prepend=":")
    return commands


def options(script: str) -> list[str]:
    return re.findall(r"^#SBATCH (.*)$", script, re.MULTILINE)


def test_the_dry_run_prints_both_scripts(folder, vibraverse):
    status, out, err = vibraverse(
        "submit", "--slices", 50, "--cores", 16, "--partition", "cpu", "--time", "1-0", "--at-most", 20, "--dry-run",
        "--", "--until", "audio",
    )  # fmt: skip
    assert status == 0, err
    slices, join = re.split(r"\n(?=#!)", out)
    assert options(slices) == [
        "--job-name=vibraverse-slice", "--array=1-50%20", "'--output=my results/logs/slices/%a.log'", "--ntasks=1",
        "--cpus-per-task=16", "--mem=65500", "--partition=cpu", "--time=1-0",
    ]  # fmt: skip
    (run,) = [line for line in slices.splitlines() if line.startswith("exec ")]
    assert run.endswith(
        '--resources mem_mb=64000 --cores 16 --until audio --config "slice=$SLURM_ARRAY_TASK_ID/50"'
    )
    assert "--mem=5500" in options(join)
    assert join.rstrip().endswith("--resources mem_mb=4000 --cores 1 --config slice=join")
    for script in (slices, join):
        assert subprocess.run(["bash", "-n"], input=script, text=True).returncode == 0
    assert not (folder / "my results").exists()


def test_the_join_waits_for_the_array(slurm, vibraverse):
    status, out, err = vibraverse("submit", "--slices", 5, "--cores", 4)
    assert status == 0, err
    assert "--array=1-5" in (slurm / "job0").read_text()
    assert "slice=join" in (slurm / "job1").read_text()
    assert (slurm / "arguments1").read_text() == "--parsable --dependency=afterany:101\n"
    assert "5 slices as job 101, and job 102 that joins" in out
    assert (slurm.parent / "my results/logs/slices").is_dir()


def test_the_users_defaults_hold_and_another_jobs_settings_do_not(slurm, vibraverse, monkeypatch):
    """Slurm prefers the variables to the script, so what an option says must not reach it as a variable, too."""
    kept = {"SLURM_CLUSTERS": "big", "SLURM_JWT": "token", "SLURM_CONF": "/slurm.conf"}
    defaults = {"SBATCH_ACCOUNT": "acoustics", "SBATCH_PARTITION": "gpu", "SBATCH_QOS": "long"}
    job = {"SLURM_JOB_ID": "17", "SLURM_MEM_PER_NODE": "100", "SBATCH_MEM_BIND": "local"}
    for name, value in {**kept, **defaults, **job}.items():
        monkeypatch.setenv(name, value)
    status, _, err = vibraverse("submit", "--slices", 5, "--cores", 11, "--account", "music")
    assert status == 0, err
    for n in range(2):
        said = options((slurm / f"job{n}").read_text())
        assert said[-3:] == ["--partition=gpu", "--account=music", "--qos=long"]
        lines = (slurm / f"environment{n}").read_text().splitlines()
        handed_on = dict(line.split("=", 1) for line in lines if line.startswith(("SLURM_", "SBATCH_")))
        assert handed_on == kept


@pytest.mark.parametrize("cancels", [True, False])
def test_without_its_join_the_array_is_cancelled(slurm, vibraverse, cancels):
    with (slurm / "sbatch").open("a") as script:
        script.write("[ $n = 0 ] || { echo 'sbatch: error: too many jobs' >&2; exit 1; }\n")
    if not cancels:
        (slurm / "scancel").write_text("#!/bin/sh\nexit 1\n")
    status, out, err = vibraverse("submit", "--slices", 5, "--cores", 4)
    assert (status, out) == (2, "")
    assert (
        "too many jobs; change the options that it names; the slices that it was to join, job 101, are "
        in err
    )
    assert err.endswith("cancelled\n" if cancels else "still queued: `scancel 101`\n")
    if cancels:
        assert (slurm / "cancelled").read_text() == "101\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--slices", 51], "dataset.shards is 50; raise it to 51 or more"),
        (["--slices", 0], "--slices must be at least 1"),
        (["--slices", 5, "--cores", 0], "--cores must be at least 1"),
        (["--slices", 5, "--mem-mb", 500], "--mem-mb must be more than"),
        (["--slices", 5, "--profile", "nowhere"], "nowhere is not a profile: "),
        (["--slices", 5, "--configfile", "no.yaml"], "no.yaml does not exist"),
        (["--slices", 5, "--", "--config", "results=other"], "--config cannot stand after --"),
        (["--slices", 5, "--", "--until", "audio", "-Cresults=other"], "-C cannot stand after --"),
        (["--slices", 5, "--", "--configfile=other.yaml"], "--configfile cannot stand after --"),
        (
            ["--slices", 5, "--partition", "fast"],
            "Slurm has no partition 'fast'; choose --partition from: cpu, gpu, old",
        ),
        (["--slices", 5, "--mem-mb", 2000, "--partition", "gpu,old"], "the join would ask for 5500 MB"),
        (["--slices", 5, "--cores", 16], "65500 MB, but the largest node of the partition cpu has 24000 MB"),
    ],
)
def test_a_request_that_cannot_be_is_one_sentence(slurm, vibraverse, arguments, sentence):
    status, out, err = vibraverse("submit", *arguments)
    assert (status, out) == (2, "")
    assert sentence in err
    assert len(err.splitlines()) == 1
    assert not list(slurm.glob("job*"))


def test_a_profile_that_hands_jobs_on_is_refused(slurm, root, vibraverse):
    status, _, err = vibraverse("submit", "--slices", 5, "--profile", root / "workflow/profiles/slurm")
    assert status == 2
    assert "hands jobs to slurm, but each element of the array runs its slice on its own node" in err


def test_jobs_of_an_earlier_run_are_waited_for(slurm, vibraverse):
    (slurm / "squeue").write_text(f'#!/bin/sh\necho "7|{slurm.parent}"\n')
    status, _, err = vibraverse("submit", "--slices", 5, "--cores", 1)
    assert status == 2
    assert "an earlier run still has 1 Slurm job in" in err


def test_without_slurm_nothing_is_submitted(folder, monkeypatch, vibraverse):
    monkeypatch.setenv("PATH", str(folder))
    status, _, err = vibraverse("submit", "--slices", 5)
    assert status == 2
    assert "the command sinfo is not on the PATH" in err
