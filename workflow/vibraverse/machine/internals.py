"""Everything that depends on Snakemake's internals: the attributes that a run reads, and two patches.

None of it is a public interface. :data:`TESTED` names the versions for which it holds; a contract test
(``tests/test_internals.py``) checks the installed ones. Patches are applied to these versions only. Attributes are read
in any version; if one does not exist, the run ends with one sentence.
"""

from __future__ import annotations

import itertools
import shlex
import sys
import threading
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from vibraverse.contract.errors import NotThere
from vibraverse.contract.texts import counted
from vibraverse.machine import slurm
from vibraverse.machine.preflight import stop_without

SNAKEMAKE, SLURM_PLUGIN = "snakemake", "snakemake-executor-plugin-slurm"
#: The versions for which this module holds. Raise a bound when the contract test passes with it.
TESTED = {SNAKEMAKE: ">=9.20,<9.28", SLURM_PLUGIN: ">=2.8,<2.9"}
#: Successive answers of Slurm without a job after which it counts as lost. The plugin asks every 40 to 180 s, and the
#: accounting may lag behind the queue by minutes.
MAX_MISSING_ANSWERS = 10

#: Schedulers that have a running timer.
_TIMED_SCHEDULERS: set = set()


def is_tested(package: str) -> bool:
    """Return whether the installed version of a package is one of :data:`TESTED`."""
    from packaging.specifiers import SpecifierSet

    return SpecifierSet(TESTED[package]).contains(_installed(package), prereleases=True)


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "0"


def _patchable(package: str, without: str) -> bool:
    """Return whether a package may be patched; if not, print so, and what happens ``without`` the patch."""
    tested = is_tested(package)
    if not tested:
        print(
            f"vibraverse: {package} {_installed(package)} is left as it is, because its patch is tested with "
            f"{TESTED[package]} only: {without}; `make env` installs a tested version",
            file=sys.stderr,
        )
    return tested


# Attributes that a run reads


def _attribute(thing, path: str):
    """Return the internal attribute of ``thing`` at a dotted path; raise :class:`NotThere` if it does not exist."""
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
    """Return an internal attribute; end the process with one sentence if it does not exist."""
    return stop_without(_attribute, thing, path)


def config_files(workflow) -> list:
    """Return the files of ``--configfile``."""
    return list(_read(workflow, "overwrite_configfiles"))


def configuration(workflow, merged: Mapping) -> Mapping:
    """Return the configuration of ``--configfile`` alone if given, else ``merged``, which Snakemake makes.

    Both include single keys of ``--config``.
    """
    return _read(workflow, "config_settings.overwrite_config") if config_files(workflow) else merged


def is_main_process(workflow) -> bool:
    """Return whether this process plans the run, as opposed to one that Snakemake starts for a job."""
    return _read(workflow, "is_main_process")


def in_conda(workflow) -> bool:
    """Return whether jobs run in environments that Snakemake makes with Conda."""
    from snakemake.settings.types import DeploymentMethod

    return DeploymentMethod.CONDA in _read(workflow, "deployment_settings.deployment_method")


def in_containers(workflow) -> bool:
    """Return whether jobs run in images."""
    from snakemake.settings.types import DeploymentMethod

    return DeploymentMethod.APPTAINER in _read(workflow, "deployment_settings.deployment_method")


def apptainer_arguments(workflow) -> str:
    """Return the arguments that the profile passes to every ``apptainer exec``."""
    return _read(workflow, "deployment_settings.apptainer_args")


def container_arguments(workflow) -> str:
    """Return all arguments of a job's ``apptainer exec``: those of the profile, and what Snakemake binds."""
    bound = [Path(path).absolute() for path in _read(workflow, "runtime_paths")]
    binds = [f"--bind {shlex.quote(str(path))}" for path in bound if path.exists()]
    return " ".join([apptainer_arguments(workflow), *binds])


def rules_with_set_resources(workflow) -> Mapping:
    """Return the rules whose resources the profile sets."""
    return _read(workflow, "resource_settings.overwrite_resources")


def rule_names(workflow) -> set[str]:
    """Return the names of the rules loaded so far."""
    return {rule.name for rule in _read(workflow, "rules")}


def executor(workflow) -> str:
    """Return the name of the executor: ``local``, ``slurm``. Known when the run starts."""
    return _read(workflow, "executor_plugin.name")


def executor_settings(workflow):
    """Return the settings of the executor plugin. Known when the run starts."""
    return _read(workflow, "executor_settings")


class Waiting:
    """A job or group that is going to run. Its attributes are read on use: there may be hundreds of thousands."""

    __slots__ = ("_job",)

    def __init__(self, job):
        self._job = job

    @property
    def rule(self) -> str:
        """Name of its rule; of a group, those of its jobs: ``clean, grids``."""
        if not _read(self._job, "is_group")():
            return _read(self._job, "rule.name")
        return ", ".join(sorted({job.rule.name for job in _read(self._job, "jobs")}))

    @property
    def size(self) -> int:
        """Number of its jobs, more than one for a group."""
        return len(list(_read(self._job, "jobs"))) if _read(self._job, "is_group")() else 1

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
        """Image of its rule."""
        return _read(self._job, "container_img_url")

    @property
    def image_file(self) -> str | None:
        """File of its rule's image; for a registry's image, the fetched copy."""
        return _read(self._job, "container_img_path")

    @property
    def is_local(self) -> bool:
        """Whether the process that plans the run also executes it."""
        return _read(self._job, "is_local")

    @property
    def attempts(self) -> int:
        """Number of times it may run before it counts as failed."""
        return 1 + _read(self._job, "restart_times")


def waiting_jobs(workflow) -> list[Waiting]:
    """Return the jobs that are going to run. Known when the run starts."""
    return [Waiting(job) for job in _read(workflow, "dag.needrun_jobs")()]


def submitted_jobs(workflow) -> list[Waiting]:
    """Return what the executor will get: groups of jobs, and the jobs outside groups. Known when the run starts."""
    group_of = _read(workflow, "dag.get_job_group")
    given = {id(one): one for job in _read(workflow, "dag.needrun_jobs")() for one in [group_of(job) or job]}
    return [Waiting(one) for one in given.values()]


def jobs_of_a_group(workflow) -> list[tuple[str, str | None]]:
    """Return rule and image of the jobs that this process runs as one job of a cluster; nothing in any other process.

    Such a job starts Snakemake twice: one puts the other, which runs the jobs, under Slurm's ``srun``. While the rules
    are read, only the command line names the jobs: ``--target-jobs RULE:WILDCARDS …``.
    """
    if is_main_process(workflow) or "slurm-jobstep" in sys.argv or "--target-jobs" not in sys.argv:
        return []
    following = sys.argv[sys.argv.index("--target-jobs") + 1 :]
    named = itertools.takewhile(lambda word: not word.startswith("-"), following)
    images = {rule.name: rule.container_img for rule in _read(workflow, "rules")}
    return [(rule, images.get(rule)) for rule in (word.partition(":")[0] for word in named)]


# Snakemake's own output


def own_handler(settings, stream):
    """Return Snakemake's own handler of log records; without ``--quiet`` it omits host and reasons."""
    from snakemake import logging
    from snakemake.settings.enums import Quietness

    quiet = set(settings.quiet or {Quietness.HOST, Quietness.REASON})
    shown = logging.DefaultFilter(
        quiet, settings.debug_dag, settings.verbose, settings.dryrun, settings.printshellcmds
    )
    written = logging.DefaultFormatter(quiet, settings.show_failed_logs)
    return logging.ColorizingTextHandler(settings.nocolor, stream, written, shown)


def shows_progress(settings) -> bool:
    """Return whether jobs run with the default amount of output, neither less nor more."""
    from snakemake.settings.enums import Quietness

    less = {Quietness.ALL, Quietness.PROGRESS} & set(settings.quiet or ())
    more = settings.verbose or settings.printshellcmds or settings.debug_dag
    return not (settings.dryrun or less or more)


# The patches


def patch_scheduler(workflow) -> None:
    """Patch the scheduler to keep one timer for its next evaluation, however many jobs have finished.

    When a job finishes, Snakemake evaluates the ready jobs, and starts a thread to evaluate them again a second later.
    Each evaluation starts another thread. After a thousand jobs, a thousand threads evaluate every second. That takes a
    core, and in the end all threads that a user may have (Snakemake's issue 3804).
    """
    if not is_main_process(workflow):
        return  # this process runs a single job or a group
    if _patchable(
        SNAKEMAKE, "every job that ends leaves a thread, and a run of thousands takes a core for that"
    ):
        from snakemake.scheduling.job_scheduler import JobScheduler

        JobScheduler._schedule_reevalutation = _evaluate_later  # Snakemake's own spelling


def _evaluate_later(scheduler, delay: float) -> None:
    """Let a scheduler evaluate its jobs after ``delay`` seconds, unless a timer for that runs already."""

    def evaluate():
        _TIMED_SCHEDULERS.discard(scheduler)
        scheduler._open_jobs.release()

    if scheduler not in _TIMED_SCHEDULERS:
        _TIMED_SCHEDULERS.add(scheduler)
        timer = threading.Timer(delay, evaluate)
        timer.daemon = True  # a finished run need not wait for it
        timer.start()


def patch_slurm_plugin() -> None:
    """Patch Snakemake's Slurm plugin to wait for a Slurm that does not answer, and to fail jobs that Slurm has lost.

    By itself the plugin forgets all jobs when a few of its queries in a row fail, as they do while Slurm restarts. The
    run then waits for ever, and an interrupt cancels nothing. The plugin also waits for ever for a job that no answer
    lists. Patched, it fails such a job after :data:`MAX_MISSING_ANSWERS` answers if the queue does not list it either.
    """
    if not _patchable(SLURM_PLUGIN, "a run whose Slurm does not answer for a few minutes may wait for ever"):
        return
    import snakemake_executor_plugin_slurm as plugin

    original = plugin.Executor.check_active_jobs
    if hasattr(original, "checks"):
        return
    checks = _PatientChecks(plugin, original)

    async def check_active_jobs(self, active_jobs):
        async for job in checks.check(self, active_jobs):
            yield job

    check_active_jobs.checks = checks
    plugin.Executor.check_active_jobs = check_active_jobs


class _PatientChecks:
    """The Slurm plugin's check of its jobs, with a count per job of successive answers that do not list it."""

    def __init__(self, plugin, original):
        self._original, self._plugin, self._query = original, plugin, plugin.query_job_status
        self._missing: dict[str, int] = {}
        self._listed = None
        plugin.query_job_status = self._record_answer

    async def _record_answer(self, command, logger):
        answer = await self._query(command, logger)
        self._listed = answer[0]
        return answer

    async def check(self, executor, active_jobs):
        """Yield the jobs that still run, and report the end of the others."""
        reported, returned = set(), []
        self._listed = None
        for report in ("report_job_success", "report_job_error"):
            setattr(executor, report, _recording(getattr(type(executor), report).__get__(executor), reported))
        async for job in self._original(executor, active_jobs):
            returned.append(job)
        known = reported | {id(job) for job in returned}
        unanswered = [job for job in active_jobs if id(job) not in known]
        if unanswered:
            executor.logger.warning(
                f"Slurm does not answer; the run waits for its {counted(len(unanswered), 'job')}."
            )
        lost = self._lost(returned) if self._listed is not None else set()
        for job in [*returned, *unanswered]:
            if id(job) in lost:
                executor.report_job_error(
                    job,
                    msg=f"Slurm has lost job {job.external_jobid}: {MAX_MISSING_ANSWERS} answers in a row and the "
                    "queue do not list it, so that its end is not known. ",
                )
            else:
                yield job

    def _lost(self, jobs) -> set[int]:
        """Return the ``id()`` of jobs that neither the last answers nor the queue list; none if squeue fails."""
        missing = [job for job in jobs if not self._is_listed(job.external_jobid)]
        self._missing = {job.external_jobid: self._missing.get(job.external_jobid, 0) + 1 for job in missing}
        overdue = [job for job in missing if self._missing[job.external_jobid] >= MAX_MISSING_ANSWERS]
        queued = slurm.queued_jobs() if overdue else None
        if queued is None:
            return set()
        return {id(job) for job in overdue if _array(job.external_jobid) not in queued}

    def _is_listed(self, slurm_id: str) -> bool:
        return any(name in self._listed for name in self._plugin._status_lookup_ids(slurm_id))


def _array(slurm_id: str) -> str:
    """Return a Slurm job's id without its array index."""
    return slurm_id.split("_")[0]


def _recording(report, reported: set):
    """Return ``report`` as a function that also adds the job's ``id()`` to ``reported``."""

    def recording(job, *arguments, **keywords):
        reported.add(id(job))
        return report(job, *arguments, **keywords)

    return recording
