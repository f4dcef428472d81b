"""Stage ``basis``: tetrahedra in, the material-independent modal basis out."""

from __future__ import annotations

from dataclasses import fields

from vibraverse.config.physics import Basis
from vibraverse.products import write_provenance
from vibraverse.stage import Job, Stage

#: Where each field of a ModalBasis lies in basis.h5, its type there, and its unit.
_DATASETS = {
    "a_lambda": ("reduced/lambda", "f8", "1 (E = rho = 1, mesh units)"),
    "a_mu": ("reduced/mu", "f8", "1 (E = rho = 1, mesh units)"),
    "sketch": ("reduced/residual_sketch", "f8", "1"),
    "residuals": ("reduced/residuals", "f8", "1"),
    "energy_poisson": ("reduced/energy_poisson", "f8", "1"),
    "poisson_range": ("reduced/poisson_range", "f8", "1"),
    "poisson_nodes": ("reduced/poisson_nodes", "f8", "1"),
    "vertices": ("surface/vertices", "f8", "normalised length"),
    "faces": ("surface/faces", "i4", "index into surface/vertices"),
    "surface": ("surface/basis", "f4", "mass-normalised displacement, unit density, mesh units"),
    "correction_lambda": ("correction/lambda", "f8", "1 (E = rho = 1, mesh units)"),
    "correction_mu": ("correction/mu", "f8", "1 (E = rho = 1, mesh units)"),
    "correction_mass": ("correction/mass", "f8", "1 (unit density, mesh units)"),
    "correction_surface": (
        "correction/surface",
        "f4",
        "mass-normalised displacement, unit density, mesh units",
    ),
    "centre": ("rigid/centre", "f8", "normalised length"),
    "inertia": ("rigid/inertia", "f8", "normalised length^5, unit density"),
}


def write_basis(h5, basis) -> None:
    """Write a ModalBasis to an open HDF5 file; what is no array becomes an attribute."""
    for field in fields(basis):
        value = getattr(basis, field.name)
        if field.name in _DATASETS:
            path, dtype, unit = _DATASETS[field.name]
            dataset = h5.create_dataset(path, data=value.astype(dtype))
            dataset.attrs["unit"] = unit
        else:
            h5.attrs[field.name] = value


def read_basis(h5):
    """Return the ModalBasis of an open HDF5 file or group."""
    from vibraverse.physics.basis import ModalBasis

    values = {}
    for field in fields(ModalBasis):
        if field.name in _DATASETS:
            values[field.name] = h5[_DATASETS[field.name][0]][()]
        else:
            value = h5.attrs[field.name]
            values[field.name] = value.item() if hasattr(value, "item") else value
    return ModalBasis(**values)


def run(job: Job) -> None:
    """Solve for the basis of one body."""
    import h5py

    from vibraverse.limits import limited_memory
    from vibraverse.physics.basis import build_basis
    from vibraverse.seeds import rng
    from vibraverse.tetfiles import read_tets

    points, cells = read_tets(job.inputs["tets"])
    options = job.options
    with limited_memory(options.memory_mb, "the eigensolver", "basis.memory_mb"):
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
    with h5py.File(job.outputs["basis"], "w") as h5:
        write_basis(h5, basis)
        write_provenance(h5, job.provenance())
    print(
        f"{basis.n_tetrahedra} tetrahedra, {basis.n_unknowns} unknowns, {basis.method} on {basis.factorisation}: "
        f"{len(basis.a_lambda)} basis vectors, frequency error up to {basis.error:.1e}"
    )


STAGE = Stage(
    name="basis",
    help="Solve the free body's eigenproblem and find a basis for every Poisson's ratio.",
    inputs={"tets": "tets.msh"},
    outputs={"basis": "basis.h5"},
    run=run,
    options=Basis,
    libraries=("numpy", "scipy", "scikit-fem", "pypardiso"),
    per_solidity=True,
)
