"""``vibraverse listen``: from a recording to the material, and every bad recording in one sentence."""

from __future__ import annotations

import json
import os
import struct

import numpy as np
import pytest
import soundfile
import trimesh

from vibraverse.commands.listen import SEARCHED_S
from vibraverse.files.sounds import read_sound
from vibraverse.physics.materials import MATERIALS

RATE = 44_100
SIZE_M, MATERIAL = 0.35, "glass"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A wedge, another body, and the wedge's sound, made on a finer mesh than the one that listens."""
    from vibraverse.cli import main

    place = tmp_path_factory.mktemp("listen")
    points = np.array(
        [[0, 0, 0], [10, 0, 0], [10, 6, 0], [0, 7, 0], [0, 0, 3], [10, 0, 4], [10, 6, 2.5], [0, 7, 3]]
    )
    trimesh.convex.convex_hull(points).export(place / "wedge.stl")
    trimesh.convex.convex_hull(np.array([[0, 0, 0], [9, 0, 0], [2, 8, 0], [3, 2, 7]])).export(
        place / "other.stl"
    )
    assert main(
        [
            "strike", str(place / "wedge.stl"), "--size", str(SIZE_M), "--material", MATERIAL, "--elements", "1500",
            "--at", "9.5,0.4,4", "-o", str(place / "wedge.wav"),
        ]
    ) == 0  # fmt: skip
    return place


@pytest.fixture(scope="module")
def phone(folder):
    """As a phone hears it: a pause, noise of a room 26 dB below, echoes 24 dB below, and a second, softer hit."""
    random = np.random.default_rng(11)
    struck, rate = soundfile.read(folder / "wedge.wav")
    sound = np.zeros(rate)
    for at, level in ((0.3, 0.8), (0.62, 0.4)):
        part = level * struck[: rate - round(at * rate)]
        sound[round(at * rate) :][: len(part)] += part
    decay = np.exp(-np.arange(round(0.25 * rate)) / (0.04 * rate))
    echo = decay * random.normal(size=len(decay)) * (random.random(len(decay)) < 0.02)
    heard = sound + 0.015 * np.convolve(sound, echo)[: len(sound)]
    heard += 0.05 * np.sqrt(np.mean(heard[round(0.3 * rate) :][:2000] ** 2)) * random.normal(size=len(heard))
    soundfile.write(folder / "phone.wav", np.stack([0.5 * heard, 0.6 * heard], axis=1), rate)
    return folder / "phone.wav"


def listened(vibraverse, folder, *arguments):
    """Return the answer about a mesh of few elements, and what was printed."""
    status, out, err = vibraverse("listen", *arguments, "--elements", 500, "--json", folder / "answer.json")
    assert status == 0, err
    return json.loads((folder / "answer.json").read_text()), out


def test_a_recording_by_phone_gives_the_material(folder, phone, vibraverse):
    true = MATERIALS[MATERIAL]
    volume = trimesh.load(folder / "wedge.stl").volume * (SIZE_M / 10) ** 3
    facts, out = listened(
        vibraverse, folder, phone, "--mesh", folder / "wedge.stl", "--size", SIZE_M,
        "--mass", true["density_kg_m3"] * volume,
    )  # fmt: skip
    assert facts["verdict"] == "found"
    found = facts["found"]
    assert found["young_per_density_m2_s2"]["value"] == pytest.approx(
        true["young_pa"] / true["density_kg_m3"], rel=0.01
    )
    assert found["poisson"]["value"] == pytest.approx(true["poisson"], abs=0.02)
    assert found["density_kg_m3"]["value"] == pytest.approx(true["density_kg_m3"], rel=0.01)
    assert found["young_pa"]["value"] == pytest.approx(true["young_pa"], rel=0.015)
    assert found["beta_s"]["value"] == pytest.approx(true["beta_s"], rel=0.2)  # echoes blur the decay
    for name, expected in (
        ("young_per_density_m2_s2", true["young_pa"] / true["density_kg_m3"]),
        ("poisson", 0.2),
    ):
        assert found[name]["low"] < expected < found[name]["high"]
    assert facts["materials"][0]["name"] == MATERIAL
    assert any("2 hits, at 0.3" in warning for warning in facts["warnings"])
    assert any("channel 2 of 2 is used" in warning for warning in facts["warnings"])
    assert "agrees with glass" in out
    assert "Poisson's ratio" in out


def test_a_known_material_gives_the_size(folder, vibraverse):
    facts, _ = listened(
        vibraverse, folder, folder / "wedge.wav", "--mesh", folder / "wedge.stl", "--material", MATERIAL
    )
    assert facts["found"]["size_m"]["value"] == pytest.approx(SIZE_M, rel=0.005)
    assert set(facts["found"]) == {"size_m", "alpha_per_s", "beta_s"}


def test_without_size_and_material_only_their_ratio_is_found(folder, vibraverse):
    facts, out = listened(vibraverse, folder, folder / "wedge.wav", "--mesh", folder / "wedge.stl")
    speed = np.sqrt(MATERIALS[MATERIAL]["young_pa"] / MATERIALS[MATERIAL]["density_kg_m3"])
    assert facts["found"]["speed_per_size_per_s"]["value"] == pytest.approx(speed / SIZE_M, rel=0.005)
    assert "not determined: E/ρ and the size: frequencies hold only sqrt(E/ρ) / size; give --size" in out
    sizes = {row["name"]: row["size_m"] for row in facts["materials"]}
    assert sizes[MATERIAL] == pytest.approx(SIZE_M, rel=0.005)


def test_the_mesh_of_another_body_does_not_fit(folder, vibraverse):
    facts, out = listened(
        vibraverse, folder, folder / "wedge.wav", "--mesh", folder / "other.stl", "--size", SIZE_M
    )
    assert facts["verdict"] == "nothing fits"
    assert facts["found"] == {}
    assert "Nothing fits: " in out
    assert "The mesh is not the body that was recorded" in out


def test_elements_too_coarse_to_match_are_named_as_the_cause(folder, vibraverse):
    facts, _ = listened(
        vibraverse,
        folder,
        folder / "wedge.wav",
        "--mesh",
        folder / "wedge.stl",
        "--size",
        SIZE_M,
        "--order",
        1,
    )
    assert facts["verdict"] == "nothing fits"
    assert "These elements are off by some " in facts["sentence"]
    assert "use --order 2" in facts["sentence"]


def sound(folder, name, samples, rate=RATE):
    soundfile.write(folder / name, samples, rate)
    return folder / name


TIME = np.arange(RATE // 2) / RATE
CHORD = np.exp(-20 * TIME) * sum(np.sin(2 * np.pi * f * TIME) for f in (900.0, 1770.0, 2900.0)) / 4


@pytest.mark.parametrize(
    ("samples", "rate", "sentence"),
    [
        (np.zeros(RATE), RATE, "a.wav: the recording is silent, its loudest sample is zero; record louder"),
        (np.clip(9 * CHORD, -0.9, 0.9), RATE, "a.wav: the recording is clipped: "),
        (CHORD[::11], RATE // 11, "a.wav: the sample rate of 4009 Hz is too low: nothing above 2004.5 Hz is in the"),
        (np.exp(-20 * TIME) * np.sin(5000 * TIME), RATE, "1 peak can be heard, at least 3 are needed; record"),
        (np.zeros(0), RATE, "holds no samples; record again"),
    ],
)  # fmt: skip
def test_a_bad_recording_is_one_sentence(folder, vibraverse, samples, rate, sentence):
    path = sound(folder, "a.wav", samples, rate)
    status, out, err = vibraverse("listen", path, "--mesh", folder / "wedge.stl")
    assert status == 2
    assert out == ""
    assert sentence in err
    assert len(err.strip().splitlines()) == 1


def test_of_an_hour_a_minute_is_read(folder):
    """The file's samples are a hole, so it takes no room."""
    samples = 3600 * RATE
    header = struct.pack(
        "<4sI4s4sIHHII", b"RIFF", 36 + 2 * samples, b"WAVE", b"fmt ", 16, 1, 1, RATE, 2 * RATE
    )
    (folder / "hour.wav").write_bytes(header + struct.pack("<HH4sI", 2, 16, b"data", 2 * samples))
    os.truncate(folder / "hour.wav", 44 + 2 * samples)
    found, rate, length_s = read_sound(folder / "hour.wav", SEARCHED_S)
    assert (found.shape, rate, length_s) == ((60 * RATE, 1), RATE, 3600.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "name a sound file, or a list of frequencies with --frequencies, one of the two"),
        (["wedge.wav", "--frequencies", "list.txt"], "one of the two"),
        (["no.wav"], "the sound file no.wav does not exist; name an existing file"),
        (["wedge.stl"], "the sound file wedge.stl cannot be read ("),
        (["--frequencies", "list.txt"], "line 2 of list.txt is 'loud'; write a frequency in Hz, and its decay rate in"),
        (["wedge.wav", "--mass", "-1"], "--mass must be greater than 0 kg, not -1"),
        (["wedge.wav", "--wall", "--hollow", "0.5"], "--wall seeks the wall and --hollow states it; give one of the"),
        (["wedge.wav", "--material", "glass", "--size", "1"], "--material and --size leave nothing to find; give one"),
        (["wedge.wav", "--material", "glass", "--mass", "1"], "which --material states; give one of the two"),
        (["wedge.wav", "--material", "glas"], "unknown material 'glas'; did you mean 'glass'?"),
        (["wedge.wav", "--json", "no/such/a.json"], "the folder of no/such/a.json does not exist"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_sentence(folder, vibraverse, monkeypatch, arguments, sentence):
    monkeypatch.chdir(folder)
    (folder / "list.txt").write_text("1000, 2.5 # the lowest\nloud\n")
    status, out, err = vibraverse("listen", *arguments, "--mesh", "wedge.stl")
    assert status == 2
    assert out == ""
    assert sentence in err
    assert len(err.strip().splitlines()) == 1
