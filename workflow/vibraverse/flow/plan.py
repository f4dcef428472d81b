"""What a configuration asks for: the objects, and the options of every stage for each of them.

The Snakefile holds one :class:`Plan`. A rule takes from it only the block that its stage uses, as JSON. Snakemake
keeps that text as a parameter of the job, so a change reruns exactly what depends on it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from vibraverse.config import Config, ConfigError, parse
from vibraverse.config.learn import DescentOptions
from vibraverse.contract.readable import unreadable
from vibraverse.contract.slices import JOIN, shard_of, shards_of_slice
from vibraverse.flow.paths import Paths
from vibraverse.sources.catalogue import Entry, catalogue

#: Keys that do not affect the dataset: locations, the slice of a run, the report.
_NOT_RECORDED = {
    "results": True,
    "slice": True,
    "sources": {"objaverse": {"cache"}},
    "dataset": {"max_refused_share"},
    "report": True,
    "learn": True,
}

#: Objects in a shard: the maximum makes a file of about 20 GB, the recommended number one of about 2 GB.
MAX_SHARD_OBJECTS, GOOD_SHARD_OBJECTS = 1000, 100


class Plan:
    """The objects of a configuration, or of its slice, and the options of their stages.

    ``owned`` holds the numbers of the shards that a slice makes; None if the run makes or joins all.
    """

    def __init__(self, values: dict | Config):
        self.config = values if isinstance(values, Config) else parse(values)
        self.paths = Paths(self.config.results)
        if self.config.dataset.keep_splits:
            self._check_kept(self.config.dataset.keep_splits)
        self.joins = self.config.slice == JOIN
        sliced = self.config.slice is not None and not self.joins
        shards = self.config.dataset.shards
        self.owned = shards_of_slice(self.config.slice, shards) if sliced else None
        self.objects: dict[str, Entry] = {}
        self.shards: dict[str, list[str]] = {}
        mine = {self._name(shard) for shard in self.owned} if sliced else None
        entries = catalogue(self.config)
        if not entries:
            raise ConfigError(
                "sources: no object is named; raise sources.generated.count, or name some in sources.bundled, "
                "sources.files or sources.objaverse.uids"
            )
        for object_, entry in entries.items():
            shard = self.shard_of(object_)
            if mine is None or shard in mine:
                self.objects[object_] = entry
                self.shards.setdefault(shard, []).append(object_)
        self._check_shards(len(entries))

    def _check_kept(self, named: str) -> None:
        kept = Path(named).expanduser()
        if wrong := unreadable(kept, missing="name the splits.tsv of a dataset"):
            raise ConfigError(f"dataset.keep_splits: the file {named} {wrong}")
        if kept.resolve() == Path(self.paths.splits).resolve():
            raise ConfigError(
                f"dataset.keep_splits: {named} is the table that this run itself writes; copy it and name the copy"
            )

    def _check_shards(self, objects: int) -> None:
        most = max(map(len, self.shards.values()), default=0)
        if most > MAX_SHARD_OBJECTS:
            raise ConfigError(
                f"dataset.shards: {self.config.dataset.shards} files for {objects:,} objects put {most:,} into one, "
                f"and {MAX_SHARD_OBJECTS:,} are the most; set it to {-(-objects // GOOD_SHARD_OBJECTS)} or so: a file "
                f"is written as a whole, and some {GOOD_SHARD_OBJECTS} objects are a good size"
            )

    def shard_of(self, object_: str) -> str:
        """Return the name of the object's shard, from a stable hash of its id."""
        return self._name(shard_of(object_, self.config.dataset.shards))

    @staticmethod
    def _name(shard: int) -> str:
        return f"{shard:05d}"

    def options(self, stage: str, object_: str = "", shard: str = "") -> str:
        """Return the JSON block that a stage uses, for one object or shard if they differ."""
        config = self.config
        if stage == "sources":
            values = self.objects[object_].options
        elif stage == "modes":
            values = {
                **config.modes.model_dump(),
                "materials": {name: m.model_dump() for name, m in config.materials.items()},
                "sampled": config.sampled.model_dump(),
                "modes": config.basis.modes,
                "size_m": self.objects[object_].size_m,
                "size_origin": self.objects[object_].size_origin,
                "default_size_m": config.sources.default_size_m,
            }
        elif stage == "dataset":
            values = {
                "results": config.results,
                "objects": sorted(self.shards[shard]),
                "materials": list(config.materials),
                "solidities": config.solidities,
                "looks": config.images.looks,
            }
        elif stage == "features":
            values = config.learn.features.model_dump(mode="json")
        elif stage == "report":
            values = {
                **config.report.model_dump(mode="json"),
                "results": config.results,
                "card": config.dataset.card.model_dump(mode="json"),
            }
        elif stage == "index":
            values = config.dataset.model_dump(include={"splits", "stratify", "card"})
        else:
            values = getattr(config, stage).model_dump(mode="json")
        return sys.intern(json.dumps(values, ensure_ascii=False))  # jobs with equal options share one string

    def training(self, wildcards) -> str:
        """Return the JSON block of one training, named by task, split, model and seed."""
        run = self.config.learn.run(wildcards.task, wildcards.split, wildcards.model, int(wildcards.seed))
        return run.model_dump_json()

    def comparison(self, wildcards) -> str:
        """Return the JSON block of the baselines of a task and a split."""
        learn = self.config.learn
        run = learn.run(wildcards.task, wildcards.split, learn.models(wildcards.task)[0], 0)
        return run.model_dump_json(
            include={"task", "model", "split", "seed", "folds", "hold_out", "leave_out"}
        )

    def descent(self, wildcards) -> str:
        """Return the JSON block of a part of the bodies that DiffSound seeks."""
        learn = self.config.learn
        run = learn.run("reconstruction", wildcards.split, learn.models("reconstruction")[0], 0)
        fields = {"task", "model", "split", "seed", "folds", "hold_out", "leave_out", "network"}
        chosen = {**run.model_dump(include=fields), "diffsound": learn.diffsound, "part": int(wildcards.part)}
        return DescentOptions.model_validate(chosen).model_dump_json(include={*chosen})

    def trainings(self) -> list[dict[str, str]]:
        """Return the wildcards of all trainings."""
        learn = self.config.learn
        return [
            {"task": task, "split": split, "model": model, "seed": str(seed)}
            for task in learn.tasks
            for split in learn.sides(task)
            for model in learn.models(task)
            for seed in learn.seeds
        ]

    def configuration(self) -> str:
        """Return the part of the configuration that affects the dataset, with every default filled in, as YAML."""
        import yaml

        values = self.config.model_dump(mode="json", exclude=_NOT_RECORDED)
        return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)

    def modes_class(self) -> str:
        """Return the resource class of stage ``modes``: ``solver`` if a material may have to be solved on the mesh."""
        basis = self.config.basis
        low, high = basis.poisson_range
        inside = all(low <= material.poisson <= high for material in self.config.materials.values())
        return "light" if inside and basis.max_error <= self.config.modes.tolerance else "solver"
