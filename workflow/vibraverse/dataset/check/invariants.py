"""The equations that the numbers of every object satisfy. They are cheap, so all objects are checked.

Positive volumes of the elements and their sum, ``m = ρV``, ``s = L / 1.8``, ascending frequencies, ``d = ½(α + βω²)``,
``ω_d = sqrt(ω² - d²)``, mode shapes orthonormal in the mass and orthogonal in the stiffness with ``ω²``, valid vertex
indices in faces, sounds of the stated duration.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vibraverse.contract.texts import and_more
from vibraverse.files.basis import read_basis
from vibraverse.flow.paths import SOLIDITIES
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.geometry.moments import scale_free_moments
from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.modes import departure

#: Largest relative difference, by rounding, between a stored number and the same computed from other numbers.
ROUNDING = 1e-9
#: Largest deviation of mode shapes from orthonormality; their coefficients have single precision.
ORTHOGONALITY = 1e-5
#: Wrong modes that a finding lists.
_SHOWN_MODES = 8


def violated(group) -> Iterator[str]:
    """Yield the violated equations of an object's group; its fields must have the right types and shapes."""
    if "refusal_reason" in group.attrs:
        return
    for place in ("surface", "coarse", "hollow/boundary"):
        if place in group:
            yield from _mesh(place, group[place])
    surface = (group["surface"][name][()] for name in ("vertices", "faces"))
    if not _same(group["shape/moments"][()], scale_free_moments(*surface)):
        yield "shape/moments are not those of its surface"
    for solidity in SOLIDITIES:
        if solidity in group and "refusal_reason" not in group[solidity].attrs:
            yield from (f"{solidity}: {sentence}" for sentence in _body(group[solidity]))


def _mesh(place: str, mesh) -> Iterator[str]:
    if mesh["faces"].size and mesh["faces"][()].max() >= len(mesh["vertices"]):
        yield f"{place}/faces names a vertex that there is not"


def _body(body) -> Iterator[str]:
    size_m, scale_m, volume_m3 = (float(body.attrs[name]) for name in ("size_m", "scale_m", "volume_m3"))
    if not _same(scale_m * LONGEST_SIDE, size_m):
        yield f"scale_m = {scale_m:g} is not size_m / {LONGEST_SIDE} = {size_m / LONGEST_SIDE:g}"
    yield from _mesh("basis/surface", body["basis/surface"])
    points, cells = body["tets/points"][()], body["tets/cells"][()]
    if cells.size and cells.max() >= len(points):
        yield "tets/cells names a point that there is not"
        return
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volumes = np.linalg.det(edges) / 6
    if (volumes <= 0).any():
        yield f"{np.count_nonzero(volumes <= 0)} tetrahedra have no positive volume"
    for name, volume in (
        ("basis@volume", body["basis"].attrs["volume"] * scale_m**3),
        ("volume_m3", volume_m3),
    ):
        if not _same(volume, volumes.sum() * scale_m**3):
            yield f"{name} means {volume:g} m³, the tetrahedra {volumes.sum() * scale_m**3:g} m³"
    basis = read_basis(body["basis"], surface=False)
    for name, material in body["materials"].items():
        yield from (f"{name}: {sentence}" for sentence in _material(material, volume_m3))
        if "mode_coefficients" in material:
            yield from (f"{name}: {sentence}" for sentence in _mode_shapes(basis, material, scale_m))
    if "sampled" in body:
        yield from (f"sampled: {sentence}" for sentence in _sampled(body["sampled"], volume_m3))
    for name, sound in body["sounds"].items():
        length_s = len(sound) / sound.attrs["sample_rate_hz"]
        if not _same(sound.attrs["duration_s"], length_s):
            yield f"{name}: the sound lasts {length_s:g} s, not duration_s = {sound.attrs['duration_s']:g}"


def _sampled(rows, volume_m3: float) -> Iterator[str]:
    if not _same(rows["mass_kg"][()], rows["density_kg_m3"][()] * volume_m3):
        yield "mass_kg is not density times volume"
    if (np.diff(rows["frequencies_hz"][()], axis=1) < 0).any():
        yield "frequencies_hz does not ascend"


def _material(material, volume_m3: float) -> Iterator[str]:
    values = material.attrs
    if not _same(values["mass_kg"], values["density_kg_m3"] * volume_m3):
        yield f"mass_kg = {values['mass_kg']:g} is not density times volume"
    hz = material["frequencies_hz"][()]
    if (np.diff(hz) < 0).any():
        yield "frequencies_hz does not ascend"
    if 0 < values["following_hz"] < hz[-1]:
        yield f"following_hz = {values['following_hz']:g} is below the last frequency"
    omega = 2 * np.pi * hz
    damping, damped = rayleigh_damping(omega, values["alpha_per_s"], values["beta_s"])
    if not _same(material["damping_per_s"][()], damping):
        yield "damping_per_s is not ½(α + β ω²)"
    # Near critical damping ω² and d² cancel, so the difference is relative to ω.
    if np.abs(2 * np.pi * material["damped_frequencies_hz"][()] - damped).max() > 1e-6 * omega.max():
        yield "damped_frequencies_hz is not sqrt(ω² - d²)"


def _mode_shapes(basis, material, scale_m: float) -> Iterator[str]:
    hz, coefficients = material["frequencies_hz"][()], material["mode_coefficients"][()]
    most = len(basis.a_mu), len(basis.correction_mu)
    if coefficients.shape[1] not in most:
        yield f"mode_coefficients has {coefficients.shape[1]} columns, not {most[0]} or {most[1]}"
        return
    wrong = departure(basis, dict(material.attrs), scale_m, hz, coefficients) > ORTHOGONALITY
    if wrong.any():
        modes = np.flatnonzero(wrong).tolist()
        named = " ".join([str(modes[:_SHOWN_MODES]), *and_more(len(modes), _SHOWN_MODES)])
        yield f"mode_coefficients{named} are no modes of the stored basis at these frequencies"


def _same(a, b) -> bool:
    return bool(np.all(np.abs(np.asarray(a) - b) <= ROUNDING * np.abs(b)))
