"""The output of a run: bars on a terminal, else a line a minute; errors at once; a summary at the end.

Snakemake's own log file keeps every line. Snakemake's own output is shown if no job runs (``-n``, ``--lint``,
``--unlock``), or if the user asks for less (``--quiet``) or more (``--verbose``, ``-p``).
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

from vibraverse.contract.texts import and_more, counted, duration
from vibraverse.machine import internals
from vibraverse.machine.tally import Job, Stage, Tally

#: Lines shown from the end of a failed job's log.
SHOWN_LOG_LINES = 20
#: Failed jobs that the summary names.
_SHOWN_FAILURES = 10
#: Beginnings of Snakemake's messages that are shown while jobs run, besides warnings and errors.
_SHOWN_MESSAGES = ("Trying to restart", "Terminating processes", "Will exit after", "Shutting down")
#: Beginnings of messages that are hidden: they hold for every run, or repeat a failure or the summary.
_HIDDEN_MESSAGES = (
    "Assuming unrestricted shared", "Using shell", "Conda environments: ignored", "Singularity containers: ignored",
    "Select jobs to execute", "RuleException:\nCalledProcessError", "Exiting because a job execution failed",
    "WorkflowError:\nAt least one job did not complete",
)  # fmt: skip
_LOG_FILE_MESSAGE = "Complete log"
#: Events that appear in bars and lines only.
_COUNTED_EVENTS = (
    LogEvent.RUN_INFO,
    LogEvent.RESOURCES_INFO,
    LogEvent.JOB_STARTED,
    LogEvent.JOB_INFO,
    LogEvent.JOB_FINISHED,
)


class Console:
    """The handler that shows Snakemake's log records; ``settings`` are Snakemake's output settings."""

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
        """Show a log record, or count it."""
        if not self._shows:
            self._plain.handle(record)
            return
        event, message, begun = (
            getattr(record, "event", None),
            record.getMessage(),
            self._tally.began is not None,
        )
        if event is None and begun and message.startswith(_LOG_FILE_MESSAGE):
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
        elif event in _COUNTED_EVENTS or message.startswith(_HIDDEN_MESSAGES):
            pass
        elif not begun:
            self._plain.handle(record)
        elif record.levelno >= logging.WARNING or (event is None and message.startswith(_SHOWN_MESSAGES)):
            color = "red" if record.levelno >= logging.ERROR else "yellow"
            self._view.say(self._plain.format(record), color)

    def _begin(self, record) -> None:
        """Count a job that begins; start the progress with the first one."""
        about = ", ".join(str(value) for value in dict(record.wildcards or {}).values())
        first = self._tally.began is None
        with self._lock:
            self._tally.begin(str(record.jobid), Job(record.rule_name, about, record.output, record.log))
        if first and self._tally.began is not None:
            self._view.start()

    def close(self) -> None:
        """End the progress and print the summary."""
        if self._view.stop():
            with self._lock:
                text = summary(self._tally, self._log_file)
            print(text, file=self._stream, flush=True)


def failure(job: Job, record) -> str:
    """Return the text about a failed job: its rule and object, the reason, and the last lines of its logs."""
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
            return list(deque((line.rstrip("\n") for line in file), SHOWN_LOG_LINES))
    except OSError:
        return []


def summary(tally: Tally, log_file: str = "") -> str:
    """Return the summary of a run: what it made and where, what was refused, what failed, and the time it took."""
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
        lines += [f"    {job}: {', '.join(job.logs)}" for job in failed[:_SHOWN_FAILURES]]
        lines += [f"    {more}" for more in and_more(len(failed), _SHOWN_FAILURES)]
    if whole.running:
        lines.append(f"Interrupted: {counted(whole.running, 'job')}")
    return "\n".join([*lines, *([log_file] if log_file else [])])


def _made(rule: str, stage: Stage) -> str:
    return f"{rule} {stage.done}" + (f" ({stage.refused} refused)" if stage.refused else "")


def state(tally: Tally) -> str:
    """Return the progress of a run in one line."""
    whole = tally.whole
    parts = [f"{whole.done} of {whole.total} jobs done", f"{whole.running} running"]
    parts += [f"{whole.refused} refused"] if whole.refused else []
    parts += [f"{len(tally.failed)} failed"] if tally.failed else []
    return f"{', '.join(parts)}; {duration(tally.seconds())} so far, {time_left(tally)}"


def time_left(tally: Tally) -> str:
    """Return the estimated time left in words."""
    seconds, known = tally.seconds_left()
    if seconds is None:
        return "time left not known yet"
    return f"{'about' if known else 'more than'} {duration(seconds)} left"


class Lines:
    """Progress as a line every ``every_s`` seconds."""

    def __init__(self, tally: Tally, lock: threading.Lock, stream, every_s: float):
        self._tally, self._lock, self._stream, self._every_s = tally, lock, stream, every_s
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Print the jobs by stage, then the progress regularly."""
        stages = ", ".join(f"{rule} {stage.total}" for rule, stage in self._tally.stages.items())
        self._line(f"{counted(self._tally.whole.total, 'job')}: {stages}")
        self._thread = threading.Thread(target=self._print_states, daemon=True)
        self._thread.start()

    def _print_states(self) -> None:
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
        """Stop printing; return whether it had started."""
        thread, self._thread = self._thread, None
        self._ended.set()
        if thread is not None:
            thread.join()
        return thread is not None


class Bars:
    """Progress as a bar per stage, redrawn four times a second."""

    def __init__(self, tally: Tally, lock: threading.Lock, stream, nocolor: bool):
        from rich.console import Console as Terminal
        from rich.live import Live

        self._tally, self._lock = tally, lock
        self._terminal = Terminal(file=stream, no_color=nocolor, highlight=False)
        both = sys.stdout.isatty()  # otherwise the output of rules goes where the user redirects it
        self._live = Live(
            get_renderable=self._draw,
            console=self._terminal,
            transient=True,
            redirect_stdout=both,
            redirect_stderr=True,
        )
        self._started = False

    def start(self) -> None:
        """Start drawing."""
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
        """Stop drawing; return whether it had started."""
        started, self._started = self._started, False
        if started:
            self._live.stop()
        return started


def _draws_bars(stream) -> bool:
    """Return whether bars can be drawn: on a terminal, with Rich installed."""
    terminal = stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return terminal and importlib.util.find_spec("rich") is not None
