"""Convergence study of a body: solved on every mesh in every order, like any object, and compared with references."""

from __future__ import annotations

from itertools import product

import numpy as np

from vibraverse.contract.seeds import rng
from vibraverse.physics.basis import build_basis
from vibraverse.physics.modes import solve_material
from vibraverse.validation.bodies import Body
from vibraverse.validation.references import Reference, references

ORDERS = (1, 2)


def study(body: Body, meshes: list[tuple[np.ndarray, np.ndarray]], scale_m: float) -> list[dict]:
    """Return the rows of the table for one body; ``meshes`` are points and cells, coarse to fine.

    One basis serves every Poisson's ratio, as it serves every material of an object. Uncorrected and corrected
    frequencies (:mod:`vibraverse.physics.enrichment`) are both compared.
    """
    wanted = {poisson: references(body, poisson) for poisson in body.poissons}
    modes = max(line.first + line.count for lines in wanted.values() for line in lines)
    rows = []
    for order in ORDERS:
        used = meshes if order == 1 else meshes[: len(body.elements)]
        for number, (points, cells) in enumerate(used):
            basis = build_basis(
                points,
                cells,
                rng=rng(body.name, str(order), str(number)),
                order=order,
                modes=modes,
                poisson_range=(min(body.poissons), max(body.poissons)),
            )
            finest = number == len(used) - 1
            for corrected, (poisson, lines) in product((False, True), wanted.items()):
                hz = solve_material(basis, body.material(poisson), scale_m, modes, corrected).frequencies_hz
                rows += [
                    {
                        "body": body.name,
                        **compare(line, hz, _tolerance(body, line, order, corrected) if finest else None),
                        "order": order,
                        "corrected": "yes" if corrected else "no",
                        "tetrahedra": basis.n_tetrahedra,
                        "unknowns": basis.n_unknowns,
                    }
                    for line in lines
                ]
    return rows


def _tolerance(body: Body, line: Reference, order: int, corrected: bool) -> float | None:
    """Return the error accepted on the finest mesh, or None if it is not judged."""
    if line.published:
        return line.tolerance if order == 2 else None
    return body.tolerances[order][corrected] if order in body.tolerances else None


def compare(line: Reference, hz: np.ndarray, tolerance: float | None) -> dict:
    """Return a row that compares a reference with the computed frequencies (m,).

    The worst of equal frequencies represents all. Without a ``tolerance`` the row is shown, not judged.
    """
    found = hz[line.first : line.first + line.count]
    errors = found / line.hz - 1.0
    worst = int(np.argmax(np.abs(errors)))
    error = float(errors[worst])
    return {
        "mode": line.mode,
        "equal": line.count,
        "poisson": line.poisson,
        "reference_hz": line.hz,
        "computed_hz": float(found[worst]),
        "relative_error": error,
        "tolerance": tolerance,
        "verdict": "shown" if tolerance is None else "met" if abs(error) <= tolerance else "missed",
        "published": line.published,
        "source": line.source,
    }
