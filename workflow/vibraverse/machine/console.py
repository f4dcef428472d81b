"""What a run shows: bars on a terminal, a line a minute without one, errors at once, and what was made at its end.

Snakemake's own log file keeps every line. Where nothing runs (``-n``, ``--lint``, ``--unlock``), or less is asked for
(``--quiet``) or more (``--verbose``, ``-p``), Snakemake's own lines are shown.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping

from snakemake_interface_logger_plugins.common import LogEvent

from vibraverse.contract.texts import counted, duration
from vibraverse.machine import internals
from vibraverse.machine.tally import Job, Stage, Tally

#: Lines of a failed job's log that are shown.
LAST_LINES = 20
#: Failed jobs that the end names.
_NAMED = 10
#: What is shown of Snakemake's other messages while jobs run, besides warnings and errors.
_TOLD = ("Trying to restart", "Terminating processes", "Will exit after", "Shutting down")
#: What is not shown: what holds for every run, and what a failed job's own text and the end say better.
_NOISE = (
    "Assuming unrestricted shared", "Using shell", "Conda environments: ignored", "Singularity containers: ignored",
    "Select jobs to execute", "RuleException:\nCalledProcessError", "Exiting because a job execution failed",
    "WorkflowError:\nAt least one job did not complete",
)  # fmt: skip
_LOG_FILE = "Complete log"
#: Events that are shown, if at all, as bars and lines.
_COUNTED = (
    LogEvent.RUN_INFO,
    LogEvent.RESOURCES_INFO,
    LogEvent.JOB_STARTED,
    LogEvent.JOB_INFO,
    LogEvent.JOB_FINISHED,
)


class Console:
    """Takes Snakemake's records and shows them. ``settings`` are Snakemake's for its output."""

    def __init__(self, settings, every_s: float, stream=None, tally: Tally | None = None):
        self._stream = stream or (sys.stdout if settings.stdout else sys.stderr)
        self._plain = internals.own_handler(settings, self._stream)
        self._shows = internals.shows_progress(settings)
        self._tally = tally or Tally()
        self._lock = threading.Lock()
        if _draws_bars(self._stream):
            self._view = Bars(self._tally, self._lock, self._stream, settings.nocolor)
        else:
            self._view = Lines(self._tally, self._lock, self._stream, every_s)
        self._log_file = ""

    def take(self, record: logging.LogRecord) -> None:
        """Show a record, or count it."""
        if not self._shows:
            self._plain.handle(record)
            return
        event, message, begun = (
            getattr(record, "event", None),
            record.getMessage(),
            self._tally.began is not None,
        )
        if event is None and begun and message.startswith(_LOG_FILE):
            self._log_file = message
        elif event == LogEvent.RUN_INFO:
            with self._lock:
                self._tally.plan(record.stats)
        elif event == LogEvent.JOB_INFO:
            self._begin(record)
        elif event == LogEvent.JOB_FINISHED:
            with self._lock:
                self._tally.end(str(record.job_id))
        elif event == LogEvent.JOB_ERROR:
            with self._lock:
                job = self._tally.fail(str(record.jobid))
            self._view.say(
                failure(job or Job(record.rule_name, "", record.output, record.log), record), "red"
            )
        elif event in _COUNTED or message.startswith(_NOISE):
            pass
        elif not begun:
            self._plain.handle(record)
        elif record.levelno >= logging.WARNING or (event is None and message.startswith(_TOLD)):
            color = "red" if record.levelno >= logging.ERROR else "yellow"
            self._view.say(self._plain.format(record), color)

    def _begin(self, record) -> None:
        """Count a job that begins; the first one begins the progress."""
        about = ", ".join(str(value) for value in dict(record.wildcards or {}).values())
        first = self._tally.began is None
        with self._lock:
            self._tally.begin(str(record.jobid), Job(record.rule_name, about, record.output, record.log))
        if first and self._tally.began is not None:
            self._view.start()

    def close(self) -> None:
        """End the progress and show what the run made."""
        if self._view.stop():
            with self._lock:
                text = summary(self._tally, self._log_file)
            print(text, file=self._stream, flush=True)


def failure(job: Job, record) -> str:
    """Return what is to be said of a failed job: its rule and object, why, and the last lines of its logs."""
    lines = [f"failed: {job}"]
    why = " ".join(str(record.rule_msg or "").split())
    lines += [f"    {why}"] if why else []
    lines += [f"    {name}: {value}" for name, value in (record.aux or {}).items()]
    shown = False
    for log in record.log:
        last = _last_lines(log)
        shown = shown or bool(last)
        lines += [f"    log: {log}" + (", its last lines:" if last else ", which is empty or does not exist")]
        lines += [f"        {line}" for line in last]
    if not shown and record.shellcmd:
        lines += ["    command:", f"        {record.shellcmd}"]
    return "\n".join(lines)


def _last_lines(path: str) -> Iterable[str]:
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return list(deque((line.rstrip("\n") for line in file), LAST_LINES))
    except OSError:
        return []


def summary(tally: Tally, log_file: str = "") -> str:
    """Return what a run made, where, what was refused and failed, and how long it took."""
    whole = tally.whole
    made = ", ".join(_made(rule, stage) for rule, stage in tally.stages.items() if stage.done)
    lines = [f"{whole.done} of {counted(whole.total, 'job')} done in {duration(tally.seconds())}."]
    lines += [f"Made: {made}; in {tally.place or '.'}"] if made else []
    if tally.refusals:
        reasons = ", ".join(
            f"{reason} {count} (at {stage})" for (stage, reason), count in tally.refusals.most_common()
        )
        lines.append(f"Refused: {reasons}; what follows passes it on.")
    if tally.failed:
        lines.append(f"Failed: {counted(len(tally.failed), 'job')}")
        failed = list(tally.failed.values())
        lines += [f"    {job}: {', '.join(job.logs)}" for job in failed[:_NAMED]]
        lines += [f"    and {len(failed) - _NAMED} more"] if len(failed) > _NAMED else []
    if whole.running:
        lines.append(f"Interrupted: {counted(whole.running, 'job')}")
    return "\n".join([*lines, *([log_file] if log_file else [])])


def _made(rule: str, stage: Stage) -> str:
    return f"{rule} {stage.done}" + (f" ({stage.refused} refused)" if stage.refused else "")


def state(tally: Tally) -> str:
    """Return how far a run is, in one line."""
    whole = tally.whole
    parts = [f"{whole.done} of {whole.total} jobs done", f"{whole.running} running"]
    parts += [f"{whole.refused} refused"] if whole.refused else []
    parts += [f"{len(tally.failed)} failed"] if tally.failed else []
    return f"{', '.join(parts)}; {duration(tally.seconds())} so far, {time_left(tally)}"


def time_left(tally: Tally) -> str:
    """Return about how long the rest takes, in words."""
    seconds, known = tally.seconds_left()
    if seconds is None:
        return "time left not known yet"
    return f"{'about' if known else 'more than'} {duration(seconds)} left"


class Lines:
    """A line every so many seconds."""

    def __init__(self, tally: Tally, lock: threading.Lock, stream, every_s: float):
        self._tally, self._lock, self._stream, self._every_s = tally, lock, stream, every_s
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Say what is going to be made, then how far that is."""
        stages = ", ".join(f"{rule} {stage.total}" for rule, stage in self._tally.stages.items())
        self._line(f"{counted(self._tally.whole.total, 'job')}: {stages}")
        self._thread = threading.Thread(target=self._go_on, daemon=True)
        self._thread.start()

    def _go_on(self) -> None:
        while not self._ended.wait(self._every_s):
            with self._lock:
                text = state(self._tally)
            self._line(text)

    def _line(self, text: str) -> None:
        self.say(f"{time.strftime('%H:%M:%S')} {text}")

    def say(self, text: str, color: str = "") -> None:
        """Write a text."""
        print(text, file=self._stream, flush=True)

    def stop(self) -> bool:
        """End; return whether there was anything to end."""
        thread, self._thread = self._thread, None
        self._ended.set()
        if thread is not None:
            thread.join()
        return thread is not None


class Bars:
    """A bar for each stage, drawn anew four times a second."""

    def __init__(self, tally: Tally, lock: threading.Lock, stream, nocolor: bool):
        from rich.console import Console as Terminal
        from rich.live import Live

        self._tally, self._lock = tally, lock
        self._terminal = Terminal(file=stream, no_color=nocolor, highlight=False)
        both = sys.stdout.isatty()  # else what rules print goes where it is sent
        self._live = Live(
            get_renderable=self._draw,
            console=self._terminal,
            transient=True,
            redirect_stdout=both,
            redirect_stderr=True,
        )
        self._started = False

    def start(self) -> None:
        """Begin to draw."""
        self._started = True
        self._live.start()

    def _draw(self):
        """Return the table of bars."""
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        with self._lock:
            rows: Mapping = {**self._tally.stages, "all jobs": self._tally.whole}
            for name, stage in rows.items():
                table.add_row(
                    name,
                    ProgressBar(total=max(1, stage.total), completed=stage.done, width=30),
                    f"{stage.done}/{stage.total}",
                    f"{stage.running} running" if stage.running else "",
                    f"{stage.refused} refused" if stage.refused else "",
                )
            failed = f", {counted(len(self._tally.failed), 'job')} failed" if self._tally.failed else ""
            table.caption = f"{duration(self._tally.seconds())} so far, {time_left(self._tally)}{failed}"
        table.caption_justify = "left"
        return table

    def say(self, text: str, color: str = "") -> None:
        """Write a text above the bars."""
        from rich.text import Text

        self._terminal.print(Text(text, style=color), soft_wrap=True)

    def stop(self) -> bool:
        """End; return whether there was anything to end."""
        started, self._started = self._started, False
        if started:
            self._live.stop()
        return started


def _draws_bars(stream) -> bool:
    """Whether bars can be drawn: on a terminal, where the library for it is installed."""
    terminal = stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return terminal and importlib.util.find_spec("rich") is not None
