"""Options of training, the same for every learning task."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from vibraverse.config.base import Section

#: A decay rate of AdamW's running means.
Beta = Annotated[float, Field(ge=0, lt=1)]


class Training(Section):
    """How a network is trained: AdamW, a schedule of its learning rate, and what bounds it."""

    steps: PositiveInt = 1000
    """Updates of the weights."""

    batch_size: PositiveInt = 16
    """Samples per step, over all processes together."""

    learning_rate: PositiveFloat = 1e-3
    """Highest learning rate."""

    weight_decay: NonNegativeFloat = 1e-4
    """Decoupled weight decay of AdamW."""

    betas: tuple[Beta, Beta] = (0.9, 0.999)
    """Decay rates of AdamW's running means of the gradient and of its square."""

    schedule: Literal["linear", "cosine", "constant"] = "linear"
    """Learning rate after the warm-up: falls to zero along a line or half a cosine, or stays."""

    warmup_steps: NonNegativeInt = 0
    """First steps, in which the learning rate rises along a line."""

    clip_norm: PositiveFloat | None = 1.0
    """Largest norm of the gradient; a longer one is scaled down. Empty: no limit."""

    minutes: PositiveFloat | None = None
    """Wall-clock limit, over all attempts together. Training then ends with what it reached. Empty: no limit."""

    checkpoint_minutes: NonNegativeFloat = 10
    """Minutes between checkpoints; 0 writes one after every step."""

    validate_every: NonNegativeInt = 0
    """Steps between validations; there is always one at the end. 0: only that one."""

    workers: NonNegativeInt = 0
    """Processes that read data, for each process that trains; 0 reads in the training process itself."""

    precision: Literal["auto", "float32", "bf16"] = "auto"
    """Arithmetic of the network. ``auto``: bfloat16 autocast on GPUs that have it, float32 elsewhere."""

    @model_validator(mode="after")
    def _warm_up_ends(self):
        if self.warmup_steps >= self.steps:
            raise ValueError(
                f"warmup_steps ({self.warmup_steps}) must be less than steps ({self.steps}); "
                "shorten the warm-up, or train longer"
            )
        return self
