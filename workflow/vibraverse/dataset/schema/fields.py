"""Every field of a shard: its path, content and unit.

Paths are relative to the object's group; ``path@name`` is an attribute. Wildcards: ``{solidity}`` is ``solid`` or
``hollow``, ``{material}`` a material, ``{look}`` a look of the pictures, ``{sound}`` a material, or ``material-pK`` for
its K-th struck point.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Field:
    """One array, text or attribute: its path, content and unit.

    ``dtype`` is a NumPy type, ``json`` or ``text`` (UTF-8), or ``png`` (one PNG file's bytes per entry).
    """

    name: str
    path: str
    dtype: str
    shape: str
    unit: str
    description: str

    @property
    def is_attribute(self) -> bool:
        """Whether the field is an attribute of a group, not a dataset."""
        return "@" in self.path

    @property
    def is_text(self) -> bool:
        """Whether the field holds text, and so has no unit."""
        return self.dtype in ("json", "text")

    @property
    def is_refusal(self) -> bool:
        """Whether only refused objects and bodies have the field."""
        return "@refusal_" in self.path


_NORMALISED = "1 (normalised: longest side 1.8)"
_BODY = "{solidity}"
_BASIS = "{solidity}/basis"
_MATERIAL = "{solidity}/materials/{material}"
_SAMPLED = "{solidity}/sampled"
_SOUND = "{solidity}/sounds/{sound}"


def _refusal(place: str, what: str) -> tuple[Field, ...]:
    prefix = "body_" if place else ""
    rows = (
        ("refusal_reason", "reason class"),
        ("refusal_stage", "stage that refused"),
        ("refusal_message", "what is wrong"),
        ("refusal_advice", "what to do about it"),
    )
    return tuple(
        Field(f"{prefix}{name}", f"{place}@{name}", "text", "()", "", f"only on a refused {what}: {text}")
        for name, text in rows
    )


def _sampled(name: str, dtype: str, shape: str, unit: str, what: str) -> Field:
    return Field(f"sampled_{name}", f"{_SAMPLED}/{name}", dtype, shape, unit, f"sampled materials: {what}")


#: Every field of an object, in the order of the documentation.
FIELDS: tuple[Field, ...] = (
    Field("origin", "@origin", "text", "()", "", "generated, bundled, files or objaverse"),
    Field("title", "@title", "text", "()", "", "name of the object"),
    Field("category", "@category", "text", "()", "", "shape family or category"),
    Field("licence", "@licence", "text", "()", "", "licence of the source"),
    Field("attribution", "@attribution", "text", "()", "", "whom the licence asks to name"),
    *_refusal("", "object"),
    Field(
        "products",
        "products",
        "json",
        "()",
        "",
        "SHA-256 of one product per stage that this object came from",
    ),
    Field(
        "checksums",
        "checksums",
        "json",
        "()",
        "",
        "for each group and dataset of the object, the first 64 bits of the SHA-256 of its content",
    ),
    Field("source", "source", "json", "()", "", "where the mesh came from, as written by `sources`"),
    Field("clean", "clean", "json", "()", "", "what was repaired, and the scale, as written by `clean`"),
    Field("surface_vertices", "surface/vertices", "float64", "(V, 3)", _NORMALISED, "closed outer surface"),
    Field(
        "surface_faces", "surface/faces", "int32", "(F, 3)", "1", "its triangles, counter-clockwise outside"
    ),
    Field(
        "moments",
        "shape/moments",
        "float64",
        "(4,)",
        "1 (scale-free)",
        "eigenvalues of the outer surface's second moment over V^(5/3), ascending, then area over V^(2/3)",
    ),
    Field(
        "spectrum",
        "shape/spectrum",
        "float64",
        "(k,)",
        "1 (scale-free)",
        "lowest eigenfrequencies of the solid body, ω̂ V^(1/3) for E = ρ = 1 and ν = 0.25",
    ),
    Field(
        "coarse_vertices", "coarse/vertices", "float64", "(V, 3)", _NORMALISED, "box mesh of the occupancy"
    ),
    Field("coarse_faces", "coarse/faces", "int32", "(F, 3)", "1", "its triangles"),
    Field(
        "occupancy", "grids/occupancy", "uint8", "(n, n, n)", "1", "1 inside at cell centres, `[ix, iy, iz]`"
    ),
    Field(
        "signed_distance",
        "grids/signed_distance",
        "float32",
        "(N, N, N)",
        _NORMALISED,
        "distance to the surface at cell centres, negative inside",
    ),
    Field("azimuth_deg", "cameras/azimuth_deg", "float64", "(views,)", "deg", "camera azimuth of each view"),
    Field(
        "elevation_deg",
        "cameras/elevation_deg",
        "float64",
        "(views,)",
        "deg",
        "camera elevation of each view",
    ),
    Field("views", "views/{look}", "png", "(views,)", "byte", "pictures of the outside, one PNG file each"),
    *_refusal(_BODY, "body"),
    Field("size_m", f"{_BODY}@size_m", "float64", "()", "m", "longest side of the bounding box"),
    Field(
        "size_origin",
        f"{_BODY}@size_origin",
        "text",
        "()",
        "",
        "who says so: manifest, configuration, file (its unit), generated, bundled, or default",
    ),
    Field("scale_m", f"{_BODY}@scale_m", "float64", "()", "m", "metres per normalised unit, `size_m / 1.8`"),
    Field("volume_m3", f"{_BODY}@volume_m3", "float64", "()", "m³", "volume of the body"),
    Field("hollow", "hollow/cavity", "json", "()", "", "how the cavity was made, as written by `hollow`"),
    Field(
        "boundary_vertices",
        "hollow/boundary/vertices",
        "float64",
        "(V, 3)",
        _NORMALISED,
        "surface of the hollow body, cavity walls included",
    ),
    Field("boundary_faces", "hollow/boundary/faces", "int32", "(F, 3)", "1", "its triangles"),
    Field("tets", f"{_BODY}/tets/record", "json", "()", "", "mesh quality, as written by `tets`"),
    Field(
        "tet_points", f"{_BODY}/tets/points", "float64", "(P, 3)", _NORMALISED, "corners of the tetrahedra"
    ),
    Field("tet_cells", f"{_BODY}/tets/cells", "int32", "(T, 4)", "1", "tetrahedra, positively oriented"),
    Field(
        "reduced_lambda",
        f"{_BASIS}/reduced/lambda",
        "float64",
        "(r, r)",
        "1 (per Lamé λ, unit size and density)",
        "stiffness of λ in the modal basis",
    ),
    Field(
        "reduced_mu",
        f"{_BASIS}/reduced/mu",
        "float64",
        "(r, r)",
        "1 (per Lamé μ, unit size and density)",
        "stiffness of μ in the modal basis",
    ),
    Field(
        "residual_sketch",
        f"{_BASIS}/reduced/residual_sketch",
        "float64",
        "(k, p, 3r)",
        "1",
        "random projections of the basis vectors' residual forces, for the error estimate",
    ),
    Field(
        "correction_lambda",
        f"{_BASIS}/correction/lambda",
        "float64",
        "(r + c, c)",
        "1 (per Lamé λ, unit size and density)",
        "stiffness of λ between modal basis and corrections, and among these",
    ),
    Field(
        "correction_mu",
        f"{_BASIS}/correction/mu",
        "float64",
        "(r + c, c)",
        "1 (per Lamé μ, unit size and density)",
        "stiffness of μ, likewise",
    ),
    Field(
        "correction_mass",
        f"{_BASIS}/correction/mass",
        "float64",
        "(r, c)",
        "1 (unit size and density)",
        "mass between modal basis and corrections",
    ),
    Field(
        "correction_surface",
        f"{_BASIS}/correction/surface",
        "float32",
        "(V, 3, c)",
        "1 (mass-normalised, unit size and density)",
        "displacements of the corrections at the surface vertices",
    ),
    Field(
        "residuals", f"{_BASIS}/reduced/residuals", "float64", "(m,)", "1", "residuals of the sparse solve"
    ),
    Field(
        "poisson_range",
        f"{_BASIS}/reduced/poisson_range",
        "float64",
        "(2,)",
        "1",
        "lowest and highest Poisson's ratio the basis holds for",
    ),
    Field(
        "poisson_nodes",
        f"{_BASIS}/reduced/poisson_nodes",
        "float64",
        "(q,)",
        "1",
        "where the sparse problem was solved, then where the basis was corrected",
    ),
    Field(
        "basis_error",
        f"{_BASIS}@error",
        "float64",
        "()",
        "1",
        "largest estimated relative frequency error in that range",
    ),
    Field(
        "vertices",
        f"{_BASIS}/surface/vertices",
        "float64",
        "(V, 3)",
        _NORMALISED,
        "vertices of the mode shapes",
    ),
    Field("faces", f"{_BASIS}/surface/faces", "int32", "(F, 3)", "1", "triangles of that surface"),
    Field(
        "surface_basis",
        f"{_BASIS}/surface/basis",
        "float32",
        "(V, 3, r)",
        "1 (mass-normalised, unit size and density)",
        "basis displacements at those vertices",
    ),
    Field("centre", f"{_BASIS}/rigid/centre", "float64", "(3,)", _NORMALISED, "centre of mass"),
    Field(
        "inertia",
        f"{_BASIS}/rigid/inertia",
        "float64",
        "(3, 3)",
        "1 (normalised length⁵, unit density)",
        "inertia tensor about the centre of mass",
    ),
    Field(
        "basis_volume", f"{_BASIS}@volume", "float64", "()", "1 (normalised length³)", "volume of the body"
    ),
    Field(
        "energy_poisson",
        f"{_BASIS}/reduced/energy_poisson",
        "float64",
        "(k,)",
        "1",
        "Poisson's ratios of the error norms",
    ),
    Field("order", f"{_BASIS}@order", "int64", "()", "1", "element order: 1 or 2"),
    Field("n_vertices", f"{_BASIS}@n_vertices", "int64", "()", "1", "corners of the tetrahedra"),
    Field("n_tetrahedra", f"{_BASIS}@n_tetrahedra", "int64", "()", "1", "tetrahedra"),
    Field("n_unknowns", f"{_BASIS}@n_unknowns", "int64", "()", "1", "unknowns of the sparse problem"),
    Field("method", f"{_BASIS}@method", "text", "()", "", "eigensolver"),
    Field("factorisation", f"{_BASIS}@factorisation", "text", "()", "", "sparse factorisation"),
    Field("density_kg_m3", f"{_MATERIAL}@density_kg_m3", "float64", "()", "kg/m³", "density"),
    Field("young_pa", f"{_MATERIAL}@young_pa", "float64", "()", "Pa", "Young's modulus"),
    Field("poisson", f"{_MATERIAL}@poisson", "float64", "()", "1", "Poisson's ratio"),
    Field("alpha_per_s", f"{_MATERIAL}@alpha_per_s", "float64", "()", "1/s", "mass-proportional damping"),
    Field("beta_s", f"{_MATERIAL}@beta_s", "float64", "()", "s", "stiffness-proportional damping"),
    Field("mass_kg", f"{_MATERIAL}@mass_kg", "float64", "()", "kg", "mass of the body"),
    Field(
        "following_hz",
        f"{_MATERIAL}@following_hz",
        "float64",
        "()",
        "Hz",
        "the next frequency, not kept: that of the last one where a multiplet is cut, 0 where there is none",
    ),
    Field(
        "frequencies_hz",
        f"{_MATERIAL}/frequencies_hz",
        "float64",
        "(m,)",
        "Hz",
        "undamped eigenfrequencies of the elastic modes, ascending",
    ),
    Field("damping_per_s", f"{_MATERIAL}/damping_per_s", "float64", "(m,)", "1/s", "decay rates `d_i`"),
    Field(
        "damped_frequencies_hz",
        f"{_MATERIAL}/damped_frequencies_hz",
        "float64",
        "(m,)",
        "Hz",
        "frequencies that sound; 0 where overdamped",
    ),
    Field(
        "relative_error",
        f"{_MATERIAL}/relative_error",
        "float64",
        "(m,)",
        "1",
        "estimated relative error of each frequency by the basis",
    ),
    Field(
        "discretisation_error",
        f"{_MATERIAL}/discretisation_error",
        "float64",
        "(m,)",
        "1",
        "estimated relative error of each frequency by the elements",
    ),
    Field(
        "solved_directly",
        f"{_MATERIAL}@solved_directly",
        "bool",
        "()",
        "",
        "whether the material was solved on the mesh itself",
    ),
    Field(
        "mode_coefficients",
        f"{_MATERIAL}/mode_coefficients",
        "float32",
        "(m, q)",
        "kg^-1/2",
        "mass-normalised mode shapes in the modal basis, q = r, and its corrections, q = r + c; none where "
        "solved directly",
    ),
    Field(
        "mode_shapes",
        f"{_MATERIAL}/mode_shapes",
        "float32",
        "(m, V, 3)",
        "kg^-1/2",
        "mass-normalised displacements at the surface vertices; stored only where solved directly, otherwise a "
        "reader makes them",
    ),
    _sampled("density_kg_m3", "float64", "(n,)", "kg/m³", "density"),
    _sampled("young_pa", "float64", "(n,)", "Pa", "Young's modulus"),
    _sampled("poisson", "float64", "(n,)", "1", "Poisson's ratio"),
    _sampled("alpha_per_s", "float64", "(n,)", "1/s", "mass-proportional damping"),
    _sampled("beta_s", "float64", "(n,)", "s", "stiffness-proportional damping"),
    _sampled("mass_kg", "float64", "(n,)", "kg", "mass of the body"),
    _sampled("frequencies_hz", "float64", "(n, m)", "Hz", "undamped eigenfrequencies, ascending"),
    _sampled("relative_error", "float32", "(n, m)", "1", "estimated relative error by the basis"),
    _sampled("discretisation_error", "float32", "(n, m)", "1", "estimated relative error by the elements"),
    Field("audio", f"{_BODY}/audio", "json", "()", "", "levels, gains and counts, as written by `audio`"),
    Field("sound", _SOUND, "float32", "(samples,)", "1 (full scale)", "impact sound, peak-normalised"),
    Field("sample_rate_hz", f"{_SOUND}@sample_rate_hz", "int64", "()", "Hz", "samples per second"),
    Field("duration_s", f"{_SOUND}@duration_s", "float64", "()", "s", "length of the sound"),
    Field("gain", f"{_SOUND}@gain", "float64", "()", "1", "stored sample = gain × computed impulse response"),
)
