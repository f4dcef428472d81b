"""The modal basis as an HDF5 file: ``basis.h5``, and the same layout inside a shard of the dataset."""

from __future__ import annotations

from dataclasses import fields

from vibraverse.physics.reduced import ModalBasis

#: Field of a ModalBasis -> its path in basis.h5, its type and its unit.
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

#: Fields that only mode shapes need.
_ON_SURFACE = ("vertices", "faces", "surface", "correction_surface")


def write_basis(h5, basis) -> None:
    """Write a ModalBasis to an open HDF5 file: arrays as datasets, other fields as attributes."""
    for field in fields(basis):
        value = getattr(basis, field.name)
        if field.name in _DATASETS:
            path, dtype, unit = _DATASETS[field.name]
            dataset = h5.create_dataset(path, data=value.astype(dtype))
            dataset.attrs["unit"] = unit
        else:
            h5.attrs[field.name] = value


def read_basis(h5, surface: bool = True) -> ModalBasis:
    """Return the ModalBasis of an open HDF5 file or group.

    Without ``surface``, by far the largest part, the arrays on the surface are None and only frequencies can be
    computed.
    """
    values = {}
    for field in fields(ModalBasis):
        if field.name in _ON_SURFACE and not surface:
            values[field.name] = None
        elif field.name in _DATASETS:
            values[field.name] = h5[_DATASETS[field.name][0]][()]
        else:
            value = h5.attrs[field.name]
            values[field.name] = value.item() if hasattr(value, "item") else value
    return ModalBasis(**values)
