"""What straight lines meet on a surface."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import reference, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator


def _polydata(vertices: np.ndarray, faces: np.ndarray) -> vtkPolyData:
    """Return a surface as VTK holds it."""
    points = vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, dtype=np.float64), deep=True))
    cells = vtkCellArray()
    offsets = np.arange(0, 3 * len(faces) + 1, 3, dtype=np.int64)
    connectivity = np.ascontiguousarray(faces, dtype=np.int64).ravel()
    cells.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(connectivity, deep=True)
    )
    data = vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    return data


class LineOfSight:
    """Answers where lines meet a surface; some 10 µs each."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self._data = _polydata(vertices, faces)
        self._locator = vtkStaticCellLocator()
        self._locator.SetDataSet(self._data)
        self._locator.BuildLocator()

    def first_hit(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return how far along the lines from ``starts`` to ``ends`` (N, 3) the surface is met, as shares (N,).

        1 means that it is not met.
        """
        meet, shares = self._locator.IntersectWithLine, np.ones(len(starts))
        share, point, inner, sub_id = reference(0.0), [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], reference(0)
        for i, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            if meet(start, end, 1e-9, share, point, inner, sub_id):
                shares[i] = share.get()
        return shares


def depth_below(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return how thick a body is below every vertex (V,): how far down its normal (V, 3) the other side is.

    ``most`` where it is farther than that.
    """
    starts = points - 1e-3 * most * normals
    return most * LineOfSight(points, triangles).first_hit(starts, starts - most * normals)
