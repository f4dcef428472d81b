"""Skins and morph targets of glTF 2.0 at rest: where the joints of the file and its default weights put a mesh."""

from __future__ import annotations

import numpy as np

#: Vertices that are moved at once, which limits the memory.
_BLOCK = 1 << 16


def posed(
    points: np.ndarray, joints: np.ndarray, weights: np.ndarray, matrices: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return the vertices (V, 3) of a skinned mesh in the scene, and whether the skin mirrors it.

    ``joints`` (V, 4n) are rows of ``matrices`` (J, 4, 4), which take the mesh at its bind pose to the scene: a joint's
    transform times its inverse bind matrix. ``weights`` (V, 4n) are their shares, as linear blend skinning has them. A
    vertex without weights follows its first joint. Raises ``ValueError`` for a joint that does not exist.
    """
    if joints.dtype.kind != "u" or (len(joints) and joints.max() >= len(matrices)):
        raise ValueError(f"a vertex follows a joint that its skin of {len(matrices)} joints lacks")
    shares = np.array(weights, dtype=np.float64)
    total = shares.sum(axis=1, keepdims=True)
    shares[total[:, 0] == 0, 0] = 1.0
    shares /= np.where(total == 0, 1.0, total)
    moved = np.empty_like(points)
    for begin in range(0, len(points), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        blended = np.einsum("vj,vjab->vab", shares[block], matrices[joints[block]])
        moved[block] = np.einsum("vab,vb->va", blended[:, :3, :3], points[block]) + blended[:, :3, 3]
    used = np.bincount(joints.ravel(), shares.ravel(), minlength=len(matrices))
    return moved, bool(np.linalg.det(np.einsum("j,jab->ab", used, matrices)[:3, :3]) < 0)


def morphed(points: np.ndarray, targets: list[np.ndarray], weights: list[float]) -> np.ndarray:
    """Return the vertices (V, 3), displaced by each target (V, 3) times its weight."""
    moved = points.copy()
    for target, weight in zip(targets, weights, strict=True):
        if target.shape != points.shape:
            raise ValueError(f"a morph target moves {len(target)} vertices of a part with {len(points)}")
        moved += weight * target
    return moved
