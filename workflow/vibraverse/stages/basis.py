"""Stage ``basis``: tetrahedra in, the material-independent modal basis out."""

from __future__ import annotations

from vibraverse.contract.products import hdf5, write_provenance
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Solve for the basis of one body."""
    from vibraverse.contract.limits import keep_memory, limited_memory
    from vibraverse.contract.seeds import rng
    from vibraverse.files.basis import write_basis
    from vibraverse.files.tets import read_tets
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.breakdown import refused_breakdown
    from vibraverse.physics.factorisation import load

    points, cells = read_tets(job.inputs["tets"])
    options = job.options
    load(options.factorisation)
    keep_memory()
    with limited_memory(options.memory_mb, "The eigensolver", "basis.memory_mb"), refused_breakdown():
        basis = build_basis(
            points,
            cells,
            rng=rng(job.object, job.solidity, "basis"),
            order=options.order,
            modes=options.modes,
            poisson_range=options.poisson_range,
            max_error=options.max_error,
            method=options.method,
            factorisation=options.factorisation,
            tolerance=options.tolerance,
        )
    with hdf5(job.outputs["basis"]) as h5:
        write_basis(h5, basis)
        write_provenance(h5, job.provenance())
    print(
        f"{basis.n_tetrahedra} tetrahedra, {basis.n_unknowns} unknowns, {basis.method} on {basis.factorisation}: "
        f"{len(basis.a_lambda)} basis vectors, frequency error up to {basis.error:.1e}"
    )


def prepare() -> None:
    """Solve a small system, because MKL loads its code for this processor on first use."""
    from vibraverse.physics.factorisation import load

    load()
