"""All that the workflow knows of Snakemake's inner workings: what it reads there, and its two patches.

None of it is a public interface. :data:`TESTED` names the versions for which it holds, and a contract test
(``tests/test_internals.py``) holds the installed ones to it. A patch is applied to these versions only. What a run
reads is read in any version; where it does not exist, the run ends with one sentence.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from vibraverse.contract.errors import NotThere
from vibraverse.contract.texts import counted
from vibraverse.machine import slurm
from vibraverse.machine.preflight import stop_without

SNAKEMAKE, SLURM_PLUGIN = "snakemake", "snakemake-executor-plugin-slurm"
#: The versions for which everything here is known to hold. Raise a bound when the contract test passes with it.
TESTED = {SNAKEMAKE: ">=9.20,<9.28", SLURM_PLUGIN: ">=2.8,<2.9"}
#: Answers of Slurm in a row that do not list a job, after which it counts as lost. Looks are 40 to 180 s apart, and
#: accounts may lag behind the queue by minutes.
SILENT_LOOKS = 10

#: Schedulers for which a timer runs.
_WAITING: set = set()


def is_tested(package: str) -> bool:
    """Whether the installed version of a package is one of :data:`TESTED`."""
    from packaging.specifiers import SpecifierSet

    return SpecifierSet(TESTED[package]).contains(_installed(package), prereleases=True)


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "0"


def _patchable(package: str, without: str) -> bool:
    """Whether a package may be patched; where not, say so, and what a run is ``without`` the patch."""
    tested = is_tested(package)
    if not tested:
        print(
            f"vibraverse: {package} {_installed(package)} is left as it is, because its patch is tested with "
            f"{TESTED[package]} only: {without}; `make env` installs a tested version",
            file=sys.stderr,
        )
    return tested


# What a run reads


def _attribute(thing, path: str):
    """Return an inner attribute by its names from ``thing`` on."""
    found = thing
    for name in path.split("."):
        try:
            found = getattr(found, name)
        except AttributeError:
            raise NotThere(
                f"Snakemake {_installed(SNAKEMAKE)} has no {type(thing).__name__}.{path}, which this workflow reads; "
                f"it is tested with Snakemake {TESTED[SNAKEMAKE]}, which `make env` installs"
            ) from None
    return found


def _read(thing, path: str):
    """Return an inner attribute; end the process with one sentence where it does not exist."""
    return stop_without(_attribute, thing, path)


def config_files(workflow) -> list:
    """Return the files of ``--configfile``."""
    return list(_read(workflow, "overwrite_configfiles"))


def configuration(workflow, merged: Mapping) -> Mapping:
    """Return the configuration of ``--configfile`` alone where there is one, else ``merged``, Snakemake's own.

    Single keys of ``--config`` are in either.
    """
    return _read(workflow, "config_settings.overwrite_config") if config_files(workflow) else merged


def is_main_process(workflow) -> bool:
    """Whether this process plans the run, and is not one that Snakemake starts for a job."""
    return _read(workflow, "is_main_process")


def in_conda(workflow) -> bool:
    """Whether jobs run in environments that Snakemake makes with Conda."""
    from snakemake.settings.types import DeploymentMethod

    return DeploymentMethod.CONDA in _read(workflow, "deployment_settings.deployment_method")


def in_containers(workflow) -> bool:
    """Whether jobs run in images."""
    from snakemake.settings.types import DeploymentMethod

    return DeploymentMethod.APPTAINER in _read(workflow, "deployment_settings.deployment_method")


def apptainer_arguments(workflow) -> str:
    """Return what the profile gives to every ``apptainer exec``."""
    return _read(workflow, "deployment_settings.apptainer_args")


def rules_with_set_resources(workflow) -> Mapping:
    """Return the rules whose resources the profile sets."""
    return _read(workflow, "resource_settings.overwrite_resources")


def rule_names(workflow) -> set[str]:
    """Return the names of all rules so far."""
    return {rule.name for rule in _read(workflow, "rules")}


def executor(workflow) -> str:
    """Return the name of what runs the jobs: ``local``, ``slurm``. Known when the run starts."""
    return _read(workflow, "executor_plugin.name")


def executor_settings(workflow):
    """Return the settings of the executor's plugin. Known when the run starts."""
    return _read(workflow, "executor_settings")


class Waiting:
    """A job that is going to run. Its attributes are read when asked for: there may be hundreds of thousands."""

    __slots__ = ("_job",)

    def __init__(self, job):
        self._job = job

    @property
    def rule(self) -> str:
        """Its rule's name."""
        return _read(self._job, "rule.name")

    @property
    def wildcards(self):
        """Its wildcards by name."""
        return _read(self._job, "wildcards")

    @property
    def resources(self) -> Mapping:
        """Its resources at the first attempt."""
        return _read(self._job, "resources")

    @property
    def image(self) -> str | None:
        """Its rule's image."""
        return _read(self._job, "container_img_url")

    @property
    def image_file(self) -> str | None:
        """The file of its rule's image, which was fetched where it is a registry's."""
        return _read(self._job, "container_img_path")

    @property
    def is_local(self) -> bool:
        """Whether the process that plans the run executes it, too."""
        return _read(self._job, "is_local")

    @property
    def attempts(self) -> int:
        """How often it may run until it counts as failed."""
        return 1 + _read(self._job, "restart_times")


def waiting_jobs(workflow) -> list[Waiting]:
    """Return the jobs that are going to run. Known when the run starts."""
    return [Waiting(job) for job in _read(workflow, "dag.needrun_jobs")()]


def jobs_of_a_group(workflow) -> list[tuple[str, str | None]]:
    """Return rule and image of the jobs that this process runs as one job of a cluster; nothing in any other process.

    Such a job starts Snakemake twice: one puts the other, which runs the jobs, under Slurm's ``srun``.
    """
    if is_main_process(workflow) or "slurm-jobstep" in sys.argv:
        return []
    named = [spec.rulename for spec in _read(workflow, "dag_settings.target_jobs")]
    images = {rule.name: rule.container_img for rule in _read(workflow, "rules")}
    return [(name, images[name]) for name in named]


# How Snakemake itself shows a run


def own_handler(settings, stream):
    """Return Snakemake's own handler of log records, without host and reasons where ``--quiet`` chooses nothing."""
    from snakemake import logging
    from snakemake.settings.enums import Quietness

    quiet = set(settings.quiet or {Quietness.HOST, Quietness.REASON})
    shown = logging.DefaultFilter(
        quiet, settings.debug_dag, settings.verbose, settings.dryrun, settings.printshellcmds
    )
    written = logging.DefaultFormatter(quiet, settings.show_failed_logs)
    return logging.ColorizingTextHandler(settings.nocolor, stream, written, shown)


def shows_progress(settings) -> bool:
    """Whether jobs run and their progress is asked for, neither less nor more."""
    from snakemake.settings.enums import Quietness

    less = {Quietness.ALL, Quietness.PROGRESS} & set(settings.quiet or ())
    more = settings.verbose or settings.printshellcmds or settings.debug_dag
    return not (settings.dryrun or less or more)


# The patches


def mend_scheduler(workflow) -> None:
    """Let one timer wait for the scheduler's next look, however many jobs have finished.

    While jobs run, Snakemake looks at those that are ready when one has finished, and a second later again, for which
    a thread waits. Each such look makes it wait for another, so that after a thousand jobs a thousand threads look
    every second, which takes a core and in the end all threads that a user may have (Snakemake's issue 3804).
    """
    if not is_main_process(workflow):
        return  # it runs a single job, or a group
    if _patchable(
        SNAKEMAKE, "every job that ends leaves a thread, and a run of thousands takes a core for that"
    ):
        from snakemake.scheduling.job_scheduler import JobScheduler

        JobScheduler._schedule_reevalutation = _look_again  # with Snakemake's own spelling


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


def be_patient() -> None:
    """Let Snakemake's Slurm plugin wait for a Slurm that does not answer, and give up a job that Slurm has lost.

    By itself it forgets all jobs where a few of its questions in a row fail, as they do while Slurm restarts: the run
    then waits for nothing, for ever, and an interrupt cancels nothing. A job that Slurm's answers never list it waits
    for as long. Here such a job fails after :data:`SILENT_LOOKS` answers, where the queue does not list it either.
    """
    if not _patchable(SLURM_PLUGIN, "a run whose Slurm does not answer for a few minutes may wait for ever"):
        return
    import snakemake_executor_plugin_slurm as plugin

    original = plugin.Executor.check_active_jobs
    if hasattr(original, "patience"):
        return
    patience = _Patience(plugin, original)

    async def check_active_jobs(self, active_jobs):
        async for job in patience.check(self, active_jobs):
            yield job

    check_active_jobs.patience = patience
    plugin.Executor.check_active_jobs = check_active_jobs


class _Patience:
    """Looks at jobs as the Slurm plugin does, and knows of each how many answers in a row did not list it."""

    def __init__(self, plugin, look):
        self._look, self._plugin, self._query = look, plugin, plugin.query_job_status
        self._silent: dict[str, int] = {}
        self._listed = None
        plugin.query_job_status = self._note_answer

    async def _note_answer(self, command, logger):
        answer = await self._query(command, logger)
        self._listed = answer[0]
        return answer

    async def check(self, executor, active_jobs):
        """Yield the jobs that are still to be waited for; report the others' ends."""
        told, returned = set(), []
        self._listed = None
        for report in ("report_job_success", "report_job_error"):
            setattr(executor, report, _noting(getattr(type(executor), report).__get__(executor), told))
        async for job in self._look(executor, active_jobs):
            returned.append(job)
        unanswered = [job for job in active_jobs if id(job) not in told | {id(other) for other in returned}]
        if unanswered:
            executor.logger.warning(
                f"Slurm does not answer; the run waits for its {counted(len(unanswered), 'job')}."
            )
        lost = self._lost(returned) if self._listed is not None else set()
        for job in [*returned, *unanswered]:
            if id(job) in lost:
                executor.report_job_error(
                    job,
                    msg=f"Slurm has lost job {job.external_jobid}: {SILENT_LOOKS} answers in a row and the queue do "
                    "not list it, so that its end is not known. ",
                )
            else:
                yield job

    def _lost(self, jobs) -> set[int]:
        """Return the ``id()`` of jobs that neither the last answers nor the queue list; a silent queue lists all."""
        silent = [job for job in jobs if not self._is_listed(job.external_jobid)]
        self._silent = {job.external_jobid: self._silent.get(job.external_jobid, 0) + 1 for job in silent}
        overdue = [job for job in silent if self._silent[job.external_jobid] >= SILENT_LOOKS]
        queued = slurm.queued_jobs() if overdue else None
        if queued is None:
            return set()
        return {id(job) for job in overdue if _array(job.external_jobid) not in queued}

    def _is_listed(self, slurm_id: str) -> bool:
        return any(name in self._listed for name in self._plugin._status_lookup_ids(slurm_id))


def _array(slurm_id: str) -> str:
    """Return a job's id without its place in an array."""
    return slurm_id.split("_")[0]


def _noting(report, told: set):
    """Return a function that reports a job's end and notes that it did."""

    def noting(job, *arguments, **keywords):
        told.add(id(job))
        return report(job, *arguments, **keywords)

    return noting
