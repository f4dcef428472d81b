"""The registry of mesh formats: one module adds a format everywhere; messages say what is wrong in a file."""

from __future__ import annotations

import base64
import json
import re
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from mesh_bytes import SAMPLES, gltf, gltf_binary, threemf, threemf_text
from vibraverse.commands.strike import parser
from vibraverse.contract.errors import Refused
from vibraverse.files import formats
from vibraverse.files.meshes import read_mesh
from vibraverse.files.opening import as_one_file
from vibraverse.files.reading.document import parse
from vibraverse.sources.search import NoMeshes, find

NEW = """
from vibraverse.files.formats import Format, MeshData

def read(file, bounds):
    import numpy as np
    numbers = np.array(file.read().split(), float).reshape(-1, 3)
    return MeshData(numbers, np.arange(len(numbers)).reshape(-1, 3), 0.001)

FORMAT = Format("ZZ-TOY", (".zz-toy", ".zz-toys"), read, lambda file: 0.001)
"""


@pytest.fixture
def another(tmp_path, monkeypatch):
    """A format that no file has; its module lies in another folder."""
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "zz_toy.py").write_text(NEW)
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path / "modules")])
    for cached in (formats.known, formats._by_extension):
        cached.cache_clear()
    yield
    for cached in (formats.known, formats._by_extension):
        cached.cache_clear()
    del sys.modules["vibraverse.files.formats.zz_toy"], formats.zz_toy


def test_one_module_makes_a_format_known_everywhere(another, tmp_path):
    path = tmp_path / "meshes" / "cup.ZZ-TOYS"
    path.parent.mkdir()
    path.write_text("0 0 0 1 0 0 0 1 0")
    assert list(find(str(path.parent))) == ["cup"]
    assert len(read_mesh(path).faces) == 1
    assert as_one_file(path, tmp_path / "copy") == ("zz-toy", 0.001)
    assert formats.names(" or ").endswith(" or ZZ-TOY")
    assert formats.names(" or ") in parser().format_help().replace("\n", " ")
    with pytest.raises(NoMeshes, match="ZZ-TOY"):
        find(str(tmp_path / "modules"))
    (tmp_path / "cup.step").write_text("?")
    with pytest.raises(Refused, match=f"one of {formats.names()}"):
        read_mesh(tmp_path / "cup.step")


def test_keys_and_extensions_are_unique_and_in_lower_case():
    extensions = [extension for format in formats.known().values() for extension in format.extensions]
    assert len(set(extensions)) == len(extensions)
    assert all(re.fullmatch(r"\.[a-z0-9-]+", extension) for extension in extensions)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_format_declares_whether_its_files_state_a_unit(tmp_path, name):
    format, data = SAMPLES[name]
    (tmp_path / f"a.{format}").write_bytes(data)
    mesh = read_mesh(tmp_path / f"a.{format}")
    assert (formats.known()[format].unit_m is not None) == (mesh.unit_m is not None)
    assert as_one_file(tmp_path / f"a.{format}", tmp_path / "copy")[1] == mesh.unit_m


@pytest.mark.parametrize("page", ["README.md", "config.yaml", "docs/own-meshes.md"])
def test_lists_of_the_formats_name_all_of_them(root, page):
    listed = re.search(
        r"\bOBJ, STL.*?(?=; |\. |\n *#|\n\n)", (root / page).read_text(encoding="utf-8"), re.DOTALL
    )
    assert listed, f"{page} has no list of mesh formats that begins with OBJ, STL"
    known = {format.name for format in formats.known().values()}
    named = set(re.findall(r"[\w-]+", listed[0]))
    missing, strange = known - named, {name for name in named - known if re.search("[A-Z]{2}", name)}
    assert not missing, f"{page} lists the mesh formats without {', '.join(sorted(missing))}: add it there"
    assert not strange, f"{page} lists {', '.join(sorted(strange))}, which no module in files/formats/ reads"


def test_listing_the_formats_loads_no_numerical_library():
    program = (
        "import sys; from vibraverse.files.formats import is_mesh, names; is_mesh('a.obj'); names();"
        "print([name for name in ('numpy', 'manifold3d', 'vibraverse.files.reading.polygons', "
        "'vibraverse.files.reading.scene', 'vibraverse.files.reading.rows') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def changed(**fields) -> bytes:
    return json.dumps(gltf(**fields)).encode()


def with_first(kind: str, **fields) -> bytes:
    document = gltf()
    document[kind][0].update(fields)
    return json.dumps(document).encode()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (changed(asset={"version": "1.0"}), "it is glTF version 1.0, and only version 2 is read"),
        (changed(buffers=3), "its buffers is 3 and not a list"),
        (changed(nodes=None), "it has no nodes[0]"),
        (changed(scene="first"), 'its scene is "first" and not a whole number from 0'),
        (changed(scene=True), "its scene is true and not a whole number from 0"),
        (with_first("accessors", count=-1), "its accessors[0].count is -1 and not a whole number from 0"),
        (with_first("accessors", count=12.0), "its accessors[0].count is 12.0 and not a whole number from 0"),
        (with_first("accessors", count=10**30), "an accessor reaches beyond its buffer"),
        (with_first("accessors", componentType=5124), "its accessors[0].componentType is 5124, which glTF"),
        (
            with_first("accessors", normalized="yes"),
            'its accessors[0].normalized is "yes" and not true or false',
        ),
        (with_first("bufferViews", byteStride=2**63), "an accessor reaches beyond its buffer"),
        (with_first("bufferViews", buffer=7), "it has no buffers[7]"),
        (with_first("buffers", uri="x" * 300), "is missing"),
        (with_first("buffers", uri="a\0b"), "is missing"),
        (with_first("buffers", uri=[1]), "its buffers[0].uri is a list and not a text"),
        (with_first("nodes", matrix=[1] * 15), "its nodes[0].matrix has 15 numbers and should have 16"),
        (with_first("nodes", translation=[0, "1", 0]), 'its nodes[0].translation[1] is "1" and not a number'),
        (with_first("nodes", scale=[1, 10**400, 1]), "and not a number that a double holds"),
        (with_first("nodes", children={"a": 1}), "its nodes[0].children is an object and not a list"),
        (with_first("meshes", primitives=[None]), "its meshes[0].primitives[0] is null and not an object"),
        (b'{"asset": ' + b"[" * 5000 + b"]" * 5000 + b"}", "nested too deeply"),
        (b"[1, 2]", "its JSON is a list and not an object"),
        (b"\xff\xfe\xff", "it is no text"),
    ],
)
def test_a_gltf_document_says_what_is_wrong_with_it(tmp_path, data, said):
    (tmp_path / "a.gltf").write_bytes(data)
    with pytest.raises(Refused) as refused:
        read_mesh(tmp_path / "a.gltf")
    assert said in refused.value.message
    assert refused.value.reason == "unreadable"
    assert str(tmp_path) not in str(refused.value)


def test_null_counts_as_missing(tmp_path):
    document = gltf()
    document["accessors"][0]["normalized"] = document["nodes"][0]["rotation"] = document["images"] = None
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert read_mesh(tmp_path / "a.gltf").parts == 2
    assert "images" not in parse(b'{"images": null}')


def test_buffers_that_swell_are_refused_before_they_are_read(tmp_path):
    with open(tmp_path / "part.bin", "wb") as file:
        file.truncate(700 << 20)
    buffer = {"byteLength": 1, "uri": "part.bin"}
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(buffers=[buffer] * 50)))
    with pytest.raises(Refused, match="refers to more than 1024 MB") as refused:
        as_one_file(tmp_path / "a.gltf", tmp_path / "copy")
    assert refused.value.reason == "too_large"
    assert not (tmp_path / "copy").exists()


def patched(flags: int, method: int) -> bytes:
    """Return a 3MF whose two headers state these flags and this method of compression."""
    data = bytearray(threemf())
    for mark, place in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        struct.pack_into("<HH", data, data.find(mark) + place, flags, method)
    return bytes(data)


def model(old: str, new: str) -> bytes:
    text = threemf_text()
    assert old in text
    return threemf(text=text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (patched(0, 99), "its package is damaged (That compression method is not supported)"),
        (patched(1, 8), "is encrypted"),
        (patched(0x40, 8), "strong encryption"),
        (model('x="1.0"', ""), "its model has a vertex with x=None y='0.0' z='0.0'"),
        (model('v1="0"', 'v1="0.5"'), "its model has a triangle with v1='0.5'"),
        (model('v1="0"', f'v1="{10**30}"'), "a corner that is no number of a vertex"),
        (model('transform="2 0', 'transform="0'), "a transform of 11 numbers instead of 12"),
        (model('transform="2 0', 'transform="two 0'), "its model has the transform 'two 0"),
        (model('version="1.0"', 'version="1.0" encoding="hex"'), "the unknown encoding 'hex'"),
        (model('version="1.0"', 'version="1.0" encoding="shift_jis"'), "multi-byte encodings"),
        (model("</resources>", ""), "its model is no valid XML"),
    ],
)
def test_a_3mf_package_says_what_is_wrong_with_it(tmp_path, data, said):
    (tmp_path / "a.3mf").write_bytes(data)
    with pytest.raises(Refused) as refused:
        read_mesh(tmp_path / "a.3mf")
    assert said in refused.value.message
    assert refused.value.reason == "unreadable"
    assert as_one_file(tmp_path / "a.3mf", tmp_path / "copy")[0] == "3mf"  # which looks for the unit alone


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_3mf_package_may_be_compressed_in_other_ways(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.3mf", "w", method) as archive:
        archive.writestr("3D/3dmodel.model", threemf_text())
    assert read_mesh(tmp_path / "a.3mf").unit_m == 0.0254


def test_a_mistake_in_a_reader_is_no_refusal(tmp_path, monkeypatch):
    uri = "data:;base64," + base64.b64encode(gltf_binary()).decode()
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(uri)))
    monkeypatch.setattr("vibraverse.files.reading.scene._has_triangles", lambda primitive: primitive.gone)
    with pytest.raises(AttributeError, match="gone"):
        read_mesh(tmp_path / "a.gltf")


def test_arrays_have_their_final_types(tmp_path):
    (tmp_path / "a.gltf").write_text(json.dumps(gltf()))
    mesh = read_mesh(tmp_path / "a.gltf")
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.int64)
