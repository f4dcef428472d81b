"""Every path pattern of the workflow, in one place.

Patterns carry Snakemake's wildcards, ``{object}`` and ``{solidity}`` mostly; :meth:`Paths.at` fills them in. Rules,
targets, the dataset and the report take paths from here and never build them by hand.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

SOLIDITIES = ("solid", "hollow")


class Paths:
    """The path patterns below one results folder."""

    def __init__(self, results: str | Path = "results"):
        # Without a stroke at the end or a leading ./, as all paths from here on.
        self.results = str(Path(results))
        object_ = f"{self.results}/objects/{{object}}"
        body = f"{object_}/{{solidity}}"
        self.object, self.body = object_, body

        self.source_mesh = f"{object_}/source.mesh"
        self.source_record = f"{object_}/source.json"
        self.surface = f"{object_}/surface.ply"
        self.clean_record = f"{object_}/clean.json"
        self.grids = f"{object_}/grids.h5"
        self.coarse = f"{object_}/coarse.obj"
        self.hollow_surface = f"{object_}/hollow/surface.ply"
        self.hollow_record = f"{object_}/hollow/hollow.json"
        self.views = f"{object_}/views"
        self.view = f"{self.views}/{{look}}-{{view}}.png"
        self.images_record = f"{self.views}/images.json"

        self.tets = f"{body}/tets.msh"
        self.tets_record = f"{body}/tets.json"
        self.basis = f"{body}/basis.h5"
        self.modes = f"{body}/modes.h5"
        self.sounds = f"{body}/sounds"
        self.sound = f"{self.sounds}/{{material}}.wav"
        self.audio_record = f"{self.sounds}/audio.json"

        self.dataset = f"{self.results}/dataset"
        self.shard = f"{self.dataset}/shards/{{shard}}.h5"
        self.index = f"{self.dataset}/index.tsv"
        self.splits = f"{self.dataset}/splits.tsv"
        self.index_columns = f"{self.dataset}/index.h5"
        self.index_parquet = f"{self.dataset}/index.parquet"
        self.refusals = f"{self.dataset}/refusals.tsv"
        self.card = f"{self.dataset}/README.md"
        self.overview = f"{self.dataset}/overview.png"
        self.croissant = f"{self.dataset}/croissant.json"
        self.dataset_record = f"{self.dataset}/dataset.json"
        self.config = f"{self.results}/config.yaml"
        self.dataset_config = f"{self.dataset}/config.yaml"
        self.dataset_sums = f"{self.dataset}/SHA256SUMS"
        self.verdict = f"{self.results}/verdict.json"
        self.report = f"{self.results}/report/index.html"

        self.validation = f"{self.results}/validation"
        self.validation_meshes = f"{self.validation}/{{body}}/meshes.h5"
        self.validation_comparison = f"{self.validation}/{{body}}/comparison.json"
        self.validation_table = f"{self.validation}/validation.tsv"
        self.validation_record = f"{self.validation}/validation.json"
        self.validation_plot = f"{self.validation}/convergence.svg"
        self.validation_verdict = f"{self.validation}/verdict.json"

    @staticmethod
    def at(pattern: str, **wildcards: str) -> str:
        """Fill in the wildcards of a pattern."""
        return pattern.format(**wildcards)

    def named(self, name: str, **wildcards: str) -> str:
        """Return the path of the pattern of this name with its wildcards filled in."""
        pattern = getattr(self, name)
        return self.at(pattern(SimpleNamespace(**wildcards)) if callable(pattern) else pattern, **wildcards)

    def boundary(self, wildcards) -> str:
        """Return the surface that bounds a body: the object's own, or the one with the cavity."""
        return self.surface if wildcards.solidity == "solid" else self.hollow_surface

    def log(self, stage: str, *wildcards: str) -> str:
        """Return the log pattern of a stage, e.g. ``log("tets", "object", "solidity")``."""
        return self._side("logs", stage, wildcards, "log")

    def benchmark(self, stage: str, *wildcards: str) -> str:
        """Return the pattern of the file in which Snakemake notes a job's time and memory."""
        return self._side("benchmarks", stage, wildcards, "tsv")

    def _side(self, folder: str, stage: str, wildcards: tuple[str, ...], suffix: str) -> str:
        name = ".".join([stage, *(f"{{{w}}}" for w in wildcards[1:])])
        middle = f"{{{wildcards[0]}}}/" if wildcards else ""
        return f"{self.results}/{folder}/{middle}{name}.{suffix}"
