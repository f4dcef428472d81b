"""The stage ``audio``: from modes.h5 to WAV files; and the spectrogram of a sound."""

from __future__ import annotations

import io
import json

import h5py
import numpy as np
import pytest
import soundfile

from vibraverse.config.media import Audio, split_sound
from vibraverse.contract.products import sha256, write_provenance
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.media.audio import PEAK_DBFS, wav_bytes
from vibraverse.media.spectrogram import FLOOR_DB, mel, mel_levels
from vibraverse.physics.impulse import impact_sound

FREQUENCIES = {"ceramic": [900.0, 2100.0, 5300.0, 40_000.0], "rubber-p1": [200.0, 450.0, 900.0, 1500.0]}
DAMPING = {"ceramic": [8.0, 12.0, 30.0, 90.0], "rubber-p1": [400.0, 600.0, 8000.0, 20_000.0]}


@pytest.fixture
def modes(tmp_path):
    """A body of two materials on one triangle in the plane z = 0, moving by 1, 2, 3 and 4 along z.

    The ceramic's shapes are coefficients in three fields and a correction; the rubber was solved on the mesh.
    """
    path = tmp_path / "modes.h5"
    shapes = np.zeros((4, 3, 3), np.float32)
    shapes[:, :, 2] = np.arange(1, 5)[:, None]
    with h5py.File(tmp_path / "basis.h5", "w") as file:
        file["surface/vertices"] = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64)
        file["surface/faces"] = np.array([[0, 1, 2]], np.int32)
        file["surface/basis"] = shapes[:3].transpose(1, 2, 0)
        file["correction/surface"] = 2 * shapes[3:].transpose(1, 2, 0)
    with h5py.File(path, "w") as file:
        write_provenance(file, {"stage": "modes"})
        for name, frequencies in FREQUENCIES.items():
            group = file.create_group(f"materials/{name}")
            group["frequencies_hz"] = frequencies
            group["damping_per_s"] = DAMPING[name]
            if name == "ceramic":
                group["mode_coefficients"] = np.diag([1, 1, 1, 0.5]).astype(np.float32)
            else:
                group["mode_shapes"] = shapes
    return path


def render(vibraverse, modes, options="{}", folder="sounds"):
    folder = modes.parent / folder
    status, _, errors = vibraverse(
        "audio", "--object", "x", "--solidity", "solid", "--basis", modes.parent / "basis.h5", "--modes", modes,
        "--sounds", folder, "--options", options,
    )  # fmt: skip
    return status, errors, folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_writes_the_sounds_of_every_material(vibraverse, modes):
    status, errors, folder = render(vibraverse, modes)
    assert status == 0, errors
    assert names(folder) == ["audio.json", "ceramic.wav", "rubber-p1.wav"]
    record = json.loads((folder / "audio.json").read_text())
    assert record["sample_rate_hz"] == 44_100
    for path in folder.glob("*.wav"):
        entry = record["sounds"][path.stem]
        assert record["provenance"]["output_sha256"]["sounds"][path.name] == sha256(path)
        info = soundfile.info(path)
        assert (info.subtype, info.channels, info.samplerate) == ("PCM_24", 1, 44_100)
        stored, _ = soundfile.read(path)
        assert len(stored) / 44_100 == entry["duration_s"]
        assert 20 * np.log10(np.abs(stored).max()) == pytest.approx(PEAK_DBFS, abs=1e-4)
        physical = impact_sound(FREQUENCIES[path.stem], DAMPING[path.stem], 44_100).samples
        np.testing.assert_allclose(stored / entry["gain"], physical, atol=2**-23 / entry["gain"])
        assert entry["rms_dbfs"] == pytest.approx(10 * np.log10((stored**2).mean()), abs=2e-3)
        assert entry["rms_dbfs"] <= entry["loudest_dbfs"] < PEAK_DBFS
    assert record["sounds"]["ceramic"]["modes_above_nyquist"] == 1
    assert record["sounds"]["rubber-p1"]["modes_overdamped"] == 2


def test_strikes_points(vibraverse, modes):
    status, errors, folder = render(vibraverse, modes, '{"points": [[0.2, 0.2, -1]]}')
    assert status == 0, errors
    for name, frequencies in FREQUENCIES.items():
        entry = json.loads((folder / "audio.json").read_text())["sounds"][f"{name}-p0"]
        assert entry["struck_at"] == pytest.approx([0.2, 0.2, 0])
        assert entry["struck_along"] == pytest.approx([0, 0, 1])
        stored, _ = soundfile.read(folder / f"{name}-p0.wav")
        physical = impact_sound(frequencies, DAMPING[name], 44_100, weights=[1, 2, 3, 4]).samples
        np.testing.assert_allclose(stored / entry["gain"], physical, atol=2**-23 / entry["gain"])


def test_a_strike_lasts_and_velocity_is_heard(vibraverse, modes):
    asked = '{"points": [[0.2, 0.2, -1]], "contact_s": 0.002, "observable": "velocity"}'
    status, errors, folder = render(vibraverse, modes, asked)
    assert status == 0, errors
    record = json.loads((folder / "audio.json").read_text())
    assert (record["contact_s"], record["observable"]) == (0.002, "velocity")
    assert record["unit"].startswith("kg^0.5 m/s ")
    for name, frequencies in FREQUENCIES.items():
        entry = record["sounds"][f"{name}-p0"]
        stored, _ = soundfile.read(folder / f"{name}-p0.wav")
        heard = {"weights": [1, 2, 3, 4], "contact_s": 0.002, "observable": "velocity"}
        physical = impact_sound(frequencies, DAMPING[name], 44_100, **heard).samples
        np.testing.assert_allclose(stored / entry["gain"], physical, atol=2**-23 / entry["gain"])


def test_struck_points_need_the_basis_of_the_modes(vibraverse, modes):
    points = '{"points": [[0.2, 0.2, -1]]}'
    command = (
        "audio",
        "--object",
        "x",
        "--solidity",
        "solid",
        "--modes",
        modes,
        "--sounds",
        modes.parent / "sounds",
    )
    status, _, errors = vibraverse(*command, "--options", points)
    assert status == 2
    assert errors.splitlines()[-1].endswith("need the surface in the basis; name it with --basis basis.h5")
    assert vibraverse(*command)[0] == 0
    with h5py.File(modes, "r+") as file:
        write_provenance(
            file, {"stage": "modes", "input_sha256": {"basis": sha256(modes.parent / "basis.h5")}}
        )
    assert render(vibraverse, modes, points)[0] == 0
    before = names(modes.parent / "sounds")
    with h5py.File(modes.parent / "basis.h5", "r+") as file:
        file["surface/vertices"][0] = 0.1
    status, errors, folder = render(vibraverse, modes, points)
    assert status == 2
    assert f"basis.h5 is not the basis that {modes} was made from" in errors
    assert names(folder) == before


def test_repeats_to_the_byte(vibraverse, modes):
    digests = []
    for name in ("first", "second"):
        _, _, folder = render(vibraverse, modes, folder=name)
        digests.append({path.name: sha256(path) for path in folder.iterdir()})
    assert digests[0] == digests[1]
    assert len(digests[0]) == 3


def test_replaces_the_folder_as_a_whole(vibraverse, modes):
    render(vibraverse, modes, '{"points": [[0.2, 0.2, -1]]}')
    _, _, folder = render(vibraverse, modes)
    (folder / ".snakemake_timestamp").touch()  # as Snakemake leaves it there
    status, errors, _ = render(vibraverse, modes)
    assert status == 0, errors
    assert names(folder) == ["audio.json", "ceramic.wav", "rubber-p1.wav"]
    assert names(modes.parent) == ["basis.h5", "modes.h5", "sounds"]


@pytest.mark.parametrize("record", [None, "", "[]", '{"provenance": {"output_sha256": {"sounds": []}}}'])
def test_a_folder_with_something_else_in_it_stays(vibraverse, modes, record):
    _, _, folder = render(vibraverse, modes)
    (folder / "song.wav").write_text("mine")
    if record is not None:
        (folder / "audio.json").write_text(record)
    before = names(folder)
    status, errors, _ = render(vibraverse, modes)
    assert status == 2
    strange = "song.wav" if record is None else "ceramic.wav"
    assert f"holds {strange!r}, which this stage did not write; the folder is replaced as a whole" in errors
    assert names(folder) == before
    assert (folder / "song.wav").read_text() == "mine"


def test_a_file_is_no_folder(vibraverse, modes):
    (modes.parent / "sounds").write_text("mine")
    status, errors, folder = render(vibraverse, modes)
    assert status == 2
    assert "is a file, but the stage writes a folder" in errors
    assert folder.read_text() == "mine"


def test_nothing_is_left_of_a_failure(vibraverse, modes):
    status, errors, _ = render(vibraverse, modes, '{"sampled": 3}')
    assert status == 2
    assert "audio.sampled is 3, but the modes hold 0 sampled materials" in errors
    assert names(modes.parent) == ["basis.h5", "modes.h5"]


def test_passes_refusals_on(vibraverse, modes):
    render(vibraverse, modes)
    modes.write_text(Refusal("x", "tets", "too_thin", "The wall is too thin.").to_text())
    status, _, folder = render(vibraverse, modes)
    assert status == 0
    assert names(folder) == ["audio.json"]
    assert read_refusal(folder / "audio.json").reason == "too_thin"


def test_names_of_sounds():
    options = Audio(points=[(0, 0, 1), (0, 1, 0)])
    assert options.names(["tin", "a-p1"]) == ["tin", "tin-p0", "tin-p1", "a-p1", "a-p1-p0", "a-p1-p1"]
    known = {"tin", "a-p1"}
    assert split_sound("a-p1", known) == ("a-p1", None)
    assert split_sound("a-p1-p1", known) == ("a-p1", 1)
    assert split_sound("zinc-p1", known) == (None, None)


def test_silence_is_a_sound_too():
    data, levels = wav_bytes(np.zeros(1000), 44_100)
    assert levels["gain"] == 1.0
    assert levels["rms_dbfs"] is None
    assert not soundfile.read(io.BytesIO(data))[0].any()


def test_spectrogram_shows_the_partials():
    sound = impact_sound([800.0, 3000.0], [4.0, 4.0], 44_100, max_s=1.0, weights=[1.0, 4.0])
    levels = mel_levels(sound.samples, 44_100, rows=128)
    middle = levels[:, levels.shape[1] // 2]
    centres = (np.arange(128) + 0.5) * mel(22_050) / 128
    loud = centres[middle > middle.max() - 12]
    assert all(min(abs(value - mel(800)), abs(value - mel(3000))) < 2 * mel(22_050) / 128 for value in loud)
    assert len(loud) >= 2
    falling = levels.max(axis=0)[5:-20:40]
    assert (np.diff(falling) < 0).all()


@pytest.mark.parametrize("count", [5, 300, 882, 44_100, 200_000])
def test_spectrogram_of_any_length(count):
    samples = np.random.default_rng(1).normal(size=count) * np.exp(-np.arange(count) / (0.2 * count))
    levels = mel_levels(samples, 44_100, rows=100, columns=200)
    assert levels.shape[0] == 100
    assert min(count, 200) <= levels.shape[1] < 400
    assert levels.max() == 0
    assert levels.min() >= FLOOR_DB


def test_spectrogram_of_silence_and_of_nothing():
    assert (mel_levels(np.zeros(5000), 44_100) == FLOOR_DB).all()
    with pytest.raises(ValueError, match="list of samples"):
        mel_levels(np.zeros(0), 44_100)
