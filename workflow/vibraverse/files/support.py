"""What changes the geometry in files of each format, and what the readers do about it.

A test makes a file for every row, and the table is in ``docs/own-meshes.md``.
"""

from __future__ import annotations

from typing import NamedTuple

READ, LEFT_OUT, WARNED, REFUSED = "read", "left out", "warning", "refused"


class Row(NamedTuple):
    """A feature of a format, what happens to it, and how."""

    formats: str
    feature: str
    treatment: str
    how: str


TABLE = (
    Row("all texts", "UTF-16, UTF-32, byte order marks", READ, "by the mark, or by the zeros of UTF-16"),
    Row(
        "OBJ, PLY, OFF",
        "faces with more than three corners",
        READ,
        "cut into triangles, inside concave outlines",
    ),
    Row("OBJ", "negative indices, continued lines", READ, "as the format defines them"),
    Row("OBJ", "points and lines (`p`, `l`)", LEFT_OUT, "they enclose nothing"),
    Row("OBJ", "free-form surfaces (`surf`) beside faces", WARNED, "faces alone are read"),
    Row("OBJ", "free-form surfaces alone", REFUSED, "export polygons"),
    Row("OBJ", "other files (`call`)", REFUSED, "export one file"),
    Row("PLY", "triangle strips (`tristrips`)", READ, "-1 ends a strip"),
    Row("PLY", "edges and other elements", LEFT_OUT, "they enclose nothing"),
    Row("PLY", "range grids (`range_grid`)", REFUSED, "reconstruct a surface from the scan"),
    Row("STL", "several solids in one file", READ, "as one mesh"),
    Row(
        "OFF", "normals, colours, texture coordinates", READ, "the first three coordinates of a vertex count"
    ),
    Row("OFF", "binary form; points of four or n coordinates", REFUSED, "export text with three coordinates"),
    Row("GLB, glTF", "triangle lists, strips and fans", READ, "with restarts (`KHR_mesh_primitive_restart`)"),
    Row("GLB, glTF", "points and lines", LEFT_OUT, "they enclose nothing"),
    Row("GLB, glTF", "sparse accessors, `KHR_mesh_quantization`", READ, ""),
    Row("GLB, glTF", "skins", READ, "joints at rest place the mesh; its node's transform does not count"),
    Row("GLB, glTF", "morph targets", READ, "with the default weights of the node or the mesh"),
    Row("GLB, glTF", "animations", LEFT_OUT, "the scene is at rest"),
    Row("GLB, glTF", "instances (`EXT_mesh_gpu_instancing`)", READ, "each is a part"),
    Row("GLB, glTF", "levels of detail (`MSFT_lod`)", READ, "the finest"),
    Row("GLB, glTF", "hidden nodes (`KHR_node_visibility`)", LEFT_OUT, "with all below them"),
    Row("GLB, glTF", "several scenes", WARNED, "the file's own choice is read, else the first"),
    Row("GLB, glTF", "optional compression with plain data beside it", READ, "the plain data"),
    Row("GLB, glTF", "Draco and meshopt compression", REFUSED, "export without mesh compression"),
    Row("GLB, glTF", "unknown extensions that the file requires", WARNED, "the rest is read"),
    Row("GLB, glTF", "version 1.0", REFUSED, "export glTF 2.0"),
    Row("3MF", "build items, components, transforms, units", READ, ""),
    Row("3MF", "models in parts of their own (production extension)", READ, ""),
    Row("3MF", "objects of type `model` and `surface`", READ, ""),
    Row(
        "3MF", "objects of type `support`, `solidsupport`, `other`", LEFT_OUT, "they are no part of the model"
    ),
    Row("3MF", 'items that are not printed (`printable="0"`)', LEFT_OUT, ""),
    Row("3MF", "negative volumes of slicers", READ, "subtracted from the parts of their object"),
    Row("3MF", "modifiers, support blockers and enforcers of slicers", LEFT_OUT, "they are no material"),
    Row("3MF", "beam lattices", REFUSED, "export triangles"),
    Row("3MF", "Boolean shapes, displaced surfaces, level sets, slices", REFUSED, "export triangles"),
    Row("3MF", "encrypted models (secure content)", REFUSED, "export without encryption"),
    Row("3MF", "unknown extensions that the file requires", WARNED, "the rest is read"),
)
