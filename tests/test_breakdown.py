"""Linear algebra that breaks down refuses the body; anything else stays what it is."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from vibraverse.contract.errors import Refused
from vibraverse.physics.breakdown import refused_breakdown

INDEFINITE = np.diag([1.0, -1.0])


@pytest.mark.parametrize(
    "solve",
    [
        lambda: np.linalg.cholesky(INDEFINITE),
        lambda: scipy.linalg.eigh(np.eye(2), INDEFINITE),
        lambda: scipy.linalg.cho_factor(INDEFINITE),
    ],
)
def test_a_matrix_that_is_not_positive_definite_refuses_the_body(solve):
    with pytest.raises(Refused, match="broke down") as refused, refused_breakdown():
        solve()
    assert refused.value.reason == "solve_failed"
    assert "tets.target_elements" in refused.value.advice


def test_a_wrong_shape_is_a_mistake_of_ours():
    with pytest.raises(ValueError, match="mismatch"), refused_breakdown():
        np.eye(2) @ np.eye(3)
