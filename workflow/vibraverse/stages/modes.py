"""Stage ``modes``: the modal basis and the materials in, frequencies, damping and mode shapes out.

Mode shapes are stored as coefficients in the basis. If the basis is not accurate enough for a material (usually because
its Poisson's ratio lies outside the range), the material is solved on the mesh, and its shapes are stored in full.
"""

from __future__ import annotations

from vibraverse.contract.products import hdf5, read_json, write_provenance
from vibraverse.contract.stage import Job
from vibraverse.geometry import LONGEST_SIDE

_UNITS = {
    "frequencies_hz": "Hz",
    "damped_frequencies_hz": "Hz",
    "damping_per_s": "1/s",
    "relative_error": "1",
    "discretisation_error": "1",
}
_SHAPE_UNIT = "kg^-1/2"

#: Quantities stored for sampled materials, with units. Damping follows from the parameters: ``d = ½(α + β ω²)``.
SAMPLED_UNITS = {
    "density_kg_m3": "kg/m³",
    "young_pa": "Pa",
    "poisson": "1",
    "alpha_per_s": "1/s",
    "beta_s": "s",
    "mass_kg": "kg",
    "frequencies_hz": "Hz",
    "relative_error": "1",
    "discretisation_error": "1",
}


def run(job: Job) -> None:
    """Solve every material of one body."""
    import h5py

    from vibraverse.files.basis import read_basis
    from vibraverse.physics.breakdown import refused_breakdown
    from vibraverse.physics.shapes import mode_shapes

    size_m, size_origin = job.options.object_size(read_json(job.inputs["clean_record"]))
    scale_m = size_m / LONGEST_SIDE
    with h5py.File(job.inputs["basis"]) as h5:
        basis = read_basis(h5, surface=False)
    with hdf5(job.outputs["modes"]) as h5, refused_breakdown():
        h5.attrs["object"] = job.object
        h5.attrs["solidity"] = job.solidity
        h5.attrs["size_m"] = size_m
        h5.attrs["size_origin"] = size_origin
        h5.attrs["scale_m"] = scale_m
        h5.attrs["volume_m3"] = basis.volume * scale_m**3
        write_provenance(h5, job.provenance())
        for name, material in job.options.materials.items():
            values = material.model_dump()
            modes, direct = _solved(job, basis, values, scale_m)
            group = h5.create_group(f"materials/{name}")
            group.attrs["solved_directly"] = direct is not None
            group.attrs.update(values)
            group.attrs["mass_kg"] = modes.mass_kg
            group.attrs["following_hz"] = modes.following_hz
            for key, unit in _UNITS.items():
                group.create_dataset(key, data=getattr(modes, key)).attrs["unit"] = unit
            if direct is None:
                name_of_shapes, shapes = "mode_coefficients", modes.coefficients
            else:
                surface = direct.surface, direct.correction_surface
                name_of_shapes, shapes = "mode_shapes", mode_shapes(*surface, modes.coefficients)
            group.create_dataset(name_of_shapes, data=shapes.astype("f4")).attrs["unit"] = _SHAPE_UNIT
            print(
                f"{name}: {modes.frequencies_hz[0]:.1f} Hz to {modes.frequencies_hz[-1]:.1f} Hz, "
                f"estimated error up to {modes.relative_error.max():.1e} by the basis and "
                f"{modes.discretisation_error.max():.1e} by the elements"
                + ("" if direct is None else ", solved on the mesh")
            )
        if job.options.sampled.count:
            _write_sampled(h5, job, basis, scale_m)


def _write_sampled(h5, job: Job, basis, scale_m: float) -> None:
    """Solve the sampled materials and write them: an array per quantity, a row per material."""
    from vibraverse.physics.materials import sampled
    from vibraverse.physics.modes import solve_materials

    options = job.options
    drawn = sampled(job.object, options.sampled.seed, options.sampled.count, options.sampled.ranges())
    solved = solve_materials(basis, drawn, scale_m, options.modes, options.corrected)
    for key, unit in SAMPLED_UNITS.items():
        dtype = "f4" if key.endswith("_error") else "f8"
        array = h5.create_dataset(f"sampled/{key}", data={**drawn, **solved}[key].astype(dtype))
        array.attrs["unit"] = unit
    print(
        f"{options.sampled.count} sampled materials: estimated error up to {solved['relative_error'].max():.1e} by the "
        f"basis and {solved['discretisation_error'].max():.1e} by the elements"
    )


def _solved(job: Job, basis, material: dict, scale_m: float):
    """Return the modes of a material, and the basis of a solve on the mesh if one was needed, else None."""
    from vibraverse.physics.modes import solve_material

    options = job.options
    modes = solve_material(basis, material, scale_m, options.modes, options.corrected)
    if modes.relative_error.max() <= options.tolerance:
        return modes, None
    from vibraverse.contract.limits import limited_memory
    from vibraverse.contract.seeds import rng
    from vibraverse.files.tets import read_tets
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.factorisation import load

    load()
    with limited_memory(options.memory_mb, "The eigensolver", "modes.memory_mb"):
        direct = build_basis(
            *read_tets(job.inputs["tets"]),
            rng=rng(job.object, job.solidity, "basis"),
            order=basis.order,
            modes=len(basis.residuals),
            poisson_range=(material["poisson"],) * 2,
            max_error=0.1 * options.tolerance,
        )
    return solve_material(direct, material, scale_m, options.modes, options.corrected), direct
