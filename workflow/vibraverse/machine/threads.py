"""Threads and rounding of numerical libraries, both set before any of them is loaded."""

from __future__ import annotations

import itertools
import os

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "LP_NUM_THREADS",  # Mesa's software renderer
)

#: Libraries choose loops by the processor, and each loop rounds differently. A rotation by 1e-9 is enough to remesh a
#: level set quite differently. With these variables, every processor with AVX2 uses the same loops.
ROUNDING = {
    "MKL_CBWR": "AVX2,STRICT",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}


def set_threads(threads: int) -> None:
    """Set the thread count and the rounding, before any numerical library is loaded."""
    for variable in _THREAD_VARIABLES:
        os.environ[variable] = str(threads)
    set_rounding()


def set_rounding() -> None:
    """Let libraries use the same loops on all processors; call before any of them is loaded."""
    if {"avx2", "fma"} <= _processor_flags():
        for variable, value in ROUNDING.items():
            os.environ.setdefault(variable, value)


def _processor_flags() -> set[str]:
    """Return the processor's flags as the kernel lists them; an empty set without ``/proc``."""
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            return next((set(line.split()) for line in file if line.startswith("flags")), set())
    except OSError:
        return set()


def asked_threads(argv: list[str]) -> str:
    """Return the value of ``--threads``, which is needed before the stage's parser can be imported."""
    for word, following in itertools.pairwise([*argv, ""]):
        name, equals, value = word.partition("=")
        if name == "--threads":
            return value if equals else following
    return "1"
