# Checks of the machine before the first job of a run. Included last, so that every rule is known.
import os
from collections import Counter

from vibraverse.contract import journal
from vibraverse.machine import locks, slurm
from vibraverse.machine.warm_process import keep_warm

in_containers = internals.in_containers(workflow)
if in_containers and internals.is_main_process(workflow):
    preflight.stop_without(preflight.apptainer)
preflight.stop_without(
    preflight.rules,
    internals.rules_with_set_resources(workflow),
    {*VERSIONS, *internals.rule_names(workflow)},
)
if plan.joins and internals.is_main_process(workflow):
    preflight.stop_without(preflight.slices, targets.missing_of_slices(plan))


def warm_up(jobs):
    """Start warm processes for jobs, given as rule name and image; jobs in Conda environments start cold."""
    if not internals.in_conda(workflow):
        images = (image if in_containers and image else "" for name, image in jobs if name in VERSIONS)
        keep_warm(Counter(images), internals.container_arguments(workflow))


# In a cluster job, Snakemake runs no hooks for a group of jobs, but it knows its jobs by now.
warm_up(internals.jobs_of_a_group(workflow))


onstart:
    # Jobs inherit the variable, also through Slurm, and write the journal of this run.
    os.environ[journal.RUN] = str(locks.only_run(paths.results, plan.owned).file)
    preflight.stop_without(preflight.configuration, paths.config, plan.configuration())
    waiting = internals.waiting_jobs(workflow)
    orphans = locks.orphans(paths.results, None if plan.owned is None else [*plan.objects, *plan.shards])
    here = (
        internals.executor(workflow) == "local" and not in_containers and not internals.in_conda(workflow)
    )
    preflight.stop_without(preflight.learning, [job.rule for job in waiting], plan.config.slice, here)
    if in_containers:
        preflight.stop_without(preflight.images, [image for job in waiting if (image := job.image)])
        named = [plan.objects[job.wildcards.object] for job in waiting if job.rule == "sources"]
        preflight.stop_without(
            preflight.seen_in_images,
            [entry.input for entry in named if entry.input],
            internals.apptainer_arguments(workflow),
        )
    if internals.executor(workflow) == "local":
        preflight.stop_without(preflight.local_gpus, [(job.rule, job.resources) for job in waiting])
        locks.wait_for(orphans)
        warm_up([(job.rule, job.image_file) for job in waiting])
    if internals.executor(workflow) == "slurm":
        internals.patch_slurm_plugin()
        preflight.stop_without(
            slurm.check,
            [
                (job.rule, job.resources, job.size)
                for job in internals.submitted_jobs(workflow)
                if not job.is_local
            ],
            ".",
            internals.executor_settings(workflow),
            max((job.attempts for job in waiting), default=1),
        )
