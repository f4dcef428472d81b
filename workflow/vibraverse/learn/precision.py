"""Arithmetic of training: bfloat16 or float32, and TF32, said in the metrics."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


def resolve(precision: str, device: torch.device) -> str:
    """Return ``float32`` or ``bf16`` for a setting; ``auto`` is bf16 on GPUs that have it."""
    if precision != "auto":
        return precision
    return "bf16" if device.type == "cuda" and torch.cuda.is_bf16_supported() else "float32"


def autocast(precision: str, device: torch.device) -> torch.autocast:
    """Return the context in which a network runs: bfloat16 where that is accurate enough, or plain float32."""
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=precision == "bf16")


def exact(device: torch.device) -> torch.autocast:
    """Return a context without autocast, for what a task computes in its own precision: eigenvalues in float64."""
    return torch.autocast(device.type, enabled=False)


@contextmanager
def tf32(enabled: bool) -> Iterator[None]:
    """Let GPUs round float32 products to TF32 (10 bits), or not; the settings come back afterwards."""
    before = torch.backends.cuda.matmul.allow_tf32, torch.backends.cudnn.allow_tf32
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = enabled
    try:
        yield
    finally:
        torch.backends.cuda.matmul.allow_tf32, torch.backends.cudnn.allow_tf32 = before
