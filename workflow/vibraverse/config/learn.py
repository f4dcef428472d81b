"""Options of learning: what is trained, on which side of which split, and how long."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from vibraverse.config.base import Section
from vibraverse.config.presets import OWN_PRESETS, PRESETS
from vibraverse.config.training import Training
from vibraverse.contract.texts import unknown

#: Task -> its models, the published one first.
MODELS = {
    "frequencies": ("published", "physics", "ritz", "subspace"),
    "solidity": ("published", "ratios", "informed", "sound", "image", "material"),
    "reconstruction": ("published", "truncated", "shuffled", "material", "silent"),
    "cavity": ("sound", "outside"),
    "retrieval": ("published", "contrast", "sized", "no_material"),
}
#: How the objects of a run are divided into those that are trained on and those that are not.
OBJECT, SHUFFLED, FAMILY = "object", "shuffled", "family"
Split = Literal["object", "shuffled", "family"]


class Features(Section):
    """Arrays that training reads, made once from each shard of the dataset."""

    points: int = Field(4096, ge=64, le=100_000)
    """Points drawn on the surface of every body, with their normals."""

    poisson_nodes: int = Field(17, ge=2, le=200)
    """Poisson's ratios at which the spectrum of every body is stored; between them it is interpolated."""

    poisson_range: tuple[float, float] = (0.1, 0.4)
    """Smallest and largest of them, within ``basis.poisson_range``."""

    ritz_degrees: list[Annotated[int, Field(ge=2, le=12)]] = Field(
        default_factory=lambda: [4, 6, 8], min_length=1
    )
    """Degrees of the polynomials whose Ritz frequencies models may start from, ascending."""

    ritz_unknowns: list[Annotated[int, Field(ge=300, le=10_000)]] = Field(
        default_factory=lambda: [1000, 3000], min_length=1
    )
    """Unknowns of the splines whose Ritz frequencies models may start from, ascending."""

    voxel_points: int = Field(32_768, ge=64, le=1_000_000)
    """Points on the coarse voxels of every object. They are drawn again when they are read, so they take no space."""

    farthest: int = Field(1024, ge=16, le=16_384)
    """How many of them are chosen, each farthest from those before it."""

    distance_samples: int = Field(16_384, ge=64, le=1_000_000)
    """Places evenly around a body with their signed distances, as many near its surface, and as many on it."""

    look: str = "clay"
    """Look of the pictures; one that shows no material."""

    view_px: int = Field(64, ge=16, le=1024)
    """Width and height of the pictures in pixels."""

    @field_validator("ritz_degrees", "ritz_unknowns")
    @classmethod
    def _finer_and_finer(cls, sizes: list[int]):
        # The last one is the finest, which corrections start from.
        if sizes != sorted(set(sizes)):
            raise ValueError(f"{sizes} do not ascend; write {sorted(set(sizes))}")
        return sizes


class Network(Section):
    """Size of the networks."""

    points: int = Field(4096, ge=64)
    """Points of a body that the shape network sees, at most ``features.points``."""

    depth: int = Field(5, ge=4, le=9)
    """Depth of the octree: a cell is 2 / 2^depth of the normalised length."""

    width: int = Field(256, ge=8, le=4096)
    """Width of the fully connected layers."""

    layers: int = Field(3, ge=1, le=16)
    """Number of the fully connected layers."""

    voxel_points: int = Field(2048, ge=64)
    """Reconstruction: points on the voxels that the network sees, at most ``features.voxel_points``."""

    latents: int = Field(64, ge=16)
    """Reconstruction: latent tokens, at most ``features.farthest``. Their width is ``width``, a multiple of 64."""

    encoder_blocks: int = Field(2, ge=0, le=64)
    """Reconstruction: blocks of self-attention before the bottleneck."""

    decoder_blocks: int = Field(3, ge=0, le=64)
    """Reconstruction: blocks of self-attention after it."""

    distances: int = Field(1024, ge=2)
    """Reconstruction: signed distances of a body that a step compares, at most ``features.distance_samples``."""

    cells: int = Field(48, ge=8, le=256)
    """Reconstruction: cells along an axis of [-1, 1]³ on which a surface is extracted."""


class LearningTask(Section):
    """One task: its models, and what differs from the preset for it."""

    models: list[str] = Field(default_factory=list)
    """Models to train; none: all."""

    training: dict[str, int | float | str | None] = Field(default_factory=dict)
    """Keys of ``training`` that differ from the preset's."""

    network: dict[str, int] = Field(default_factory=dict)
    """Keys of ``network`` that differ from the preset's."""

    splits: list[Split] = Field(default_factory=list)
    """Splits of this task; none: those of ``learn.splits``."""


class DiffSound(Section):
    """Shapes sought by descent through the physics, a baseline of task ``reconstruction`` that is not trained."""

    bodies: int = Field(0, ge=0)
    """Tested bodies of each split that are sought, each from two spectra; minutes each. 0: none."""

    parts: int = Field(1, ge=1, le=1000)
    """Jobs among which they are divided."""

    cells: int = Field(24, ge=4, le=96)
    """Cells of the lattice along an axis of [-1, 1]³; published are 64."""

    iterations: int = Field(200, ge=1)
    """Steps of the descent."""

    width: int = Field(64, ge=4)
    """Width of the network that changes the distance."""

    layers: int = Field(3, ge=1, le=16)
    """Number of its layers."""

    learning_rate: float = Field(1e-3, gt=0)
    """Learning rate of the descent."""

    side_weight: float = Field(10.0, ge=0)
    """Weight of known sides of the voxels' centres against the spectrum."""


class RunOptions(Section):
    """One training, which the workflow fills in from the rest of the configuration."""

    task: str
    """Name of the task."""

    model: str
    """Name of the model."""

    split: str
    """``object``, or ``shuffled-K`` or ``family-K`` for the fold K."""

    seed: int = 0
    """Seed of weights and order."""

    folds: int = 5
    """Folds of the splits that have folds."""

    hold_out: list[str] = Field(default_factory=list)
    """Origins that are never trained on."""

    leave_out: list[str] = Field(default_factory=list)
    """Families that are neither trained on nor tested."""

    preset: str = "cpu"
    """Preset that the settings come from."""

    processes: int = Field(1, ge=1, le=8, exclude=True)
    """Processes that train together on the processor, to try without GPUs what several GPUs do; the workflow leaves it
    at 1."""

    training: Training = Training()
    """How the model is trained."""

    network: Network = Network()
    """Size of the networks."""


class DescentOptions(RunOptions):
    """One part of the bodies that DiffSound seeks, which the workflow fills in."""

    diffsound: DiffSound = DiffSound()
    """How they are sought."""

    part: int = Field(0, ge=0)
    """Number of the part."""


class Learn(Section):
    """Benchmark tasks on the dataset: ``snakemake learn``."""

    preset: Literal["tiny", "cpu", "small", "paper"] = "cpu"
    """Size of networks and length of training: ``tiny`` for tests, ``cpu`` for real numbers from two cores, ``small``
    for ten minutes on a GPU, ``paper`` as published."""

    seeds: list[Annotated[int, Field(ge=0)]] = Field(default_factory=lambda: [0, 1, 2], min_length=1)
    """One training each."""

    splits: list[Split] = Field(default_factory=lambda: ["object", "family"], min_length=1)
    """``object``: the splits of the dataset. ``shuffled``: folds of objects, so that each is tested once. ``family``:
    folds of whole families or categories, tested on shapes of a kind that training has not seen."""

    folds: int = Field(5, ge=2, le=100)
    """Folds of the splits ``shuffled`` and ``family``; each fold is a training."""

    hold_out: list[str] = Field(default_factory=list)
    """Origins that are never trained on and always tested (``files``, ``bundled``, ``objaverse``)."""

    leave_out: list[str] = Field(default_factory=list)
    """Families that are neither trained on nor tested; folds stay those of all families. Shows what a family brings."""

    gpus: int = Field(0, ge=0, le=8)
    """GPUs of one training, on one host; 0: the processor. Each takes an equal part of ``batch_size``."""

    features: Features = Features()
    """Arrays that training reads."""

    tasks: list[str] = Field(default_factory=lambda: list(MODELS), min_length=1)
    """Tasks to train: ``frequencies``, ``solidity``, ``reconstruction``, ``cavity``, ``retrieval``."""

    frequencies: LearningTask = LearningTask()
    """Predict the frequencies of a body from its shape and material."""

    solidity: LearningTask = LearningTask()
    """Tell solid from hollow bodies by sound and picture."""

    reconstruction: LearningTask = LearningTask()
    """Reconstruct the shape of a body from coarse voxels, its sound and its material."""

    diffsound: DiffSound = DiffSound()
    """A baseline of task ``reconstruction``."""

    cavity: LearningTask = LearningTask()
    """Tell how thick the wall around the cavity of a hollow body is."""

    retrieval: LearningTask = LearningTask()
    """Find sound, picture and shape of a body by each other."""

    @model_validator(mode="after")
    def _settings_are_known(self):
        for name, model in ((name, model) for name, models in MODELS.items() for model in models):
            options = self.run(name, OBJECT, model, self.seeds[0])
            if options.network.points > self.features.points:
                raise ValueError(
                    f"{name}.network.points: the network asks for {options.network.points} points of "
                    f"{self.features.points}; lower it, or raise learn.features.points"
                )
            if name == "reconstruction":
                _check_shape_network(options.network, self.features)
            batch = options.training.batch_size
            if self.gpus and batch % self.gpus:
                raise ValueError(
                    f"{name}.training.batch_size is {batch}, which {self.gpus} GPUs cannot share equally; make it a "
                    "multiple of learn.gpus, or change learn.gpus"
                )
        return self

    @field_validator("tasks")
    @classmethod
    def _known_tasks(cls, tasks: list[str]):
        for name in tasks:
            if name not in MODELS:
                raise ValueError(unknown("task", name, MODELS))
        return tasks

    @field_validator(*MODELS)
    @classmethod
    def _known_models(cls, task: LearningTask, info):
        for name in task.models:
            if name not in MODELS[info.field_name]:
                raise ValueError(unknown("model", name, MODELS[info.field_name]))
        return task

    def models(self, task: str) -> list[str]:
        """Return the models of a task that are trained."""
        return getattr(self, task).models or list(MODELS[task])

    def run(self, task: str, split: str, model: str, seed: int) -> RunOptions:
        """Return the options of one training: those of the preset, then those of the task."""
        own = getattr(self, task)
        parts = [PRESETS[self.preset]]
        parts += [OWN_PRESETS.get(name, {}).get(self.preset, {}) for name in (task, f"{task}/{model}")]
        settings = {
            name: {key: value for part in parts for key, value in part.get(name, {}).items()}
            for name in ("training", "network")
        }
        return RunOptions(
            task=task,
            split=split,
            model=model,
            seed=seed,
            folds=self.folds,
            hold_out=self.hold_out,
            leave_out=self.leave_out,
            preset=self.preset,
            training={**settings["training"], **own.training},
            network={**settings["network"], **own.network},
        )

    def sides(self, task: str) -> list[str]:
        """Return the names of a task's splits: ``object``, ``family-0``, ``family-1``, …"""
        return [
            name
            for split in getattr(self, task).splits or self.splits
            for name in ([split] if split == OBJECT else [f"{split}-{fold}" for fold in range(self.folds)])
        ]


def _check_shape_network(network: Network, features: Features) -> None:
    """Raise :class:`ValueError` for a network of task ``reconstruction`` that cannot be built, or lacks features."""
    if network.width % 64:
        raise ValueError(
            f"reconstruction.network.width is {network.width}; make it a multiple of 64, one per head"
        )
    for key, asked, bound, most in (
        ("latents", network.latents, "reconstruction.network.voxel_points", network.voxel_points),
        ("latents", network.latents, "learn.features.farthest", features.farthest),
        ("voxel_points", network.voxel_points, "learn.features.voxel_points", features.voxel_points),
        ("distances", network.distances, "learn.features.distance_samples", features.distance_samples),
    ):
        if asked > most:
            raise ValueError(
                f"reconstruction.network.{key}: the network asks for {asked}, and {bound} is {most}; lower the first, "
                "or raise the second"
            )
    if features.farthest > features.voxel_points:
        raise ValueError(
            f"features.farthest: {features.farthest} of {features.voxel_points} voxel_points cannot be chosen; lower it"
        )
