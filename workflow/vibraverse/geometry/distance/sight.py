"""Intersections of straight lines with a surface, by VTK."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import reference, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator


def _polydata(vertices: np.ndarray, faces: np.ndarray) -> vtkPolyData:
    """Return a surface as VTK polydata."""
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
    """Index of a surface that intersects lines with it in some 10 µs each."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self._data = _polydata(vertices, faces)
        self._locator = vtkStaticCellLocator()
        self._locator.SetDataSet(self._data)
        self._locator.BuildLocator()

    def first_hit(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return the positions (N,) of the first hits along the lines from ``starts`` to ``ends`` (N, 3).

        They are shares of the lines; 1 means no hit.
        """
        meet, shares = self._locator.IntersectWithLine, np.ones(len(starts))
        share, point, inner, sub_id = reference(0.0), [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], reference(0)
        for i, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            if meet(start, end, 1e-9, share, point, inner, sub_id):
                shares[i] = share.get()
        return shares


def depth_below(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return the thickness of a body below every vertex (V,), along its normal (V, 3), at most ``most``."""
    starts = points - 1e-3 * most * normals
    return most * LineOfSight(points, triangles).first_hit(starts, starts - most * normals)
