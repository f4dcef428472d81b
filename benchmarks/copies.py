"""Differences between the fingerprints of copies, and of objects that only look alike.

    python benchmarks/copies.py [--numbers 12] [--pairs 12] [OBJECT ...]

Copies: rotated and scaled; a third of the triangles split; decimated to half the triangles. Look-alikes: the pairs with
the nearest moments among all generated objects with those numbers. Differences are of logarithms, in per cent: the
largest of the moments, the median and the largest of 20 frequencies. Tolerances: 1, 0.5 and 3 %.
"""

from __future__ import annotations

import argparse
from functools import cache

from vibraverse.machine.threads import set_threads

set_threads(1)

import numpy as np  # noqa: E402

OBJECTS = ("tuning-fork-0000", "bell-0000", "spoon-0000", "cup-0000", "key-0000", "plate-0003")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="*", default=OBJECTS)
    parser.add_argument(
        "--numbers", type=int, default=12, help="objects per family among which pairs are sought"
    )
    parser.add_argument("--pairs", type=int, default=12, help="how many of the nearest pairs")
    arguments = parser.parse_args()
    print("| one | other | moments, % | frequencies: median, largest, % | copies |\n|" + 5 * " --- |")
    for name in arguments.objects:
        for kind in ("turned", "split", "thinned"):
            _print(name, kind, _fingerprint(name), _fingerprint(name, kind))
    for one, other in _nearest(arguments.numbers, arguments.pairs):
        _print(one, other, _fingerprint(one), _fingerprint(other))


def _print(one: str, other: str, first, second) -> None:
    from vibraverse.dataset.split.copies import groups

    moments, spectrum = (100 * np.abs(np.log(a) - np.log(b)) for a, b in zip(first, second, strict=True))
    same = groups({"a": first, "b": second})["b"] == "a"
    print(
        f"| {one} | {other} | {moments.max():.2g} | {np.median(spectrum):.2g}, {spectrum.max():.2g} "
        f"| {'yes' if same else 'no'} |",
        flush=True,
    )


@cache
def _fingerprint(name: str, kind: str = "") -> tuple[np.ndarray, np.ndarray]:
    from vibraverse.contract.seeds import rng
    from vibraverse.dataset.split.copies import scale_free_spectrum
    from vibraverse.geometry.cleaning.clean import clean
    from vibraverse.geometry.meshing.tets import tetrahedralise
    from vibraverse.geometry.moments import scale_free_moments
    from vibraverse.physics.basis import build_basis

    body = clean(*_variant(name, kind))
    tets = tetrahedralise(body.vertices, body.faces)
    basis = build_basis(tets.points, tets.cells, rng=rng(name, kind), modes=24)
    return scale_free_moments(body.vertices, body.faces), scale_free_spectrum(basis)


def _variant(name: str, kind: str) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = _surface(name)
    if kind == "turned":
        turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        return 3.7 * vertices @ (turn * np.sign(np.linalg.det(turn))), faces
    if kind == "split":
        a, b, c = faces[::3].T
        middle = len(vertices) + np.arange(len(a))
        fan = [np.column_stack(t) for t in ((a, b, middle), (b, c, middle), (c, a, middle))]
        rest = np.delete(faces, slice(None, None, 3), axis=0)
        return np.concatenate([vertices, vertices[faces[::3]].mean(axis=1)]), np.concatenate([rest, *fan])
    if kind == "thinned":
        import pymeshlab

        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
        meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=len(faces) // 2, preservetopology=True)
        return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()
    return vertices, faces


@cache
def _surface(name: str) -> tuple[np.ndarray, np.ndarray]:
    from vibraverse.sources.families import generate

    mesh = generate(name)
    return np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)


def _nearest(numbers: int, count: int) -> list[tuple[str, str]]:
    from scipy.spatial import cKDTree

    from vibraverse.geometry.moments import scale_free_moments
    from vibraverse.sources.families import GROUPS

    names = [f"{family}-{number:04d}" for family in GROUPS["parametric"] for number in range(numbers)]
    moments = np.log([scale_free_moments(*_surface(name)) for name in names])
    pairs = cKDTree(moments).query_pairs(0.05, p=np.inf, output_type="ndarray")
    apart = np.abs(moments[pairs[:, 0]] - moments[pairs[:, 1]]).max(axis=1)
    return [tuple(names[i] for i in pairs[row]) for row in np.argsort(apart)[:count]]


if __name__ == "__main__":
    main()
