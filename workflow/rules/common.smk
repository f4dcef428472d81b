# Shared by all rules: the plan, the resource classes, the wildcards.
import sys
from functools import partial

from vibraverse.contract.products import text_sha256
from vibraverse.flow import targets
from vibraverse.flow.plan import Plan
from vibraverse.flow.resources import memory, minutes
from vibraverse.flow.steps import VERSIONS
from vibraverse.machine import internals, preflight
from vibraverse.machine.containers import image

# Snakemake would merge a file given with --configfile into config.yaml; here it is the whole configuration, so that the
# run is what `vibraverse config show FILE` prints. Single keys of --config override either.
chosen = internals.configuration(workflow, config)

internals.patch_scheduler(workflow)
if internals.is_main_process(workflow):
    preflight.stop_without(preflight.profile, sys.argv)

plan = preflight.stop_without(Plan, chosen)
paths = plan.paths

# Returns the name of the object or shard of a requested file; ends the run if it does not exist.
known = partial(preflight.stop_without, preflight.known, plan, internals.config_files(workflow))


wildcard_constraints:
    object=r"[A-Za-z0-9_-]+",
    solidity="solid|hollow",
    shard=r"\d{5}",
    body=r"[a-z-]+",
    task=r"[a-z]+",
    split=r"object|(shuffled|family)-\d+",
    model=r"[a-z_]+",
    seed=r"\d+",
