# What a run needs of the machine, asked before its first job. Included last: every rule is known.
import os
from collections import Counter

from snakemake.settings.types import DeploymentMethod

from vibraverse.contract import journal
from vibraverse.machine import locks, slurm
from vibraverse.machine.warm_process import keep_warm

slurm.be_patient()

in_containers = DeploymentMethod.APPTAINER in workflow.deployment_settings.deployment_method
if in_containers and workflow.is_main_process:
    preflight.stop_without(preflight.apptainer)
preflight.stop_without(
    preflight.rules,
    workflow.resource_settings.overwrite_resources,
    {*VERSIONS, *(rule.name for rule in workflow.rules)},
)
if plan.joins and workflow.is_main_process:
    preflight.stop_without(preflight.shards, targets.missing_shards(plan))


def warm_up(jobs):
    """Keep a process warm for jobs, each a rule's name and its image; those in Conda's environments start cold."""
    if DeploymentMethod.CONDA not in workflow.deployment_settings.deployment_method:
        images = (image or "" if in_containers else "" for name, image in jobs if name in VERSIONS)
        keep_warm(Counter(images), workflow.deployment_settings.apptainer_args)


# The Snakemake that a cluster's job starts for a group of ours runs no hooks, and knows its jobs by now.
if not workflow.is_main_process and "slurm-jobstep" not in sys.argv:
    targets_here = [
        (spec.rulename, workflow.get_rule(spec.rulename).container_img)
        for spec in workflow.dag_settings.target_jobs
    ]
    warm_up(targets_here)


onstart:
    patches.planned()
    # Jobs inherit it, also through Slurm, and write the journal of this run.
    os.environ[journal.RUN] = str(locks.only_run(paths.results, plan.owned).file)
    preflight.stop_without(preflight.configuration, paths.config, plan.configuration())
    waiting = list(workflow.dag.needrun_jobs())
    orphans = locks.orphans(paths.results, None if plan.owned is None else [*plan.objects, *plan.shards])
    if in_containers:
        preflight.stop_without(
            preflight.images, [job.container_img_url for job in waiting if job.container_img_url]
        )
        named = [plan.objects[job.wildcards.object] for job in waiting if job.rule.name == "sources"]
        preflight.stop_without(
            preflight.seen_in_images,
            [entry.input for entry in named if entry.input],
            workflow.deployment_settings.apptainer_args,
        )
    if workflow.executor_plugin.name == "local":
        preflight.stop_without(preflight.local_gpus, [(job.rule.name, job.resources) for job in waiting])
        locks.wait_for(orphans)
        warm_up([(job.rule.name, job.container_img_path) for job in waiting])
    if workflow.executor_plugin.name == "slurm":
        preflight.stop_without(
            slurm.check,
            [(job.rule.name, job.resources) for job in waiting if not job.is_local],
            ".",
            workflow.executor_settings,
            1 + max((job.restart_times for job in waiting), default=0),
        )
