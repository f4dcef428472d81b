"""Resource classes of the rules: the memory and time that a kind of job asks for.

A workstation schedules by threads; a cluster takes these as limits. Memory doubles and time grows with every
attempt, because Snakemake retries only jobs that failed on their machine.
"""

from __future__ import annotations

#: Class -> memory in MB and run time in minutes, for the first attempt.
CLASSES = {
    "light": (1000, 10),
    "geometry": (4000, 30),
    "solver": (6000, 60),
    "render": (2000, 20),
    "collect": (4000, 60),
    "train": (8000, 240),
}


def memory(kind: str, processes: int = 1):
    """Return the memory in MB of a class, for each of some processes, as a function of the attempt."""
    return lambda wildcards, attempt: processes * CLASSES[kind][0] * 2 ** (attempt - 1)


def minutes(kind: str):
    """Return the run time in minutes of a class, as a function of the attempt."""
    return lambda wildcards, attempt: CLASSES[kind][1] * attempt
