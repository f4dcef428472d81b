"""What spares Snakemake work does so in the version that is locked, and no job is forgotten."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

from vibraverse.machine import patches


def test_snakemake_is_built_as_expected():
    """Where it is not, its own slower ways are taken without a word: an update of the lock must not pass unnoticed."""
    code = (
        "import snakemake.cli, snakemake.jobs, snakemake.common, snakemake.rules;"
        "from snakemake.scheduling.job_scheduler import JobScheduler;"
        "from vibraverse import many_jobs; many_jobs.prepare(); many_jobs.prepare();"
        "assert snakemake.rules.get_function_params is snakemake.common.get_function_params;"
        "assert snakemake.rules.get_function_params.cache_info().maxsize;"
        "assert snakemake.jobs.Job.shellcmd.fget.remembers;"
        "assert JobScheduler._schedule_reevalutation is many_jobs._look_again"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class Scheduler:
    """Counts how often it looks, and asks for another look each time, as Snakemake's does."""

    def __init__(self):
        self._open_jobs = threading.Semaphore(0)
        self.looks = 0

    def run(self, seconds: float, delay: float) -> None:
        end = time.monotonic() + seconds
        while self._open_jobs.acquire(timeout=max(0.0, end - time.monotonic())):
            self.looks += 1
            patches._look_again(self, delay)


def test_one_look_waits_however_many_jobs_have_finished():
    scheduler = Scheduler()
    before = threading.active_count()
    for _ in range(500):
        scheduler._open_jobs.release()
    scheduler.run(0.3, delay=60)
    assert scheduler.looks == 500
    assert threading.active_count() <= before + 1


def test_looks_go_on_by_themselves():
    scheduler = Scheduler()
    for _ in range(5):
        scheduler._open_jobs.release()
    scheduler.run(5.0, delay=0.1)
    # A busy machine may make them fewer.
    assert 10 < scheduler.looks <= 5 + 50
