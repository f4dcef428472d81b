# What a run needs of the machine, asked before its first job. Included last: every rule is known.
from vibraverse.machine import slurm
from vibraverse.machine.locks import only_run, wait_for_jobs_of_gone_runs
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
    preflight.stop_without(preflight.shards, targets.missing_shards(plan))


onstart:
    only_run(paths.results, plan.owned)
    preflight.stop_without(preflight.configuration, paths.config, plan.configuration())
    waiting = internals.waiting_jobs(workflow)
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
        mine = None if plan.owned is None else [*plan.objects, *plan.shards]
        wait_for_jobs_of_gone_runs(f"{paths.results}/logs", mine)
        if not internals.deploys_software(workflow):
            keep_warm(len(waiting))
    if internals.executor(workflow) == "slurm":
        internals.be_patient()
        preflight.stop_without(
            slurm.check,
            [(job.rule, job.resources) for job in waiting if not job.is_local],
            ".",
            internals.executor_settings(workflow),
            max((job.attempts for job in waiting), default=1),
        )
