"""Warnings about the frequencies of a body."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

#: Largest estimated discretisation error without a warning. Young's moduli of one material scatter by some 5 %, which
#: shifts every frequency by 2.5 %, so smaller errors do not matter. One of the default run's 22 bodies is above, a
#: rough ant (2.9 %; four times the target lowers it to 1.7 % and shifts that frequency by 1.6 %). The next is a hollow
#: tuning fork (1.9 %; twice the target shifts its frequencies by at most 0.4 %).
MAX_ELEMENT_ERROR = 0.02


def cautions(discretisation_errors: Iterable[np.ndarray]) -> list[str]:
    """Return the warnings about the modes of a body, from ``discretisation_error`` (m,) of each material."""
    errors = np.max(list(discretisation_errors), axis=0)
    above = int((errors > MAX_ELEMENT_ERROR).sum())
    if not above:
        return []
    worst = errors.argmax()
    return [
        f"the estimated frequency error by the elements reaches {100 * errors[worst]:.1f} % in mode {worst + 1} "
        f"(at most {100 * MAX_ELEMENT_ERROR:g} %; above in {above} of {len(errors)} modes). Raise "
        "tets.target_elements, or leave those modes out."
    ]
