"""The same digits on every processor: compared with those recorded on processors of two makers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from vibraverse.machine.threads import _processor_flags

#: Versions of NumPy and SciPy, and digests that an AMD EPYC (Zen 5) and an Intel Xeon gave with them, which differ
#: from each other where nothing is pinned.
RECORDED = ("2.4.6", "1.17.1")
DIGESTS = (
    "exp fd74a792 log 970063c6 power a332927c product 7a4c0578 eigh 5a0f3da3 axes fb86a7cf "
    "stiffness 2e5aae81 solution e5989bb8 modes 549cf654"
)
PROGRAM = """
from vibraverse.machine.threads import set_threads
set_threads(1)
import hashlib
import numpy as np
import scipy
import scipy.linalg
import shapes
from meshes import box
from vibraverse.geometry.moments import principal_axes
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.factorisation import factorise
from vibraverse.physics.materials import lame

def digest(array):
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:8]

random = np.random.default_rng(0)
line, square = random.uniform(-30, 30, 200001), random.normal(size=(300, 300))
size = abs(line)
loops = {
    "exp": np.exp(line),
    "log": np.log(size),
    "power": size**1.7,
    "product": square @ square,
    "eigh": np.linalg.eigh(square + square.T)[0],
}
vertices, faces = shapes.ball(subdivisions=4)
loops["axes"] = principal_axes(vertices * [1, 1.0001, 0.2], faces)[1]
operators = assemble(*box((1.8, 1.1, 0.7), (6, 5, 4)))
loops["stiffness"] = operators.stiffness(*lame(1.0, 0.3)).data
factor = factorise(operators.shifted(*lame(1.0, 0.3), -1.0), "superlu")
loops["solution"] = factor.solve(random.normal(size=(operators.unknowns, 5)))
small = operators.shifted(*lame(1.0, 0.3), -1.0)[:600, :600].toarray()
loops["modes"] = scipy.linalg.eigh(small, subset_by_index=(0, 20))[0]
print(np.__version__, scipy.__version__)
print(*(f"{name} {digest(array)}" for name, array in loops.items()))
"""


def test_the_digits_are_those_of_other_processors():
    if not {"avx2", "fma"} <= _processor_flags():
        pytest.skip("this processor has no AVX2")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        cwd=Path(__file__).parent,
        env={"PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=True,
    )
    versions, digests = done.stdout.splitlines()
    if tuple(versions.split()) != RECORDED:
        pytest.skip("recorded with other versions of NumPy and SciPy")
    assert digests == DIGESTS
