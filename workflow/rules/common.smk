# What every rule shares: the plan, the resource classes, the wildcards.
import sys

from vibraverse import targets
from vibraverse.config import ConfigError
from vibraverse.guard import only_run
from vibraverse.plan import Plan
from vibraverse.stages import VERSIONS

try:
    plan = Plan(config)
except ConfigError as error:
    print(f"vibraverse: {error}", file=sys.stderr)
    sys.exit(2)

paths = plan.paths
if workflow.is_main_process and not workflow.dryrun:
    only_run(paths.results)

# Resource classes: memory in MB for the first attempt, minutes. Memory doubles with every retry.
RESOURCES = {
    "light": (1000, 10),
    "geometry": (4000, 30),
    "solver": (6000, 60),
    "render": (2000, 20),
    "collect": (4000, 60),
}


def memory(kind):
    """Memory of a resource class, growing with the attempt."""
    return lambda wildcards, attempt: RESOURCES[kind][0] * 2 ** (attempt - 1)


def minutes(kind):
    """Run time of a resource class, growing with the attempt."""
    return lambda wildcards, attempt: RESOURCES[kind][1] * attempt


wildcard_constraints:
    object=r"[A-Za-z0-9_-]+",
    solidity="solid|hollow",
    shard=r"\d{5}",
