"""Mesh files: every format to the same arrays, and every kind of damage to a refusal."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
import trimesh

from mesh_bytes import CORNERS, QUADS, SAMPLES, SIDES, glb, gltf_binary, ply, stl, threemf
from mesh_bytes import gltf as document
from vibraverse.contract.errors import Refused
from vibraverse.files.formats import known
from vibraverse.files.formats.gltf import pack
from vibraverse.files.meshes import read_mesh, read_ply, write_ply
from vibraverse.files.opening import as_one_file

CUBE_OBJ = """mtllib wood.mtl
o cube
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0
v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
vt 0 0
usemtl a
f 4/1 3/1 2/1 1/1
f 5//1 6//1 7//1 8//1
usemtl b
f 1 2 6 5
f -7 -6 -2 -3
g side
f 3 4 8 7
f 4 1 \\
5 8
"""


def volume(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def gltf(folder, uri="part.bin", **extra) -> str:
    """Write the buffer of a document into a folder; return the JSON."""
    (folder / "part.bin").write_bytes(gltf_binary())
    return json.dumps(document(uri, **extra))


@pytest.mark.parametrize("format", ["obj", "stl", "stl_ascii", "ply", "ply_ascii", "off", "glb"])
def test_every_format_gives_the_same_solid(tmp_path, format):
    mesh = trimesh.Trimesh(CORNERS, SIDES, process=False)
    name, _, _ = format.partition("_")
    options = {"encoding": "ascii"} if format == "ply_ascii" else {}
    data = mesh.export(file_type="stl_ascii" if format == "stl_ascii" else name, **options)
    path = tmp_path / f"cup.{name}"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    read = read_mesh(path)
    assert read.vertices.dtype == np.float64
    assert read.faces.shape == (4, 3)
    assert volume(read) == pytest.approx(1 / 6, abs=1e-6)
    assert read.unit_m == (1.0 if name == "glb" else None)
    if name != "stl":  # the only format without shared vertices
        assert read.vertices.shape == (4, 3)
    # a copy whose name says nothing is read by its stated format
    other = tmp_path / "source.mesh"
    other.write_bytes(path.read_bytes())
    assert np.array_equal(read_mesh(other, name).vertices, read.vertices)


def test_obj_groups_quads_and_relative_indices(tmp_path):
    path = tmp_path / "cube.obj"
    path.write_text(CUBE_OBJ)
    mesh = read_mesh(path)
    assert mesh.vertices.shape == (8, 3)  # materials and groups cut nothing apart
    assert mesh.faces.shape == (12, 3)
    assert volume(mesh) == pytest.approx(1.0)


@pytest.mark.parametrize("start", range(5))
def test_concave_polygons_are_cut_inside(tmp_path, start):
    outline = np.roll([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]], start, axis=0)
    path = tmp_path / "arrow.off"
    rows = "".join(f"{x} {y} 0 # corner\n" for x, y in outline)
    path.write_text(f"OFF5 1 0\n{rows}5 0 1 2 3 4 255 0 0\n")  # counts glued to the keyword, a face colour
    mesh = read_mesh(path)
    a, b, c = (mesh.vertices[mesh.faces[:, k], :2] for k in range(3))
    areas = np.cross(np.c_[b - a, np.zeros(3)], np.c_[c - a, np.zeros(3)])[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(10.0)


def test_concave_quadrilateral(tmp_path):
    path = tmp_path / "dart.obj"
    path.write_text("v 0 0 0\nv 2 1 0\nv 4 0 0\nv 2 4 0\nf 1 2 3 4\n")
    mesh = read_mesh(path)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_3mf_places_components_and_states_its_unit(tmp_path):
    path = tmp_path / "pair.3mf"
    path.write_bytes(threemf())
    mesh = read_mesh(path)
    assert mesh.unit_m == 0.0254
    assert mesh.parts == 2
    assert volume(mesh) == pytest.approx(2 * 8 / 6)  # the mirrored part keeps its outside outside
    assert mesh.vertices.min(axis=0) == pytest.approx([-2, 0, 0])
    assert mesh.vertices.max(axis=0) == pytest.approx([12, 2, 2])


@pytest.mark.parametrize("uri", ["part.bin", "data"])
def test_gltf_is_packed_into_one_glb(tmp_path, uri):
    path = tmp_path / "pair.gltf"
    path.write_text(gltf(tmp_path, uri))
    alone = tmp_path / "elsewhere" / "source.mesh"
    alone.parent.mkdir()
    assert as_one_file(path, alone) == ("glb", 1.0)
    mesh, direct = read_mesh(alone, "glb"), read_mesh(path)
    assert np.array_equal(mesh.vertices, direct.vertices)
    assert mesh.parts == 2
    assert volume(mesh) == pytest.approx(2 / 6, abs=1e-6)
    assert sorted(np.unique(mesh.vertices[:, 0])) == pytest.approx([-1, 0, 3, 4])
    assert pack(path.read_bytes(), tmp_path) == alone.read_bytes()


def test_gltf_without_its_buffer_is_refused(tmp_path):
    path = tmp_path / "pair.gltf"
    for uri, said in (("gone.bin", "gone.bin"), ("../part.bin", "does not lie beside it")):
        path.write_text(gltf(tmp_path, uri))
        for action in (lambda path: as_one_file(path, tmp_path / "copy"), read_mesh):
            with pytest.raises(Refused, match=said) as refused:
                action(path)
            assert refused.value.reason == "unreadable"


def test_ply_keeps_every_bit(tmp_path):
    random = np.random.default_rng(1)
    vertices = random.normal(size=(50, 3)) * 10.0 ** random.integers(-12, 12, size=(50, 1))
    faces = random.integers(0, 50, size=(80, 3))
    write_ply(tmp_path / "a.ply", vertices, faces)
    write_ply(tmp_path / "b.ply", vertices, faces.astype(np.int32))
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    read_vertices, read_faces = read_ply(tmp_path / "a.ply")
    assert np.array_equal(read_vertices, vertices)
    assert np.array_equal(read_faces, faces)


GLB_TEXT = b"this is a shopping list, not a mesh"
NAN_OBJ = b"v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 inf\nf 1 2 3\nf 1 2 4\n"
PLY_HEAD = b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\n"


@pytest.mark.parametrize(
    ("name", "data", "reason", "said"),
    [
        ("cup.glb", GLB_TEXT, "unreadable", "does not begin like a GLB"),
        ("cup.stl", b"", "empty", "0 bytes"),
        ("cup.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "empty", "3 points and no triangles"),
        ("cup.obj", b"# nothing\n", "empty", "no vertices"),
        ("cup.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "unreadable", "vertex 8"),
        ("cup.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n", "unreadable", "vertex -6"),
        ("cup.obj", b"v 0 0 0\nv 1 0\n", "unreadable", "line 2"),
        ("cup.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "unreadable", "line 4"),
        ("cup.obj", NAN_OBJ, "not_finite", "2 of 4 vertices"),
        ("cup.off", b"OFF\n3 1 0\n0 0 0\n", "unreadable", "announces 3 vertices"),
        ("cup.ply", PLY_HEAD + b"end_header\n", "unreadable", "PLY"),
        ("cup.ply", b"ply\nformat ascii 1.0\n", "unreadable", "PLY"),
        ("cup.stl", bytes(range(256)) * 9, "unreadable", "STL"),
        ("cup.3mf", b"PK\x03\x04 broken", "unreadable", "3MF"),
        ("cup.step", b"ISO-10303-21;", "unreadable", "Convert it"),
    ],
)
def test_damage_is_refused_with_what_and_advice(tmp_path, name, data, reason, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(Refused) as refused:
        read_mesh(tmp_path / name)
    assert refused.value.reason == reason
    assert said in str(refused.value)
    assert name in refused.value.message
    assert str(tmp_path) not in str(refused.value)
    assert refused.value.advice


def test_3mf_damage(tmp_path):
    path = tmp_path / "a.3mf"
    for data, said in (
        (threemf(unit="furlong"), "furlong"),
        (threemf(triangles='<triangle v1="0" v2="1" v3="7"/>'), "beyond its 4 vertices"),
        (threemf(part=2), "circle"),
    ):
        path.write_bytes(data)
        with pytest.raises(Refused, match=said):
            read_mesh(path)


def test_compressed_glb_is_named(tmp_path):
    text = gltf(tmp_path, extensionsRequired=["KHR_draco_mesh_compression"])
    (tmp_path / "a.glb").write_bytes(pack(text.encode(), tmp_path))
    with pytest.raises(Refused, match="KHR_draco_mesh_compression"):
        read_mesh(tmp_path / "a.glb")


def test_the_given_name_is_what_a_refusal_says(tmp_path):
    (tmp_path / "source.mesh").write_bytes(b"")
    with pytest.raises(Refused, match=r"Ünï cup\.obj is empty"):
        read_mesh(tmp_path / "source.mesh", "obj", "Ünï cup.obj")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0")
    (tmp_path / "a.obj").chmod(0)
    with pytest.raises(Refused, match="cannot be opened"):
        read_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize("mode", ["list", "strip", "fan"])
@pytest.mark.parametrize("indexed", [True, False])
def test_glb_lists_strips_and_fans(tmp_path, mode, indexed):
    """A square of two triangles in each of the three ways, its outside up."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
    order = {"list": [0, 1, 2, 0, 2, 3], "strip": [0, 1, 3, 2], "fan": [0, 1, 2, 3]}[mode]
    points = corners if indexed else corners[order]
    primitive = {"attributes": {"POSITION": 1}, "mode": {"list": 4, "strip": 5, "fan": 6}[mode]}
    file = document(
        None,
        nodes=[{"mesh": 0}],
        scenes=[{"nodes": [0]}],
        meshes=[{"primitives": [{**primitive, "indices": 0} if indexed else primitive]}],
        accessors=[
            {"bufferView": 0, "componentType": 5121, "count": len(order), "type": "SCALAR"},
            {"bufferView": 0, "byteOffset": 8, "componentType": 5126, "count": len(points), "type": "VEC3"},
        ],
        bufferViews=[{"buffer": 0, "byteLength": 8 + points.nbytes}],
    )
    (tmp_path / "a.glb").write_bytes(glb(file, bytes(order).ljust(8, b"\0") + points.tobytes()))
    mesh = read_mesh(tmp_path / "a.glb")
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] / 2).tolist() == [0.5, 0.5]


def test_glb_positions_that_are_quantised_strided_and_sparse(tmp_path):
    """Normalised shorts, eight bytes apart, one of which a sparse accessor moves; a rotated and scaled node."""
    shorts = np.zeros((4, 4), dtype="<i2")
    shorts[:, :3] = CORNERS * 32767
    moved = np.array([0, 0, 32767 // 2 + 1, 0], dtype="<i2")
    data = SIDES.astype("<u2").tobytes() + shorts.tobytes() + moved.tobytes() + bytes([3, 0, 0, 0])
    position = {"bufferView": 1, "componentType": 5122, "normalized": True, "count": 4, "type": "VEC3"}
    position["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 2, "byteOffset": 8, "componentType": 5121},
        "values": {"bufferView": 2},
    }
    file = document(
        None,
        nodes=[{"mesh": 0, "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 1, 1]}],
        scenes=[{"nodes": [0]}],
        accessors=[document()["accessors"][0], position],
        bufferViews=[
            {"buffer": 0, "byteLength": 24},
            {"buffer": 0, "byteOffset": 24, "byteLength": 32, "byteStride": 8},
            {"buffer": 0, "byteOffset": 56, "byteLength": 12},
        ],
    )
    (tmp_path / "a.glb").write_bytes(glb(file, data))
    mesh = read_mesh(tmp_path / "a.glb")
    # twice as long along x, then a quarter turn about z: x becomes y
    assert mesh.vertices == pytest.approx(np.array([[0, 0, 0], [0, 2, 0], [-1, 0, 0], [0, 0, 0.5]]), abs=1e-4)


def test_triangles_and_quads_in_one_ply(tmp_path):
    """Rows of different lengths, in every encoding, with properties around them that are not read."""
    polygons = [*QUADS[:5], [1, 3, 7], [1, 7, 5]]
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        (tmp_path / "a.ply").write_bytes(ply(form, polygons=polygons))
        mesh = read_mesh(tmp_path / "a.ply")
        assert len(mesh.faces) == 12
        assert volume(mesh) == pytest.approx(1.0)


@pytest.mark.parametrize("ending", [b"\r", b"\r\n"])
@pytest.mark.parametrize("name", [name for name, (_, data) in SAMPLES.items() if b"\0" not in data])
def test_lines_of_other_systems(tmp_path, name, ending):
    format, data = SAMPLES[name]
    (tmp_path / "a").write_bytes(data)
    (tmp_path / "b").write_bytes(data.replace(b"\n", ending))
    here, there = read_mesh(tmp_path / "a", format), read_mesh(tmp_path / "b", format)
    assert np.array_equal(here.vertices, there.vertices)
    assert np.array_equal(here.faces, there.faces)


def test_bytes_behind_a_binary_stl_do_no_harm(tmp_path):
    (tmp_path / "a.stl").write_bytes(stl(header=b"solid but binary", tail=b"signature"))
    assert volume(read_mesh(tmp_path / "a.stl")) == pytest.approx(1 / 6)


def test_public_models(shared_meshes):
    counts = {
        "clean/fandisk.obj": (6475, 12946),
        "dirty/quadknot.obj": (1440, 2880),
        "dirty/duck.glb": (2399, 4212),
    }
    counts |= {"dirty/chair.obj": (3186, 12756), "clean/screwdriver.off": (3395, 6786)}
    for name, (vertices, faces) in counts.items():
        mesh = read_mesh(shared_meshes / name)
        assert (len(mesh.vertices), len(mesh.faces)) == (vertices, faces), name
    pair = read_mesh(shared_meshes / "dirty" / "cube_and_sphere.3mf")
    assert (pair.unit_m, pair.parts, len(pair.faces)) == (0.001, 2, 5132)
    for name, reason in {"empty.obj": "empty", "empty.stl": "empty", "points_only.ply": "empty"}.items():
        with pytest.raises(Refused) as refused:
            read_mesh(shared_meshes / "invalid" / name)
        assert refused.value.reason == reason


def test_formats_all_have_a_reader(tmp_path):
    for extension in (extension for format in known().values() for extension in format.extensions):
        (tmp_path / f"a{extension}").write_bytes(b"?")
        with pytest.raises(Refused):
            read_mesh(tmp_path / f"a{extension}")
