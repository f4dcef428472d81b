"""Every list of files a rule asks for, in one place."""

from __future__ import annotations

import os
from shlex import quote

from vibraverse.flow.chain import stage_products
from vibraverse.flow.plan import Plan
from vibraverse.validation.bodies import BODIES


def sounds(plan: Plan) -> list[str]:
    """Return the patterns of the sounds and their record of one body, with the wildcards left open."""
    names = plan.config.audio.names(plan.config.materials)
    return [*(plan.paths.sound.replace("{material}", name) for name in names), plan.paths.audio_record]


def views(plan: Plan) -> list[str]:
    """Return the patterns of the pictures and their record of one object, with the wildcard left open."""
    names = plan.config.images.names()
    return [*(plan.paths.view.replace("{look}-{view}", name) for name in names), plan.paths.images_record]


def shard_products(plan: Plan, shard: str) -> list[str]:
    """Return one product of every job that the objects of a shard need.

    Naming all of them would double the files that Snakemake keeps in mind: 9 GB for 50,000 objects.
    """
    return [
        product
        for object_ in sorted(plan.shards[shard])
        for product in stage_products(plan.paths, object_, plan.config.solidities, folders=True)
    ]


def shards(plan: Plan) -> list[str]:
    """Return all shards of the dataset."""
    return [plan.paths.at(plan.paths.shard, shard=shard) for shard in sorted(plan.shards)]


def kept_splits(plan: Plan) -> list[str]:
    """Return the splits of an earlier dataset, where they are to be kept."""
    kept = plan.config.dataset.keep_splits
    return [os.path.expanduser(kept)] if kept else []


def kept_splits_argument(plan: Plan) -> str:
    """Return how the stage ``index`` is told of them, for the shell."""
    return " ".join(f"--kept={quote(path)}" for path in kept_splits(plan))


def struck(plan: Plan) -> dict[str, str]:
    """Return the input of the rule ``audio`` for struck points: the basis, and where there are none, nothing.

    Without it a plan of many objects takes a twentieth less time.
    """
    return {"basis": plan.paths.basis} if plan.config.audio.points else {}


def struck_argument(plan: Plan) -> str:
    """Return how that stage is told of it, in the words of a rule's command."""
    return "--basis {input.basis:q}" if struck(plan) else ""


def everything(plan: Plan) -> list[str]:
    """Return what a run makes in the end: a slice makes its shards, every other run the report, verdict and dataset."""
    if plan.owned is not None:
        return shards(plan)
    paths = plan.paths
    # Others than the first two because results of before they were made would never get them else.
    last = (paths.report, paths.verdict)
    return [*last, paths.dataset_config, paths.dataset_sums, paths.index_parquet, paths.index_columns]


def missing_shards(plan: Plan) -> list[str]:
    """Return the shards that are not there."""
    return [path for path in shards(plan) if not os.path.isfile(path)]


def source_file(plan: Plan, object_: str) -> list[str]:
    """Return the mesh file an object is read from: one for objects of origin ``files``, else none.

    A file that may not be read is none either: Snakemake would stop at it, the stage refuses it.
    """
    path = plan.objects[object_].input
    return [str(path)] if path and os.access(path, os.R_OK) else []


def source_argument(plan: Plan, object_: str) -> str:
    """Return how the stage ``sources`` is told the mesh file of an object, for the shell."""
    path = plan.objects[object_].input
    return f"--file={quote(str(path))}" if path else ""


def validation_comparisons(plan: Plan) -> list[str]:
    """Return the comparisons of all bodies whose frequencies are known."""
    return [plan.paths.at(plan.paths.validation_comparison, body=body) for body in BODIES]


def validation_done(plan: Plan) -> list[str]:
    """Return the record of the validation where it was run, else nothing: the report shows what there is."""
    return [plan.paths.validation_record] if os.path.exists(plan.paths.validation_record) else []


def validation_argument(plan: Plan) -> str:
    """Return how the stage ``report`` is told the validation, for the shell."""
    return " ".join(f"--validation={quote(path)}" for path in validation_done(plan))
