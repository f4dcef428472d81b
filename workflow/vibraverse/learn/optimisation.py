"""The optimiser, the schedule of its learning rate, and networks for several processes."""

from __future__ import annotations

import math

import torch
from torch.nn.parallel import DistributedDataParallel

from vibraverse.config.training import Training
from vibraverse.contract.errors import UsageError
from vibraverse.learn.ranks import Ranks

_BATCH_NORM = torch.nn.modules.batchnorm._BatchNorm


def optimiser(model: torch.nn.Module, options: Training) -> torch.optim.AdamW:
    """Return AdamW over all weights that are trained."""
    weights = [weight for weight in model.parameters() if weight.requires_grad]
    return torch.optim.AdamW(
        weights, lr=options.learning_rate, betas=options.betas, weight_decay=options.weight_decay
    )


def learning_rate(options: Training, step: int) -> float:
    """Return the learning rate of a step, counted from 0: a function of the step alone."""
    if step < options.warmup_steps:
        return options.learning_rate * (step + 1) / options.warmup_steps
    done = (step - options.warmup_steps) / (options.steps - options.warmup_steps)
    if options.schedule == "linear":
        return options.learning_rate * (1 - done)
    if options.schedule == "cosine":
        return options.learning_rate * (1 + math.cos(math.pi * done)) / 2
    return options.learning_rate


def placed(model: torch.nn.Module, options: Training, ranks: Ranks) -> torch.nn.Module:
    """Return a network on its device, with batch statistics over all processes.

    Raises :class:`UsageError` where batch normalisation cannot work.
    """
    normalised = any(isinstance(layer, _BATCH_NORM) for layer in model.modules())
    if normalised and options.batch_size == 1:
        raise UsageError(
            "batch_size is 1, and the network normalises over the batch: a single sample has no spread; raise "
            "batch_size to 2 or more"
        )
    if normalised and ranks.count > 1:
        if ranks.device.type == "cpu":
            raise UsageError(
                f"{ranks.count} processes train on CPUs, where PyTorch cannot normalise over the batch of all of them; "
                "run one process with more threads, or train on GPUs"
            )
        model = torch.nn.SyncBatchNorm.convert_sync_batchnorm(model)
    return model.to(ranks.device)


def shared(model: torch.nn.Module, ranks: Ranks) -> torch.nn.Module:
    """Return a placed network whose gradients are means over all processes."""
    if ranks.count == 1:
        return model
    return DistributedDataParallel(model, device_ids=[ranks.device] if ranks.device.type == "cuda" else None)
