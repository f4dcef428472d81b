"""What lets Snakemake plan hundreds of thousands of jobs in minutes, and run them: less looking.

Nothing here changes a plan. Where a version of Snakemake is built otherwise, that part does nothing.
"""

from __future__ import annotations

import functools
import gc
import sys
import threading

#: The function that tells a function's parameters, and the modules that know it by name.
_ASKED, _ASKING = "get_function_params", ("snakemake.common", "snakemake.rules")
#: The scheduler's method that has it look again later (with its own spelling), and the schedulers that will.
_LOOK_AGAIN, _WAITING = "_schedule_reevalutation", set()


def prepare() -> None:
    """Spare this process, which runs Snakemake, a quarter of what planning many jobs takes and most of running them.

    A plan is millions of small objects that live as long as the run, so no garbage is looked for until :func:`planned`;
    the parameters of a rule's functions are looked up once instead of three times for every resource of every job; and
    a job that is printed has its command formatted once instead of three times.

    While jobs run, Snakemake looks at those that are ready when one has finished, and a second later again, for which a
    thread waits. Each such look makes it wait for another, so that after a thousand jobs a thousand threads look every
    second, which takes a core and in the end all threads that a user may have (Snakemake's issue 3804). Here one waits.
    """
    gc.freeze()  # what is imported by now is not looked through at the end, either
    gc.disable()
    modules = [sys.modules[name] for name in _ASKING if hasattr(sys.modules.get(name), _ASKED)]
    asked = {getattr(module, _ASKED) for module in modules}
    if len(asked) == 1 and not hasattr(original := asked.pop(), "cache_info"):
        remembering = functools.lru_cache(maxsize=1024)(original)
        for module in modules:
            setattr(module, _ASKED, remembering)
    job = getattr(sys.modules.get("snakemake.jobs"), "Job", None)
    command = getattr(job, "shellcmd", None)
    if isinstance(command, property) and not hasattr(command.fget, "remembers"):
        job.shellcmd = property(_remembering_the_last(command.fget))
    scheduler = getattr(sys.modules.get("snakemake.scheduling.job_scheduler"), "JobScheduler", None)
    if hasattr(scheduler, _LOOK_AGAIN):
        setattr(scheduler, _LOOK_AGAIN, _look_again)


def _look_again(scheduler, delay: float) -> None:
    """Let a scheduler look at its jobs after ``delay`` seconds, or when it is going to anyway."""

    def look():
        _WAITING.discard(scheduler)
        scheduler._open_jobs.release()

    if scheduler not in _WAITING:
        _WAITING.add(scheduler)
        timer = threading.Timer(delay, look)
        timer.daemon = True  # a run that is done need not wait for it
        timer.start()


def _remembering_the_last(command):
    """Return the function of a job that gives what it gave last where it is asked of that job, and attempt, again."""
    last = None, None, None

    def remembering(job):
        nonlocal last
        known, attempt, formatted = last
        if known is not job or attempt != job.attempt:
            formatted = command(job)
            last = job, job.attempt, formatted
        return formatted

    remembering.remembers = True
    return remembering


def planned() -> None:
    """Say that the plan is made: it is no garbage, and what the run itself leaves is."""
    gc.freeze()
    gc.enable()
