"""Every list of files that a rule asks for, in one place."""

from __future__ import annotations

import os
from shlex import quote

from vibraverse.flow.chain import stage_products
from vibraverse.flow.plan import Plan
from vibraverse.validation.bodies import BODIES


def sounds(plan: Plan) -> list[str]:
    """Return the patterns of one body's sounds and their record, with the wildcards left open."""
    names = plan.config.audio.names(plan.config.materials)
    return [*(plan.paths.sound.replace("{material}", name) for name in names), plan.paths.audio_record]


def views(plan: Plan) -> list[str]:
    """Return the patterns of one object's pictures and their record, with the wildcard left open."""
    names = plan.config.images.names()
    return [*(plan.paths.view.replace("{look}-{view}", name) for name in names), plan.paths.images_record]


def shard_products(plan: Plan, shard: str) -> list[str]:
    """Return one product of every job that the objects of a shard need.

    Naming all products would double the files in Snakemake's memory: 9 GB for 50,000 objects.
    """
    return [
        product
        for object_ in sorted(plan.shards[shard])
        for product in stage_products(plan.paths, object_, plan.config.solidities, folders=True)
    ]


def page_objects(plan: Plan) -> list[str]:
    """Return what the page shows of all objects; each needs the data of the object's bodies."""
    return [plan.paths.at(plan.paths.page_object, object=object_) for object_ in sorted(plan.objects)]


def of_bodies(plan: Plan, pattern: str) -> list[str]:
    """Return a pattern of bodies for each body of an object, with the object's wildcard left open."""
    return [pattern.replace("{solidity}", solidity) for solidity in plan.config.solidities]


def shown(plan: Plan) -> dict[str, str | list[str]]:
    """Return the inputs of the rule ``page_object`` that not every run has: the wall, and bases for struck points."""
    wall = {"hollow_record": plan.paths.hollow_record} if "hollow" in plan.config.solidities else {}
    return wall | ({"basis": of_bodies(plan, plan.paths.basis)} if plan.config.audio.points else {})


def shown_arguments(plan: Plan) -> str:
    """Return the options that name these inputs to the stage ``page_object``, with Snakemake's placeholders."""
    return " ".join(f"--{name.replace('_', '-')} {{input.{name}:q}}" for name in shown(plan))


def shards(plan: Plan) -> list[str]:
    """Return all shards of the dataset."""
    return [plan.paths.at(plan.paths.shard, shard=shard) for shard in sorted(plan.shards)]


def features(plan: Plan) -> list[str]:
    """Return the folders of features of all shards."""
    return [plan.paths.at(plan.paths.features, shard=shard) for shard in sorted(plan.shards)]


def of_trainings(plan: Plan, pattern: str) -> list[str]:
    """Return the products of a pattern, one of each trained model."""
    return [plan.paths.at(pattern, **training) for training in plan.trainings()]


def baselines(plan: Plan) -> list[str]:
    """Return the measures of the baselines of every task and split."""
    learn = plan.config.learn
    return [
        plan.paths.at(plan.paths.baselines, task=task, split=split)
        for task in learn.tasks
        for split in learn.sides(task)
    ]


def descents(plan: Plan, task: str, split: str) -> list[str]:
    """Return what DiffSound finds for the bodies of a split, in parts; nothing for other tasks and without bodies."""
    asked = plan.config.learn.diffsound
    parts = range(min(asked.parts, asked.bodies)) if task == "reconstruction" else ()
    return [plan.paths.at(plan.paths.descents, split=split, part=str(part)) for part in parts]


def kept_splits(plan: Plan) -> list[str]:
    """Return the splits table of an earlier dataset, if the configuration keeps one."""
    kept = plan.config.dataset.keep_splits
    return [os.path.expanduser(kept)] if kept else []


def kept_splits_argument(plan: Plan) -> str:
    """Return the option that names the kept splits to the stage ``index``, for the shell."""
    return " ".join(f"--kept={quote(path)}" for path in kept_splits(plan))


def struck(plan: Plan) -> dict[str, str]:
    """Return the input of the rule ``audio`` for struck points: the basis, or nothing without such points.

    Leaving it out saves a twentieth of the time to plan many objects.
    """
    return {"basis": plan.paths.basis} if plan.config.audio.points else {}


def struck_argument(plan: Plan) -> str:
    """Return the option that names the basis to the stage ``audio``, with Snakemake's placeholder."""
    return "--basis {input.basis:q}" if struck(plan) else ""


def everything(plan: Plan) -> list[str]:
    """Return the targets of a run: shards and data of the page for a slice, else the report, verdict and dataset."""
    if plan.owned is not None:
        return shards(plan) + page_objects(plan)
    paths = plan.paths
    # The dataset's later files are named too; otherwise results made by earlier versions would never get them.
    last = (paths.report, paths.verdict)
    return [*last, paths.dataset_config, paths.dataset_sums, paths.index_parquet, paths.index_columns]


def missing_of_slices(plan: Plan) -> list[str]:
    """Return the files that slices make and that do not exist."""
    return [path for path in shards(plan) + page_objects(plan) if not os.path.isfile(path)]


def source_file(plan: Plan, object_: str) -> list[str]:
    """Return the mesh file of an object of origin ``files``; ``[]`` for other origins.

    An unreadable file is left out too: Snakemake would stop the run at it, whereas the stage refuses the object.
    """
    path = plan.objects[object_].input
    return [str(path)] if path and os.access(path, os.R_OK) else []


def source_argument(plan: Plan, object_: str) -> str:
    """Return the option that names an object's mesh file to the stage ``sources``, for the shell."""
    path = plan.objects[object_].input
    return f"--file={quote(str(path))}" if path else ""


def validation_comparisons(plan: Plan) -> list[str]:
    """Return the comparison files of all bodies with known frequencies."""
    return [plan.paths.at(plan.paths.validation_comparison, body=body) for body in BODIES]


def validation_done(plan: Plan) -> list[str]:
    """Return the record of the validation if it exists, else nothing; the report shows it only then."""
    return [plan.paths.validation_record] if os.path.exists(plan.paths.validation_record) else []


def files_argument(option: str, files: list[str]) -> str:
    """Return the option that names files, for the shell; "" without files."""
    return " ".join([f"--{option}", *map(quote, files)]) if files else ""


def link_argument(option: str, page: str) -> str:
    """Return the option that names a page to link, for the shell; "" where the page does not exist.

    It is no input of the rule: a page that is linked need not be up to date, and must not be made for its link.
    """
    return f"--{option}={quote(page)}" if os.path.exists(page) else ""


def validation_argument(plan: Plan) -> str:
    """Return the option that names the validation to the stage ``report``, for the shell."""
    return " ".join(f"--validation={quote(path)}" for path in validation_done(plan))
