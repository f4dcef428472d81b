"""The shape network: an octree CNN (LeNet) from surface points with normals to a vector.

O-CNN (Wang et al. 2017) in the pure PyTorch package ``ocnn``. The convolutions see the surface in cells of
``2 / 2^depth``, so a wall thinner than two cells is seen as one sheet; depth 6 separates walls down to 1/16 of the box.
"""

from __future__ import annotations

import torch
from ocnn.models import LeNet
from ocnn.octree import Octree, Points, merge_octrees
from torch import nn

#: Cells of the coarsest level that every octree fills; ``ocnn`` needs two levels.
_FULL_DEPTH = 2
#: Channels of a cell: its normal and its displacement along it.
_CHANNELS = 4
#: The head of LeNet takes 4³ cells, two halvings above the full depth.
_LEAVES = 2


class OctreeNetwork(nn.Module):
    """Points with normals (B, p, 6), strictly inside (-1, 1)³, to vectors (B, width).

    Batch normalisation inside: a batch of one fails in training, and several processes need synchronised statistics.
    """

    def __init__(self, depth: int, width: int):
        super().__init__()
        self.depth = depth
        self.network = LeNet(_CHANNELS, width, stages=depth - _LEAVES, nempty=False)
        for module in self.network.modules():
            if isinstance(module, nn.Dropout):
                module.p = 0.0  # its noise of a half would be the error of a regression

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Return the vectors (B, width)."""
        octree = octree_of(points, self.depth)
        return self.network(octree.get_input_feature("ND"), octree, self.depth)


def octree_of(points: torch.Tensor, depth: int) -> Octree:
    """Return the octree of a batch of bodies (B, p, 6)."""
    octrees = []
    for body in points.float():
        octree = Octree(depth, _FULL_DEPTH, device=points.device)
        octree.build_octree(Points(body[:, :3].contiguous(), body[:, 3:].contiguous()))
        octrees.append(octree)
    merged = merge_octrees(octrees)
    merged.construct_all_neigh()  # after merging: the merged tree has its own neighbours
    return merged


def turned(points: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """Return points with normals (B, p, 6) turned by rotations (B, 3, 3) about the origin, and scaled back if needed.

    A cube's corner leaves the box when it is turned; the body is then shrunk into it. Networks get the size as a
    number of its own, so nothing is lost.
    """
    places, normals = points[..., :3] @ turns.mT, points[..., 3:] @ turns.mT
    reach = places.abs().amax(dim=(1, 2), keepdim=True)
    return torch.cat([places * torch.clamp(0.95 / reach, max=1.0), normals], dim=-1)


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Return the rotations (B, 3, 3) of quaternions (B, 4), which need not be of unit length."""
    w, x, y, z = nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
