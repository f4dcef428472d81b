"""``vibraverse strike``: numbers a person can check, and every mistake in one sentence."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pytest
import soundfile
import trimesh

from mesh_bytes import gltf
from scripts import run_script
from vibraverse.commands.one_mesh import progress
from vibraverse.contract.progress import report
from vibraverse.physics.materials import MATERIALS

#: ω L / c_s of the free cube for ν = 0.3.
CUBE = np.repeat([2.8561, 3.8460, 3.9113, 4.4429], [2, 3, 3, 3])


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """A cube of ten by ten by ten, in a format without units."""
    path = tmp_path_factory.mktemp("cube") / "my cube.stl"
    trimesh.creation.box((10, 10, 10)).export(path)
    return path


def test_a_cube_rings_as_a_cube(cube, tmp_path, vibraverse):
    young, density, poisson, size = 2.0e9, 1100.0, 0.3, 0.25
    status, out, err = vibraverse(
        "strike", cube, "--size", size, "--young", young, "--density", density, "--poisson", poisson,
        "--alpha", 20, "--beta", 1e-7, "--elements", 2000, "--modes", 20,
        "-o", tmp_path / "cube.wav", "--json", tmp_path / "cube.json",
    )  # fmt: skip
    assert status == 0, err
    assert "longest side 0.25 m" in out
    facts = json.loads((tmp_path / "cube.json").read_text())
    shear_speed = np.sqrt(young / (2 * (1 + poisson)) / density)
    found = 2 * np.pi * np.array(facts["frequencies_hz"]) * size / shear_speed
    assert found[: len(CUBE)] == pytest.approx(CUBE, rel=0.005)
    assert facts["volume_m3"] == pytest.approx(size**3, rel=1e-6)
    assert facts["mass_kg"] == pytest.approx(density * size**3, rel=1e-6)
    omega = 2 * np.pi * np.array(facts["frequencies_hz"])
    assert facts["damping_per_s"] == pytest.approx(0.5 * (20 + 1e-7 * omega**2))
    assert facts["size_m"] == size
    assert facts["material"] == "ceramic"
    assert facts["material_parameters"]["young_pa"] == young
    assert facts["vertices"] > 100
    assert facts["tetrahedra"] > 1000
    assert isinstance(facts["warnings"], list)
    # Listen by numbers: the loudest line of the spectrum is a mode.
    samples, rate = soundfile.read(tmp_path / "cube.wav")
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 4 * len(samples)))
    loudest = np.fft.rfftfreq(4 * len(samples), 1 / rate)[np.argmax(spectrum)]
    assert abs(np.array(facts["frequencies_hz"]) - loudest).min() < 2 * rate / len(samples)


def test_struck_points_sound_different(cube, tmp_path, vibraverse):
    """A corner moves in other modes than the centre of a face."""
    sounds = []
    for at, nearest in (("-5,-5,-5", [-5, -5, -5]), ("0,0,5.5", [0, 0, 5])):
        status, out, err = vibraverse(
            "strike", cube, "--elements", 300, "--modes", 12, "--order", 1, "--material", "plastic",
            "--size", 0.3, "--at", at, "-o", tmp_path / "a.wav", "--json", tmp_path / "a.json",
        )  # fmt: skip
        assert status == 0, err
        assert "struck at (" in out
        facts = json.loads((tmp_path / "a.json").read_text())
        assert facts["struck_at"] == pytest.approx(nearest, abs=1e-6)
        sounds.append(soundfile.read(tmp_path / "a.wav")[0][:2000])
    assert np.abs(sounds[0] - sounds[1]).max() > 0.1


def test_a_soft_contact_sounds_duller(cube, tmp_path, vibraverse):
    """The same strike: a contact takes power from the higher modes, derivatives give them more."""
    shares = []
    for contact_s, observable in ((0, "acceleration"), (0.0015, "acceleration"), (0.0015, "displacement")):
        status, _, err = vibraverse(
            "strike", cube, "--elements", 300, "--modes", 30, "--order", 1, "--material", "plastic", "--size", 1,
            "--at", "5,3,1", "--contact-s", contact_s, "--observable", observable,
            "-o", tmp_path / "a.wav", "--json", tmp_path / "a.json",
        )  # fmt: skip
        assert status == 0, err
        facts = json.loads((tmp_path / "a.json").read_text())
        assert (facts["contact_s"], facts["observable"]) == (contact_s, observable)
        samples, rate = soundfile.read(tmp_path / "a.wav")
        power = np.abs(np.fft.rfft(samples[1000:5000] * np.hanning(4000))) ** 2
        high = np.fft.rfftfreq(4000, 1 / rate) > 1.45 * facts["frequencies_hz"][0]
        shares.append(power[high].sum() / power.sum())
    assert shares[1] < 0.9 * shares[0]
    assert shares[2] < 0.9 * shares[1]


def test_a_page_of_one_file_opens_as_the_command_asked(cube, tmp_path, vibraverse, monkeypatch):
    """It holds the body in every material; its struck sound is the WAV file's, within 1e-3 of the peak."""
    shown = []
    monkeypatch.setenv("BROWSER", "anything")
    monkeypatch.setattr("webbrowser.open", lambda address: shown.append(address) or True)
    monkeypatch.chdir(tmp_path)
    status, out, err = vibraverse(
        "strike", cube, "--size", 0.3, "--material", "wood", "--elements", 300, "--order", 1, "--modes", 12,
        "--at", "5,1,2", "-o", "cube.wav", "--open", "--json", "cube.json",
    )  # fmt: skip
    assert status == 0, err
    page = tmp_path / "my cube-wood.html"
    assert shown == [page.as_uri()]
    assert f"wrote {page.name}\n" in out
    facts = json.loads((tmp_path / "cube.json").read_text())
    lines = re.findall(r"^mode +(\d+): +([\d.]+) Hz ± ([\d.e-]+) %$", out, re.MULTILINE)
    assert [int(mode) for mode, _, _ in lines] == list(range(1, 11))
    for (_, hz, error), true, wrong in zip(
        lines, facts["frequencies_hz"], facts["discretisation_error"], strict=False
    ):
        assert float(hz) == pytest.approx(true, abs=0.06)
        assert float(error) == pytest.approx(100 * wrong, rel=0.06)
    text = page.read_text(encoding="utf-8")
    assert '"#/object?material=wood\\u0026point=0"' in text or '"#/object?material=wood&point=0"' in text
    assert not re.search(r"""(src|href)=["']?(https?:|//)""", text)
    data = json.loads(
        re.search(r'^<script>vibraverse\.object\("my-cube", (\{.*\})\);$', text, re.MULTILINE)[1]
    )
    assert set(data["materials"]) == set(MATERIALS)
    assert data["mesh"]["file"] == "my cube.stl"
    given = {"data": data, "address": "material=wood&point=0"}
    body = """
      const choices = {place: null, ...share.read(new URLSearchParams(given.address), given.data)};
      const command = share.command(choices, given.data, "cube");
      return [struck.sound(given.data, struck.modes(given.data, null, choices), choices).samples, command];
    """
    samples, command = run_script(body, given, "synth.js", "struck.js", "share.js")
    stored, _ = soundfile.read(tmp_path / "cube.wav")
    samples = np.array(samples) * np.abs(stored).max() / np.abs(samples).max()
    assert np.abs(samples - stored).max() < 1e-3 * np.abs(stored).max()
    assert command.startswith(
        "vibraverse strike 'my cube.stl' --material wood --size 0.3 --modes 12 --order 1"
    )
    at = [float(one) for one in re.search(r"--at=(\S+)", command)[1].split(",")]
    assert at == pytest.approx(facts["struck_at"], abs=1e-4)


def test_without_a_screen_the_page_is_named(cube, tmp_path, vibraverse, monkeypatch):
    for variable in ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr("webbrowser.open", lambda _: pytest.fail("opened"))
    sizes = ("--elements", 300, "--order", 1, "--modes", 8, "-o", tmp_path / "x.wav")
    status, out, err = vibraverse(
        "strike", cube, *sizes, "--hollow", 0.5, "--page", tmp_path / "x.html", "--open"
    )
    assert status == 0, err
    assert f"wrote {tmp_path / 'x.html'}: open it in a browser" in out
    assert '"hollow":{"volume_m3"' in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_json_to_the_terminal_and_default_name(cube, tmp_path, vibraverse, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = vibraverse(
        "strike", cube, "--elements", 300, "--modes", 8, "--order", 1, "--json", "-"
    )
    assert status == 0, err
    facts = json.loads(out)
    assert facts["size_m"] == 0.15
    assert any("states no unit" in warning for warning in facts["warnings"])
    assert (tmp_path / "my cube-ceramic.wav").is_file()


def test_a_warning_has_a_number_a_threshold_and_the_option_that_helps(tmp_path, vibraverse):
    sheet = trimesh.creation.box((10, 10, 0.2))
    sheet.update_faces(np.arange(len(sheet.faces)) != sheet.face_normals[:, 2].argmax())  # a hole
    sheet.export(tmp_path / "sheet.stl")
    status, out, err = vibraverse(
        "strike", tmp_path / "sheet.stl", "--elements", 300, "--modes", 8, "--order", 1,
        "-o", tmp_path / "sheet.wav",
    )  # fmt: skip
    assert status == 0, err
    lines = out.splitlines()
    (said,) = (line for line in lines if line.startswith("warning: modes: "))
    assert re.search(
        r"elements reaches [\d.]+ % in mode \d+ \(at most 2 %; above in \d of 8 modes\)\. Raise --elements",
        said,
    )
    assert not any(line.startswith("warning: tets: ") for line in lines)
    assert sum(line.startswith("repaired: ") for line in lines) == 1
    (made_up,) = (line for line in lines if line.startswith("warning: clean: "))
    assert re.search(r"clean: [\d.]+ % of the surface is made up \(at most 2 %\): closed the holes", made_up)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--material", "ceramc"], "unknown material 'ceramc'; did you mean 'ceramic'?"),
        (["--poisson", "0.5"], "--poisson must be less than 0.5, not 0.5"),
        (["--poisson", "-1"], "--poisson must be greater than -1, not -1.0"),
        (["--density", "-3"], "--density must be greater than 0, not -3.0"),
        (["--young", "0"], "--young must be greater than 0, not 0.0"),
        (["--alpha", "-1"], "--alpha must be at least 0, not -1.0"),
        (["--size", "0"], "--size must be greater than 0, not 0.0"),
        (["--size", "nan"], "--size"),
        (["--hollow", "1.5"], "--hollow must lie between 0 and 1, not 1.5"),
        (["--modes", "0"], "--modes must be greater than 0, not 0"),
        (["--order", "3"], "--order must be 1 or 2, not 3"),
        (["--contact-s", "0.2"], "--contact-s must be at most 0.1, not 0.2"),
        (["--contact-s", "-1"], "--contact-s must be at least 0, not -1.0"),
        (["--at", "1,2"], "--at takes three numbers"),
        (["--at", "nan,0,0"], "--at takes three numbers such as 0.1,0,0.25, not 'nan,0,0'"),
        (["--at", "0,-inf,0"], "--at takes three numbers"),
        (
            ["--at", "0,0,50"],
            "--at 0,0,50 is not on the mesh, which is 10 long around 0,0,0; give a point in the coordinates of its",
        ),
        (["-o", "."], ". is a folder; name a file in it"),
        (["--json", ".."], ".. is a folder; name a file in it"),
        (["-o", "no/such/folder/a.wav"], "the folder of no/such/folder/a.wav does not exist"),
    ],
)
def test_a_mistake_is_one_sentence(cube, tmp_path, vibraverse, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    status, out, err = vibraverse("strike", cube, *arguments)
    assert status == 2
    assert out == ""
    assert sentence in err
    assert len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("nothing.obj", b"", "empty"),
        ("text.glb", b"this is no glb", "unreadable"),
        ("cut.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 3\n", "unreadable"),
        ("nan.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not_finite"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n", "not_a_solid"),
    ],
)
def test_a_bad_mesh_is_one_sentence(tmp_path, vibraverse, monkeypatch, name, content, reason):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_bytes(content)
    status, _, err = vibraverse("strike", name)
    assert status == 2
    assert err.startswith("vibraverse: ")
    assert name in err
    assert f"[{reason}]" in err
    assert len(err.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_missing_file_and_wrong_kind(tmp_path, vibraverse):
    assert "does not exist" in vibraverse("strike", tmp_path / "no.obj")[2]
    (tmp_path / "a.txt").write_text("x")
    assert "is not a mesh file" in vibraverse("strike", tmp_path / "a.txt")[2]


def test_every_material_of_the_table_is_offered(vibraverse):
    _, out, _ = vibraverse("strike", "--help")
    assert all(name in out for name in MATERIALS)


def centimetres_as_metres(side: float) -> bytes:
    """Return a glTF of a tetrahedron whose legs are so many metres long."""
    document = gltf()
    for node in document["nodes"]:
        node["scale"] = [side] * 3
    return json.dumps({**document, "scenes": [{"nodes": [1]}]}).encode()


def test_a_body_of_centimetres_in_a_metre_format_is_noted(tmp_path, vibraverse):
    (tmp_path / "a.gltf").write_bytes(centimetres_as_metres(300))
    options = ("--material", "plastic", "--elements", 300, "--modes", 6, "-o", tmp_path / "a.wav")
    status, out, errors = vibraverse("strike", tmp_path / "a.gltf", *options)
    assert status == 0, errors
    assert "longest side 300 m" in out
    assert "warning: size: the longest side is 300 m in the file's own unit (from 0.001 to 50 m is" in out
    assert "modes are below 20 Hz and cannot be heard; a smaller --size raises them" in out
    status, out, _ = vibraverse("strike", tmp_path / "a.gltf", *options, "--size", 3)
    assert status == 0
    assert "warning: size" not in out
    assert "cannot be heard" not in out


def test_the_case_of_a_bug_report_is_noted(shared_cases, tmp_path, vibraverse):
    mesh = shared_cases / "glb-centimetres-as-metres" / "bar-300.gltf"
    options = ("--elements", 300, "-o", tmp_path / "a.wav")
    status, out, errors = vibraverse("strike", mesh, *options)
    assert status == 0, errors
    assert "the longest side is 300 m in the file's own unit" in out
    assert "modes are below 20 Hz and cannot be heard" in out


@pytest.mark.parametrize("stage", ["clean", "grids"])
def test_memory_is_limited_in_every_stage(cube, tmp_path, vibraverse, monkeypatch, stage):
    """One stage works in a child process with limits of its own, the other in this one."""
    if stage == "grids":
        monkeypatch.setattr("vibraverse.stages.grids.run", lambda job: np.ones(10**9))
    status, _, err = vibraverse(
        *(
            "strike",
            cube,
            "--hollow",
            0.5,
            "--memory-mb",
            10 if stage == "clean" else 900,
            "-o",
            tmp_path / "a.wav",
        )
    )
    assert status == 2
    assert "needed more than" in err
    assert re.search(r"[Rr]aise --memory-mb, or (simplify the mesh|lower --elements)", err)
    assert not list(tmp_path.iterdir())


def test_memory_is_a_positive_number(cube, vibraverse):
    status, _, err = vibraverse("strike", cube, "--memory-mb", 0)
    assert (status, "--memory-mb must be at least 1, not 0" in err) == (2, True)


def test_a_terminal_shows_what_a_stage_reports(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress("tets"):
        report("fTetWild within an envelope of 10 % of the thickness")
    shown = terminal.getvalue().split("\r\033[K")
    assert shown == ["", "tets …", "tets: fTetWild within an envelope of 10 % of the thickness …", ""]
