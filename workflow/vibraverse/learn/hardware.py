"""What a training ran on, for its metrics."""

from __future__ import annotations

import os
import platform

import numpy as np
import torch

from vibraverse import __version__


def processor() -> str:
    """Return the name of the processor, as the kernel gives it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            named = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
            return next(named, "") or platform.machine()
    except OSError:
        return platform.processor() or platform.machine()


def describe(device: torch.device) -> dict:
    """Return the hardware and the threads of this process: ``gpu`` is None on a CPU."""
    gpu = torch.cuda.get_device_name(device) if device.type == "cuda" else None
    return {
        "device": device.type,
        "gpu": gpu,
        "cpu": processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": torch.get_num_threads(),
    }


def versions() -> dict[str, str]:
    """Return the versions that decide a training's numbers."""
    return {
        "vibraverse": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": str(torch.__version__),
    }
