"""The output of a run on a terminal and without one, with synthetic events and in runs of a small workflow."""

from __future__ import annotations

import io
import logging
import logging.handlers
import os
import pty
import re
import subprocess
import sys
import types
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from snakemake_interface_logger_plugins.common import LogEvent

from vibraverse.contract.refusal import Refusal
from vibraverse.contract.texts import duration
from vibraverse.machine.console import SHOWN_LOG_LINES, Console, state, summary
from vibraverse.machine.tally import Tally

SETTINGS = types.SimpleNamespace(
    quiet=None, dryrun=False, verbose=False, printshellcmds=False, debug_dag=False, show_failed_logs=True,
    stdout=False, nocolor=True,
)  # fmt: skip
#: Two stages of four objects: of number 2 a job fails, number 3 is refused.
SNAKEFILE = """
rule all:
    input: expand("made/objects/{object}/b", object=range(4))
rule first:
    output: "made/objects/{object}/a"
    log: "made/logs/{object}.a"
    shell: "sleep 0.6; echo working > {log}; touch {output}"
rule second:
    input: "made/objects/{object}/a"
    output: "made/objects/{object}/b"
    log: "made/logs/{object}.b"
    shell:
        "if [ {wildcards.object} = 2 ]; then echo 'no such valve' > {log}; exit 1; fi; "
        "if [ {wildcards.object} = 3 ]; then cp refusal {output}; else touch {output}; fi"
onsuccess: print("all is well")
onerror: print("something is wrong")
"""


class Clock:
    """A clock whose seconds a test sets."""

    def __init__(self):
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Events:
    """A source of Snakemake's records and of the time, for a console."""

    def __init__(self, **settings):
        self.clock, self.stream = Clock(), io.StringIO()
        self.tally = Tally(self.clock)
        changed = types.SimpleNamespace(**{**vars(SETTINGS), **settings})
        self.console = Console(changed, 3600, self.stream, self.tally)

    def send(self, event=None, message="", level=logging.INFO, **values) -> None:
        record = logging.LogRecord("snakemake", level, "", 0, message, None, None)
        vars(record).update(values, event=event)
        self.console.take(record)

    def begin(self, number: int, rule: str, output: str | Path = "made/objects/o/a", **wildcards) -> None:
        self.send(
            LogEvent.JOB_INFO, jobid=number, rule_name=rule, output=[str(output)], log=[f"made/{number}.log"],
            wildcards=wildcards,
        )  # fmt: skip

    def fail(self, number: int, log: list[str], **values) -> None:
        values = {"rule_msg": None, "aux": {}, "shellcmd": "vibraverse tets --object o", **values}
        self.send(
            LogEvent.JOB_ERROR, "Error in rule tets", logging.ERROR, jobid=number, rule_name="tets", output=[], log=log,
            **values,
        )  # fmt: skip

    @property
    def said(self) -> str:
        return self.stream.getvalue()


def test_jobs_are_counted_and_the_time_left_follows_from_their_means():
    run = Events()
    run.send(LogEvent.RUN_INFO, stats={"clean": 4, "tets": 2, "all": 1, "total": 7})
    assert run.said == ""
    run.begin(1, "clean")
    run.begin(2, "clean")
    assert re.fullmatch(r"\d\d:\d\d:\d\d 6 jobs: clean 4, tets 2\n", run.said)
    assert state(run.tally) == "0 of 6 jobs done, 2 running; 0 s so far, time left not known yet"
    run.clock.now = 10
    run.send(LogEvent.JOB_FINISHED, job_id=1)
    run.send(LogEvent.JOB_FINISHED, job_id=2)
    # Two jobs of 10 s, two at a time; no job of tets has ended.
    assert state(run.tally) == "2 of 6 jobs done, 0 running; 10 s so far, more than 10 s left"
    run.begin(3, "tets")
    run.begin(4, "clean")
    run.clock.now = 20
    run.send(LogEvent.JOB_FINISHED, job_id=4)
    run.clock.now = 50
    run.send(LogEvent.JOB_FINISHED, job_id=3)
    # A job of 10 s and one of 40 s; 70 s of work in 50 s so far.
    assert run.tally.seconds_left() == (pytest.approx(50 * 50 / 70), True)
    run.begin(5, "tets")
    run.clock.now = 60
    assert run.tally.seconds_left() == (pytest.approx(40 * 60 / 80), True)


def test_refusals_are_counted_where_they_arose(tmp_path):
    surface, sounds = tmp_path / "surface.ply", tmp_path / "sounds"
    surface.write_text(Refusal("o", "clean", "empty", "it is empty").to_text())
    sounds.mkdir()
    (sounds / "audio.json").write_text(surface.read_text())
    run = Events()
    run.send(LogEvent.RUN_INFO, stats={"clean": 1, "audio": 1})
    for number, (rule, output) in enumerate([("clean", surface), ("audio", sounds)]):
        run.begin(number, rule, output)
        run.send(LogEvent.JOB_FINISHED, job_id=number)
    assert state(run.tally).startswith("2 of 2 jobs done, 0 running, 2 refused")
    assert run.tally.refusals == {("clean", "empty"): 1}
    run.clock.now = 63
    assert summary(run.tally).splitlines() == [
        "2 of 2 jobs done in 1 min 3 s.",
        f"Made: clean 1 (1 refused), audio 1 (1 refused); in {tmp_path}",
        "Refused: empty 1 (at clean); what follows passes it on.",
    ]


def test_a_failed_job_is_said_at_once_with_the_end_of_its_log(tmp_path):
    log = tmp_path / "tets.log"
    log.write_text("".join(f"line {n}\n" for n in range(50)))
    run = Events()
    run.send(LogEvent.RUN_INFO, stats={"tets": 3})
    run.begin(1, "tets", object="chair", solidity="hollow")
    run.send(
        LogEvent.ERROR,
        "RuleException:\nCalledProcessError in file x",
        logging.ERROR,
        exception="RuleException",
    )
    run.fail(1, [str(log)], aux={"external_jobid": "17"}, rule_msg="SLURM status is: 'TIMEOUT'")
    lines = run.said.splitlines()[1:]
    assert lines[:4] == [
        "failed: tets of chair, hollow",
        "    SLURM status is: 'TIMEOUT'",
        "    external_jobid: 17",
        f"    log: {log}, its last lines:",
    ]
    assert lines[4:] == [f"        line {n}" for n in range(50 - SHOWN_LOG_LINES, 50)]
    run.send(None, "Trying to restart job 1.")
    run.send(None, "Select jobs to execute...")
    assert run.said.splitlines()[-1] == "Trying to restart job 1."
    # Made in the end, it did not fail; another one, without a log, is told by its command.
    run.begin(1, "tets", object="chair", solidity="hollow")
    run.send(LogEvent.JOB_FINISHED, job_id=1)
    run.begin(2, "tets", object="cup")
    run.fail(2, [str(tmp_path / "none.log")])
    assert run.said.endswith("is empty or does not exist\n    command:\n        vibraverse tets --object o\n")
    run.begin(3, "tets", object="vase")
    run.send(None, "Complete log(s): here.log")
    run.console.close()
    assert run.said.splitlines()[-5:] == [
        "Made: tets 1; in made/objects/o",
        "Failed: 1 job",
        "    tets of cup: made/2.log",
        "Interrupted: 1 job",
        "Complete log(s): here.log",
    ]
    run.console.close()
    assert run.said.count("Complete log") == 1


def test_warnings_are_shown_and_what_holds_for_every_run_is_not():
    run = Events()
    run.send(None, "Building DAG of jobs...")
    run.send(None, "Using shell: /usr/bin/bash")
    run.send(LogEvent.RESOURCES_INFO, "Provided cores: 2")
    run.begin(1, "clean")
    run.send(None, "Job 1 has been submitted with SLURM jobid 7")
    run.send(None, "Slurm does not answer; the run waits for its 3 jobs.", logging.WARNING)
    first, _, last = run.said.splitlines()
    assert (first, last) == (
        "Building DAG of jobs...",
        "Slurm does not answer; the run waits for its 3 jobs.",
    )


def test_a_run_without_jobs_has_no_end_to_show():
    run = Events()
    run.send(LogEvent.RUN_INFO, stats={"clean": 3})
    run.send(None, "Nothing to be done (all requested files are present and up to date).")
    run.send(None, "Complete log(s): here.log")
    run.console.close()
    assert [line.split()[0] for line in run.said.splitlines()] == ["Nothing", "Complete"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.6, "1 min"), (423, "7 min 3 s"), (7260, "2 h 1 min"), (183600, "2 d 3 h")],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


# Runs of Snakemake


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("shown")
    (place / "Snakefile").write_text(SNAKEFILE)
    (place / "refusal").write_text(Refusal("3", "second", "too_thin", "a wall is too thin").to_text())
    return place


def command(*arguments: str) -> list[str]:
    options = ["--logger", "vibraverse", "--cores", "2", "--nolock"]
    return [sys.executable, "-m", "snakemake", *options, *arguments]


def on_terminal(folder: Path, *arguments: str) -> tuple[int, str]:
    """Run Snakemake on a pseudo-terminal; return its exit status and its output without control codes."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    process = subprocess.Popen(
        command(*arguments), cwd=folder, env=environment, stdin=theirs, stdout=theirs, stderr=theirs
    )
    os.close(theirs)
    sent = b""
    while True:
        try:
            sent += os.read(ours, 65536)
        except OSError:  # nobody holds the terminal any more
            break
    os.close(ours)
    return process.wait(), re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", sent.decode()).replace("\r", "")


END = [
    "Made: first 4, second 3 (1 refused); in made/objects",
    "Refused: too_thin 1 (at second); what follows passes it on.",
    "Failed: 1 job",
    "    second of 2: made/logs/2.b",
]


def test_a_run_on_a_terminal_draws_bars(folder):
    assert "rich" in packages_distributions()
    status, sent = on_terminal(folder, "--forceall", "--keep-going")
    assert status == 1
    assert re.search(r"first +━+ +0/4 +2 running", sent)
    assert re.search(r"first +━+ +4/4", sent)
    assert re.search(r"second +━+.* 3/4 +1 refused", sent)
    assert re.search(r"all jobs +━+.* 7/8 ", sent)
    assert re.search(r"s so far, about \d+ s left", sent)
    assert "something is wrong" in sent
    assert "        no such valve\n" in sent
    lines = sent.splitlines()
    begin = next(n for n, line in enumerate(lines) if line.startswith("7 of 8 jobs done in "))
    assert lines[begin + 1 : begin + 5] == END
    assert lines[begin + 5].startswith("Complete log(s): ")
    assert "Job stats" not in sent


def test_a_run_without_a_terminal_writes_a_line_now_and_then_and_its_log_keeps_everything(folder):
    done = subprocess.run(
        command("--forceall", "--keep-going", "--logger-vibraverse-seconds", "1"), cwd=folder, capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stdout == "something is wrong\n"
    lines = done.stderr.splitlines()
    assert any(re.fullmatch(r"[\d:]+ 8 jobs: first 4, second 4", line) for line in lines)
    assert any(
        re.match(r"[\d:]+ \d of 8 jobs done, \d running.*; \d+ s so far, (about|more)", line)
        for line in lines
    )
    assert lines[-5:-1] == END
    failed = lines.index("failed: second of 2")
    assert lines[failed + 1 : failed + 3] == [
        "    log: made/logs/2.b, its last lines:",
        "        no such valve",
    ]
    assert "\x1b" not in done.stderr
    log = Path(lines[-1].removeprefix("Complete log(s): ")).read_text()
    for kept in (
        "rule first:",
        "Job stats:",
        "reason: ",
        "Finished jobid",
        "CalledProcessError",
        "no such valve",
    ):
        assert kept in log, kept


@pytest.mark.parametrize(
    ("arguments", "shown", "hidden"),
    [
        (["-n"], ["Job stats:", "rule second:", "This was a dry-run"], ["reason: ", "Workflow ID"]),
        (["-n", "--quiet", "host"], ["reason: "], []),
        (["--quiet", "all"], [], ["rule second:", "jobs done"]),
        (["-p"], ["rule second:", "touch made/objects/1/b", "steps (100%) done"], ["jobs done"]),
        (["--dag"], ["digraph snakemake_dag"], ["jobs done"]),
        (["--lint"], ["Lints for rule first"], ["jobs done"]),
        (["--unlock"], ["Unlocked working directory"], ["jobs done"]),
        (["--report", "report.html"], ["Report"], ["jobs done"]),
    ],
)
def test_without_jobs_or_with_other_verbosity_snakemakes_own_lines_are_shown(
    folder, arguments, shown, hidden
):
    target = (
        [] if arguments[0] in ("--lint", "--report", "--unlock") else ["made/objects/1/b", "made/objects/0/b"]
    )
    done = subprocess.run(
        [*command(), *target, "--forcerun", "second", *arguments], cwd=folder, capture_output=True, text=True
    )
    said = done.stdout + done.stderr
    assert done.returncode == (1 if arguments[0] == "--lint" else 0), said
    assert "Traceback" not in said
    for text in shown:
        assert text in said, said
    for text in hidden:
        assert text not in said, said
