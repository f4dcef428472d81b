"""What the page's scripts make of choices, in Node: modes, sounds, addresses, commands, files."""

from __future__ import annotations

import io
import json
import subprocess
import sys

import h5py
import numpy as np
import pytest
import soundfile

import page_files
from page_files import OBJECT, POINTS
from scripts import run_script
from vibraverse.contract.products import read_json
from vibraverse.files.basis import read_basis
from vibraverse.physics.impulse import contact
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.modes import solve_material
from vibraverse.report.packing import unpacked

SCRIPTS = (
    "words.js",
    "elements.js",
    "unpack.js",
    "synth.js",
    "points.js",
    "struck.js",
    "share.js",
    "wav.js",
    "spectrogram.js",
)
#: Opens the given data; `choices` makes choices from an address, with the place that it states.
OPEN = """
  const data = given.data;
  const body = given.body && (await unpack.body(given.body));
  const choices = (address) => {
    const found = {place: null, ...share.read(new URLSearchParams(address), data)};
    if (found.at && body) found.place = points.nearest(body, found.at);
    return found;
  };
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    paths = page_files.make(tmp_path_factory.mktemp("page") / "results")
    return paths, page_files.data(paths), {one: page_files.body(paths, one) for one in ("solid", "hollow")}


def run(body: str, made, solidity: str = "solid", **given):
    _, data, bodies = made
    return run_script(OPEN + body, {"data": data, "body": bodies[solidity], **given}, *SCRIPTS)


def wav(made, name: str, solidity: str = "solid") -> np.ndarray:
    """Return the physical samples of a sound of the run."""
    paths, _, _ = made
    samples, _ = soundfile.read(paths.at(paths.sound, object=OBJECT, solidity=solidity, material=name))
    record = read_json(paths.at(paths.audio_record, object=OBJECT, solidity=solidity))
    return samples / record["sounds"][name]["gain"]


SOUND = """
  return given.asked.map(choices).map((one) => struck.sound(data, struck.modes(data, body, one), one).samples);
"""


@pytest.mark.parametrize("solidity", ["solid", "hollow"])
def test_stored_sounds_are_those_of_the_files(made, solidity):
    """Everywhere alike and at stored points, within 1e-3 of the peak."""
    names = ["steel", "wood", "glass-p0", "steel-p1"]
    asked = ["material=steel", "material=wood", "material=glass&point=0", "material=steel&point=1"]
    found = run(SOUND, made, solidity, asked=[f"{one}&body={solidity}" for one in asked])
    for name, samples in zip(names, found, strict=True):
        stored = wav(made, name, solidity)
        assert len(samples) == len(stored)
        assert np.abs(samples - stored).max() < 1e-3 * np.abs(stored).max(), name


def decibels(samples) -> np.ndarray:
    """Return the levels of third-octave bands from 100 Hz on, in decibels, and of the whole."""
    power = np.abs(np.fft.rfft(samples)) ** 2
    hz = np.fft.rfftfreq(len(samples), 1 / 44_100)
    edges = 100 * 2 ** (np.arange(24) / 3)
    bands = [power[(hz >= low) & (hz < high)].sum() for low, high in zip(edges[:-1], edges[1:], strict=True)]
    return 10 * np.log10(np.array([*bands, power.sum()]) + 1e-300)


def test_free_strikes_are_those_of_the_command(made):
    """Strikes at the points of the run, computed from the page's data of the body, within 0.2 dB."""
    asked = [
        f"material={name}&at={','.join(map(str, point))}" for name in ("steel", "glass") for point in POINTS
    ]
    found = run(SOUND, made, asked=asked)
    names = [f"{name}-p{number}" for name in ("steel", "glass") for number in range(len(POINTS))]
    for name, samples in zip(names, found, strict=True):
        page, true = decibels(samples), decibels(wav(made, name))
        heard = true > true.max() - 40
        assert np.abs(page - true)[heard].max() < 0.2, name


def test_nearest_points_are_those_of_python(made):
    vertices = unpacked(made[2]["solid"]["positions"]).T
    faces = unpacked(made[2]["solid"]["faces"]).astype(int)
    asked = [[0.9, 0.2, 0.1], [2, 2, 2], [0, 0, -1], [0.9, 0.6, 0.1], [-0.9, -0.6, -0.35], [0.1, -0.9, 0.3]]
    found = run("return given.asked.map((one) => points.nearest(body, one));", made, asked=asked)
    for point, place in zip(asked, found, strict=True):
        true = contact(vertices, faces, point)
        np.testing.assert_allclose(place["position"], true.position, atol=1e-9)
        np.testing.assert_allclose(place["normal"], true.normal, atol=1e-9)


def test_a_ray_meets_the_near_side(made):
    asked = [[[5, 0.1, 0.05], [-1, 0, 0]], [[0.2, 0.1, 5], [0, 0, -1]], [[5, 2, 0], [-1, 0, 0]]]
    near, top, beside = run("return given.asked.map((one) => points.hit(body, ...one));", made, asked=asked)
    assert beside is None
    np.testing.assert_allclose(near["position"], [0.9, 0.1, 0.05], atol=1e-4)
    np.testing.assert_allclose(near["normal"], [1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(top["position"], [0.2, 0.1, 0.35], atol=1e-4)


def test_named_places_lie_all_around(made):
    found = {one["name"]: one for one in run("return points.named(body);", made)}
    assert len(found) == 14
    np.testing.assert_allclose(found["top"]["position"], [0, 0, 0.35], atol=1e-4)
    assert np.all(np.sign(found["back left bottom"]["position"]) == -1)


@pytest.mark.parametrize(
    ("change", "factor"), [("E=8e11", 2.0), ("rho=31400", 0.5), ("size=0.4", 0.5), ("E=8e11&size=0.4", 1.0)]
)
@pytest.mark.parametrize("poisson", ["", "&nu=0.33"])
def test_scalings_are_exact(made, change, factor, poisson):
    body = "return given.asked.map((one) => struck.modes(data, body, choices(one)).hz);"
    asked = [f"material=steel{poisson}", f"material=steel{poisson}&{change}"]
    before, after = run(body, made, asked=asked)
    np.testing.assert_allclose(np.array(after) / before, factor, rtol=1e-12)


def test_a_stop_of_poissons_ratio_is_solved(made):
    paths, _, _ = made
    body = "return struck.modes(data, body, choices('material=steel&nu=0.33&E=1e11')).hz;"
    found = run(body, made)
    with h5py.File(paths.at(paths.basis, object=OBJECT, solidity="solid")) as h5:
        basis = read_basis(h5)
    material = {**MATERIALS["steel"], "poisson": 0.33, "young_pa": 1e11}
    true = solve_material(basis, material, page_files.SIZE_M / 1.8, page_files.MODES)
    np.testing.assert_allclose(found, true.frequencies_hz, rtol=1e-9)


def test_an_address_comes_back(made):
    address = (
        "body=hollow&material=glass&E=1e10&beta=0&size=0.05&contact=0.002&observable=velocity"
        "&at=0.1,-0.6,0.2&mode=3&slower=10"
    )
    back = run("return String(share.write(choices(given.asked), data));", made, asked=address)
    assert sorted(back.replace("%2C", ",").replace("10000000000", "1e10").split("&")) == sorted(
        address.split("&")
    )


@pytest.mark.parametrize(
    "address",
    [
        "body=gas&material=gold",
        "E=-1&rho=x&nu=&size=0",
        "at=1,2",
        "point=99&mode=0",
        "mode=999",
        "contact=-1&observable=smell",
    ],
)
def test_what_an_address_states_wrongly_is_left_out(made, address):
    assert (
        run("return String(share.write(choices(given.asked), data));", made, asked=address)
        == "material=glass"
    )


def test_the_command_is_one_of_vibraverse(made):
    """The command's own parser takes it."""
    import shlex

    from vibraverse.commands.strike import parser

    address = "body=hollow&material=glass&E=1e10&at=-0.9,0.1,0.2&contact=0.002&observable=velocity"
    text = run("return share.command(choices(given.asked), data, 'box');", made, asked=address)
    words = shlex.split(text)
    assert words[:3] == ["vibraverse", "strike", f"objects/{OBJECT}/surface.ply"]
    parsed = parser().parse_args(words[2:])
    assert (parsed.material, parsed.young, parsed.hollow, parsed.size) == (
        "glass",
        1e10,
        0.5,
        page_files.SIZE_M,
    )
    assert [float(one) for one in parsed.at.split(",")] == [-0.9, 0.1, 0.2]
    assert (parsed.contact_s, parsed.observable, parsed.modes) == (0.002, "velocity", page_files.MODES)


def test_the_python_renders_the_same(made):
    asked = "material=wood&at=0.9,0.2,0.1&contact=0.001"
    body = """
      const found = struck.modes(data, body, choices(given.asked));
      return [share.python(choices(given.asked), data, found), struck.sound(data, found, choices(given.asked)).samples];
    """
    program, samples = run(body, made, asked=asked)
    program = program.rpartition("print")[0] + "import json; print(json.dumps(sound.samples.tolist()))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    true = np.array(json.loads(done.stdout))
    assert np.abs(true - samples).max() < 1e-4 * np.abs(true).max()


def test_a_sound_file_says_what_it_is(made, tmp_path):
    body = """
      const chosen = choices('material=glass&at=0.9,0.2,0.1');
      const sound = struck.sound(data, struck.modes(data, body, chosen), chosen);
      const samples = sound.samples.map((one) => one / (2 * sound.peak));
      return [wav.bytes(samples, sound.rate, share.info(chosen, data, ['gain 3 dB'])), samples];
    """
    content, samples = run(body, made)
    found, rate = soundfile.read(io.BytesIO(bytes(content)))
    assert rate == 44_100
    assert np.abs(found - samples).max() < 2e-7
    with soundfile.SoundFile(io.BytesIO(bytes(content))) as file:
        said = file.copy_metadata()
    assert said["title"] == page_files.TITLE
    assert (said["copyright"], said["artist"]) == ("CC0-1.0", "A. Joiner")
    for part in ("solid glass", "E 62000000000 Pa", "struck at 0.9, 0.2, 0.1", "gain 3 dB"):
        assert part in said["comment"]


def test_a_mode_alone_is_one_frequency(made):
    body = """
      const chosen = choices('material=steel&mode=2');
      const found = struck.modes(data, body, chosen);
      return [struck.sound(data, found, {...chosen, isolated: chosen.mode}).samples, found.hz[1]];
    """
    samples, hz = run(body, made)
    spectrum = np.abs(np.fft.rfft(samples))
    assert np.argmax(spectrum) * 44_100 / len(samples) == pytest.approx(hz, abs=44_100 / len(samples))


def test_the_shape_that_is_shown_is_the_modes_own(made):
    paths, _, _ = made
    found = np.array(run("return struck.shape(body, 0.29, 0);", made)).reshape(3, -1).T
    with h5py.File(paths.at(paths.basis, object=OBJECT, solidity="solid")) as h5:
        basis = read_basis(h5)
    solved = solve_material(basis, MATERIALS["steel"], page_files.SIZE_M / 1.8, page_files.MODES)
    from vibraverse.physics.shapes import mode_shapes

    true = mode_shapes(basis.surface, basis.correction_surface, solved.coefficients)[0]
    places = unpacked(made[2]["solid"]["positions"]).T
    nearest = np.linalg.norm(basis.vertices[None] - places[:, None], axis=2).argmin(axis=1)
    alike = (true[nearest] * found).sum() / np.linalg.norm(true[nearest]) / np.linalg.norm(found)
    assert abs(alike) > 0.9999


def test_the_transform_is_fouriers(made):
    samples = np.random.default_rng(1).normal(size=1024)
    body = """
      const [re, im] = [Float64Array.from(given.samples), new Float64Array(1024)];
      spectrogram.transform(re, im);
      return [re, im];
    """
    re, im = run(body, made, samples=samples.tolist())
    np.testing.assert_allclose(np.array(re) + 1j * np.array(im), np.fft.fft(samples), atol=1e-9)


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (3.64, [1, 2, 3]),
        (4, [1, 2, 3, 4]),
        (1, [0.2, 0.4, 0.6, 0.8, 1]),
        (0.16, [0.05, 0.1, 0.15]),
        (11, [5, 10]),
    ],
)
def test_times_on_the_axis_are_round(seconds, expected):
    found = run_script("return spectrogram.ticks(given);", seconds, "elements.js", "spectrogram.js")
    assert found == pytest.approx(expected)


def test_modes_are_a_table(made):
    body = """
      const chosen = choices('');
      const found = struck.modes(data, body, chosen);
      return share.csv(found, struck.levels(data, found, chosen));
    """
    rows = run(body, made).strip().split("\n")
    assert rows[0] == "mode,frequency_hz,relative_error,damping_per_s,level_db"
    assert len(rows) == 1 + page_files.MODES
    assert float(rows[1].split(",")[1]) == pytest.approx(
        made[1]["bodies"]["solid"]["modes"]["glass"]["hz"][0], rel=1e-8
    )


def test_a_stored_point_is_struck_with_the_shapes_of_another_ratio(made):
    """Its stored weights hold for the material's own ν alone."""
    body = """
      const {position} = data.bodies.solid.strikes.steel[1];
      const place = points.nearest(body, position);
      return ['0.29', '0.35'].map((nu) => {
        const one = {...choices(`material=steel&nu=${nu}&point=1`), place};
        return [one, {...one, stored: null}].map((each) => [...struck.modes(data, body, each).weights]);
      });
    """
    (own, free), (other, moved) = run(body, made)
    np.testing.assert_allclose(own, free, atol=3e-3 * np.abs(own).max())
    assert own != free
    assert other == moved
