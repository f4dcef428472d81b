"""How many threads numerical libraries use, and that they round alike everywhere; both before any of them is loaded."""

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

#: Libraries choose loops by the processor, and each rounds in its own way: a level set whose axes turn by 1e-9 may be
#: remade quite differently. With these every processor with AVX2 takes the same loops.
ROUNDING = {
    "MKL_CBWR": "AVX2,STRICT",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
}


def set_threads(threads: int) -> None:
    """Fix the thread count, and the rounding, before any numerical library is loaded."""
    for variable in _THREAD_VARIABLES:
        os.environ[variable] = str(threads)
    set_rounding()


def set_rounding() -> None:
    """Let libraries take the same loops as on other processors; before any of them is loaded."""
    if {"avx2", "fma"} <= _processor_flags():
        for variable, value in ROUNDING.items():
            os.environ.setdefault(variable, value)


def _processor_flags() -> set[str]:
    """Return what the processor is capable of, in the kernel's words; nothing where the system does not say."""
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as file:
            return next((set(line.split()) for line in file if line.startswith("flags")), set())
    except OSError:
        return set()


def asked_threads(argv: list[str]) -> str:
    """Return what stands after ``--threads``, which is needed before there is a parser: that of the stage."""
    for word, following in itertools.pairwise([*argv, ""]):
        name, equals, value = word.partition("=")
        if name == "--threads":
            return value if equals else following
    return "1"
