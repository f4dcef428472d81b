"""Randomly damaged files: the result is a mesh or a refusal, in little time and memory.

``VIBRAVERSE_FUZZ=MINUTES pytest tests/test_fuzz_files.py`` looks further, with other examples every time.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import resource
import signal
import struct
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mesh_bytes import SAMPLES, glb, gltf, gltf_binary, ply, stl, stl_text, threemf, threemf_text
from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.files import formats
from vibraverse.files.meshes import read_mesh
from vibraverse.files.reading.bounds import Bounds, TooLarge

MINUTES = float(os.environ.get("VIBRAVERSE_FUZZ", 0))
MAX_TRIANGLES = 2000
SECONDS = 5
MEMORY_KB = 400_000

FORMATS = sorted({format for format, _ in SAMPLES.values()})

#: Repeatable, and quick enough for every run.
QUICK = settings(
    max_examples=300, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)

NUMBERS = [
    b"nan", b"inf", b"-inf", b"1e400", b"-1", b"0", b"1e-400", b"-0", b"4294967295", b"2147483648", b"-2147483649",
    b"9223372036854775807", b"9223372036854775808", b"99999999999999999999999", b"1e308", b"-1e308", b"0x10", b"1_0",
    b"", b"3.5", b"#", b"1" * 5000,
]  # fmt: skip
WORDS = [
    struct.pack("<I", 0xFFFFFFFF), struct.pack("<I", 0x7FFFFFFF), struct.pack("<f", np.nan), struct.pack("<f", np.inf),
    struct.pack("<f", 3e38), struct.pack("<d", 1e308), struct.pack("<I", 10_000_000), b"\0\0\0\0", b"\x80\0\0\0",
    b"\r", b"\n", b"\\\n", b'"', b"\xff\xfe",
]  # fmt: skip
VALUES = [
    None, True, -1, 0, 1, 2, 3, 255, 65536, 2**31, 2**32, 2**63, 10**30, 1.5, -2.5, 1e308, float("nan"), float("inf"),
    "", "x", [], {}, [0], [[]], {"a": 1}, [1e200] * 16, [0, 0, 0, 0], 5120, 5121, 5122, 5126, "VEC3", "SCALAR",
    "data:,AAAA",
]  # fmt: skip


class TooSlow(BaseException):
    """Raised by the alarm; no reader catches it."""


@contextlib.contextmanager
def limited(seconds: int):
    """Raise :class:`TooSlow` after this many seconds of CPU time, which does not depend on the machine's load."""

    def stop(*_):
        raise TooSlow(f"reading took more than {seconds} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def read(path: Path, format: str, seconds: int = SECONDS):
    """Return the mesh and the refusal from reading a file, one of them None; no other result is allowed."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    mesh = said = None
    with limited(seconds):
        try:
            mesh = read_mesh(path, format, "a b.obj", MAX_TRIANGLES)
        except Refused as refused:
            said = refused
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert used < MEMORY_KB, f"{used} kB for {path.stat().st_size} bytes"
    return mesh, said


def check(data: bytes, format: str) -> None:
    """Read bytes as a format; the result must be a sound mesh or a refusal that names the file.

    Refusals come of errors about the file alone. A mistake of ours, or a library's error that no reader expects, is
    raised here and fails the test.
    """
    known = formats.known()[format]
    with (
        limited(SECONDS),
        np.errstate(all="ignore"),
        contextlib.suppress(ValueError, TooLarge, FileNotFoundError),
    ):
        packed = known.pack(data, Path("/nowhere")) if known.pack else data
        known.read(io.BytesIO(packed), Bounds(MAX_TRIANGLES))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Ünï cup"
        path.write_bytes(data)
        mesh, refused = read(path, format)
        if refused is not None:
            assert "a b.obj" in refused.message
            assert "\n" not in refused.message
            assert len(refused.message) < 400
            assert folder not in str(refused)
            return
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    assert np.isfinite(mesh.vertices).all()
    assert 0 < len(mesh.faces) <= MAX_TRIANGLES
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)


def damaged(data: bytes, random: random.Random) -> bytes:
    """Return bytes with one thing done to them."""
    at = random.randrange(len(data) + 1)
    size = random.choice([1, 2, 4, 8, 50, 1000])
    kind = random.randrange(8)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return (
            data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]
            if at < len(data)
            else data
        )
    if kind == 2:
        return data[:at] + random.randbytes(size) + data[at:]
    if kind == 3:
        return data[:at] + data[at : at + size] * random.choice([2, 3, 20]) + data[at + size :]
    if kind == 4:
        return data[:at] + data[at + size :]
    if kind == 5:
        word = random.choice(WORDS)
        return data[:at] + word + data[at + len(word) :]
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not found:
        return data
    number = random.choice(found)
    return data[: number.start()] + random.choice(NUMBERS) + data[number.end() :]


def damaged_json(document, random: random.Random):
    """Return a document with one value replaced, removed or doubled, anywhere in it."""
    places = []

    def walk(value):
        for key in value if isinstance(value, dict) else range(len(value)):
            places.append((value, key))
            if isinstance(value[key], (dict, list)):
                walk(value[key])

    document = json.loads(json.dumps(document))
    walk(document)
    for _ in range(random.choice([1, 1, 1, 2, 4])):
        holder, key = random.choice(places)
        if isinstance(holder, dict) and random.random() < 0.2:
            holder.pop(key, None)
        elif isinstance(holder, list) and random.random() < 0.2 and holder:
            holder.append(holder[-1])
        elif isinstance(holder, dict) or key < len(holder):
            holder[key] = random.choice(VALUES)
    return document


def some_file(chance: random.Random) -> tuple[bytes, str]:
    """Return the bytes and the format of a randomly damaged file."""
    format, data = chance.choice(list(SAMPLES.values()))
    kind = chance.randrange(10)
    if kind == 0:
        return chance.randbytes(chance.choice([1, 10, 100, 3000])), format
    if format in ("glb", "gltf") and kind < 7:
        document = damaged_json(gltf(uri=None if format == "glb" else "data"), chance)
        return (glb(document) if format == "glb" else json.dumps(document).encode()), format
    if format == "3mf" and kind < 8:
        text = threemf_text().encode()
        for _ in range(chance.choice([1, 1, 2, 5])):
            text = damaged(text, chance)
        return threemf(text=text), format
    for _ in range(chance.choice([1, 1, 1, 2, 5, 20])):
        data = damaged(data, chance)
    return data, format if chance.random() < 0.95 else chance.choice(list(SAMPLES.values()))[0]


@pytest.mark.parametrize("name", SAMPLES)
def test_the_samples_are_whole(tmp_path, name):
    format, data = SAMPLES[name]
    (tmp_path / "a").write_bytes(data)
    mesh = read_mesh(tmp_path / "a", format)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6
    expected = {"glb": 2 / 6, "gltf": 2 / 6, "3mf": 16 / 6, "stl": 1 / 6}.get(format, 1.0)
    assert volume == pytest.approx(expected, rel=1e-6), (
        f"the sample {name!r} of tests/mesh_bytes.py must be the unit cube (CUBE, QUADS), whose volume is 1"
    )


def test_every_format_has_a_sample():
    missing = set(formats.known()) - set(FORMATS)
    assert not missing, f"add a sample of {', '.join(sorted(missing))} to SAMPLES in tests/mesh_bytes.py"
    assert sorted(formats.known()) == FORMATS


@QUICK
@given(chance=st.randoms(use_true_random=False))
def test_damaged_files(chance):
    check(*some_file(chance))


@QUICK
@given(data=st.binary(max_size=300), format=st.sampled_from(FORMATS))
def test_random_bytes(data, format):
    check(data, format)


@pytest.mark.skipif(not MINUTES, reason="VIBRAVERSE_FUZZ is not set")
def test_damaged_files_for_long():
    until, seed = time.time() + 60 * MINUTES, time.time_ns()
    while time.time() < until:
        seed += 1
        try:
            check(*some_file(random.Random(seed)))
        except BaseException as error:
            raise AssertionError(f"check(*some_file(random.Random({seed})))") from error


def _zipped(text: bytes, times: int = 1) -> bytes:
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("3D/3dmodel.model", "w") as file,
    ):
        for _ in range(times):
            file.write(text)
    return buffer.getvalue()


def _nodes(nodes: list) -> bytes:
    return glb({**gltf(uri=None), "nodes": nodes, "scenes": [{"nodes": [0]}]})


def _laughs() -> bytes:
    """Objects of ten components each, which are objects of ten components each: 10²⁹ parts."""
    objects = "".join(
        f'<object id="{k}"><components>{f"""<component objectid="{k - 1}"/>""" * 10}</components></object>'
        for k in range(1, 30)
    )
    first = '<object id="0"><mesh><vertices/></mesh></object>'
    return _zipped(
        f'<model><resources>{first}{objects}</resources><build><item objectid="29"/></build></model>'.encode()
    )


_DOCUMENT = gltf(uri=None)
_VAST = {**_DOCUMENT["accessors"][1], "count": 10**12}
_MANY = [{"primitives": _DOCUMENT["meshes"][0]["primitives"] * 3000}]
_PLY = b"ply\nformat %b 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
_LIST = b"element face 1\nproperty list int int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("format", "data", "reason", "said"),
    [
        ("stl", stl(count=10_000_000), "unreadable", "states 10000000 triangles, which take 500000084 bytes"),
        ("stl", stl(count=3000) + bytes(150_000), "too_large", "has 3000 triangles; the limit is 2000"),
        ("stl", stl()[:-1], "unreadable", "cut off"),
        ("stl", stl_text()[:-10], "unreadable", "cut off"),
        ("stl", stl_text().replace(b"0.0 1.0", b"0.0 1,0", 1), "unreadable", "line 5"),
        ("ply", _PLY % (b"ascii", 10**12) + _LIST, "unreadable", "1000000000000 of vertex"),
        ("ply", _PLY % (b"ascii", 9000) + _LIST + b"1 " * 30_000, "too_large", "9000 vertices"),
        ("ply", _PLY % (b"ascii", 1) + _LIST + b"1 " * 100_000, "too_large", "more than 65000 numbers"),
        ("ply", _PLY % (b"binary_big_endian", 1) + _LIST + b"\x7f" * 100, "unreadable", "cut off"),
        ("ply", _PLY % (b"ascii", 1) + _LIST + b"0 0 0 1e30 0", "unreadable", "number 0"),
        ("ply", ply()[:-9], "unreadable", "cut off"),
        (
            "ply",
            ply().replace(b"element vertex 8", b"element vertex " + b"1" * 400),
            "unreadable",
            "it announces 111",
        ),
        (
            "ply",
            b"ply\nformat ascii 1.0\nelement vertex %s\nend_header\n" % (b"1" * 400),
            "too_large",
            "has 111",
        ),
        ("off", b"OFF\n1000000000 1 0\n", "unreadable", "too short"),
        ("off", b"OFF\n9000 1 0\n" + b"0 0 0\n" * 9000, "too_large", "9000 vertices"),
        ("off", b"OFF\n1 -1 0\n0 0 0\n", "unreadable", "-1 faces"),
        ("obj", b"v 0 0 0\n" * 9000, "too_large", "7001 vertices"),
        ("obj", b"v 0 0 0\nf" + b" 1" * 3000, "too_large", "2998 triangles"),
        ("obj", b"v 0 0 0\nf" + b" 1" * 10_000_000, "unreadable", "longer than 16 MB"),
        ("obj", b"v 0 0 0 \\\n" * 2_000_000, "unreadable", "longer than 16 MB"),
        ("obj", bytes(20_000_000), "unreadable", "longer than 16 MB"),
        ("glb", glb({**_DOCUMENT, "accessors": [_DOCUMENT["accessors"][0], _VAST]}), "unreadable", "cut off"),
        ("glb", glb({**_DOCUMENT, "meshes": _MANY}), "too_large", "triangles"),
        ("glb", glb(binary=gltf_binary()[:-1]), "unreadable", "cut off"),
        ("glb", _nodes([{"children": [0]}]), "unreadable", "circle"),
        (
            "glb",
            _nodes([{"children": [k + 1] * 20} for k in range(20)] + [{}]),
            "unreadable",
            "more than 100000 nodes",
        ),
        ("glb", glb({})[:12] + b"\0\0\1\0JSON" + b"[" * 65536, "unreadable", "nested too deeply"),
        ("3mf", _laughs(), "unreadable", "more than 100000 parts"),
        ("3mf", _zipped(b"<model>" + b"<a/>" * 200_000), "too_large", "elements"),
        ("3mf", _zipped(b" " * (1 << 20), 40), "unreadable", "without an element"),
        ("3mf", _zipped(b'<!DOCTYPE a [<!ENTITY a "a">]><model>&a;</model>'), "unreadable", "document type"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_files_that_lie_and_files_that_swell(tmp_path, format, data, reason, said):
    """Small files that announce, unpack into or refer to something vast: refused in time and memory."""
    (tmp_path / "a").write_bytes(data)
    _, refused = read(tmp_path / "a", format)
    assert said in refused.message
    assert refused.reason == reason
    assert len(refused.message) < 400


def test_ten_million_triangles_cost_no_memory(tmp_path):
    """The full length is there (as a hole in the file): the header alone is read."""
    with open(tmp_path / "a.stl", "wb") as file:
        file.write(stl(sides=[], count=10_000_000))
        file.truncate(84 + 50 * 10_000_000)
    started = time.perf_counter()
    _, refused = read(tmp_path / "a.stl", "stl")
    assert refused.reason == "too_large"
    assert time.perf_counter() - started < 0.5
    with open(tmp_path / "a.obj", "wb") as file:
        file.truncate((1 << 30) + 1)
    with pytest.raises(Refused, match="more than 1024 MB are not read"):
        read_mesh(tmp_path / "a.obj")


@settings(QUICK, max_examples=12)
@given(chance=st.randoms(use_true_random=False))
def test_damaged_files_through_the_stages(vibraverse, chance):
    """Sources and clean: exit 0, and every product is whole, or every one is the refusal."""
    data, format = some_file(chance)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / f"cup.{format}").write_bytes(data)
        mesh, source, surface, record = (folder / "out" / n for n in ("a.mesh", "a.json", "b.ply", "b.json"))
        status, _, _ = vibraverse(
            "sources", "--object", "cup", "--options", '{"origin": "files"}', f"--file={folder}/cup.{format}",
            "--mesh", mesh, "--record", source,
        )  # fmt: skip
        assert status == 0
        status, _, said = vibraverse(
            "clean", "--object", "cup", "--mesh", mesh, "--source-record", source,
            "--surface", surface, "--record", record,
        )  # fmt: skip
        assert status == 0, said
        assert {path.name for path in mesh.parent.iterdir()} == {"a.mesh", "a.json", "b.ply", "b.json"}
        refusals = [read_refusal(surface), read_refusal(record)]
        if refusals[0] is None:
            assert refusals[1] is None
            assert json.loads(record.read_text())["object"] == "cup"
            assert len(read_mesh(surface).faces) > 0
        else:
            assert refusals[0] == refusals[1]
            assert refusals[0].message
