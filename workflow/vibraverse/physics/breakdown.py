"""Dense linear algebra that breaks down on the matrices of one body."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from vibraverse.contract.errors import Refused


@contextmanager
def refused_breakdown() -> Iterator[None]:
    """Raise :class:`Refused` with reason ``solve_failed`` instead of ``LinAlgError``.

    LAPACK raises it where a matrix that must be positive definite is not, and where an iteration does not converge:
    both come from elements so flat that rounding decides.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        said = str(error).rstrip(".")
        raise Refused(
            "solve_failed",
            f"The eigenproblem broke down ({said}): elements of the mesh are too flat for its arithmetic.",
            "Raise tets.target_elements, or repair the mesh where it is thinnest.",
        ) from None
