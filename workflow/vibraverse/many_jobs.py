"""What lets Snakemake plan hundreds of thousands of jobs in minutes: less looking at what does not change.

Nothing here changes a plan. Where a version of Snakemake is built otherwise, that part does nothing.
"""

from __future__ import annotations

import functools
import gc
import sys

#: The function that tells a function's parameters, and the modules that know it by name.
_ASKED, _ASKING = "get_function_params", ("snakemake.common", "snakemake.rules")


def prepare() -> None:
    """Spare this process, which runs Snakemake, a quarter of what planning many jobs takes.

    A plan is millions of small objects that live as long as the run, so no garbage is looked for until :func:`planned`;
    the parameters of a rule's functions are looked up once instead of three times for every resource of every job; and
    a job that is printed has its command formatted once instead of three times.
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
