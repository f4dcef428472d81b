"""What the page knows of an object: its own sounds to the sample, and a reason for what is refused."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import soundfile
from PIL import Image

import make_products
from scripts import run_script
from vibraverse.config.media import Audio
from vibraverse.contract.products import read_json, sha256, write_json
from vibraverse.contract.refusal import Refusal
from vibraverse.flow.paths import Paths
from vibraverse.physics.impulse import impact_sound
from vibraverse.report.objects import index_row
from vibraverse.report.turn import turn

SOLIDITIES = ("solid", "hollow")


@pytest.fixture
def results(tmp_path, monkeypatch) -> Paths:
    """Products of three objects: one is whole, of one the hollow body is refused, of one everything."""
    monkeypatch.chdir(tmp_path)
    paths = make_products.make(Path("results"))
    for object_id in make_products.OBJECTS:
        for solidity in SOLIDITIES:
            record = Path(paths.at(paths.page_body_record, object=object_id, solidity=solidity))
            modes = Path(paths.at(paths.modes, object=object_id, solidity=solidity))
            if modes.read_bytes()[:1] == b"{":
                record.write_bytes(modes.read_bytes())
                continue
            provenance = {"output_sha256": {"script": solidity.encode().hex().ljust(64, "0")}}
            write_json(record, {"order": 2, "measured": {"rms_db": 0.05}, "provenance": provenance})
    return paths


def page_object(vibraverse, paths: Paths, object_id: str, *more) -> tuple[dict, dict]:
    """Run the stage; return the content of the script and the record."""

    def of_bodies(pattern: str) -> list[str]:
        return [paths.at(pattern, object=object_id, solidity=solidity) for solidity in SOLIDITIES]

    one = {
        name: paths.at(getattr(paths, name), object=object_id)
        for name in ("source_record", "clean_record", "views", "hollow_record")
    }
    made = {
        "script": paths.page_object,
        "turn": paths.page_turn,
        "thumbnail": paths.page_thumbnail,
        "record": paths.page_object_record,
    }
    arguments = [(f"--{name.replace('_', '-')}", path) for name, path in one.items()]
    arguments += [
        (f"--{name.replace('_', '-')}", *of_bodies(getattr(paths, name)))
        for name in ("tets_record", "modes", "sounds", "page_body_record")
    ]
    arguments += [(f"--{name}", paths.at(path, object=object_id)) for name, path in made.items()]
    flat = [word for words in arguments for word in words]
    status, _, errors = vibraverse("page_object", "--object", object_id, *flat, *more)
    assert status == 0, errors
    script = Path(paths.at(paths.page_object, object=object_id)).read_text(encoding="ascii")
    called = re.fullmatch(rf'vibraverse\.object\("{object_id}", (\{{.*\}})\);\n', script)
    return json.loads(called[1]), read_json(paths.at(paths.page_object_record, object=object_id))


def test_the_sounds_of_the_files_are_heard_from_it(vibraverse, results):
    """Rendered in JavaScript from the object's script alone, they equal the WAV files within 1e-3 of the peak."""
    data, _ = page_object(vibraverse, results, "bar-0000")
    body = """
      const {modes, material, audio} = given;
      const omega = modes.hz.map((hz) => 2 * Math.PI * hz);
      const damping = omega.map((one) => 0.5 * (material.alpha + material.beta * one * one));
      const options = {rate: audio.sample_rate_hz, decayDb: audio.decay_db, maxS: audio.max_s};
      return synth.render({omega, damping}, options).samples;
    """
    for solidity in SOLIDITIES:
        for name in make_products.MATERIAL_NAMES:
            given = {
                "modes": data["bodies"][solidity]["modes"][name],
                "material": data["materials"][name],
                "audio": data["audio"],
            }
            heard = np.array(run_script(body, given, "synth.js"))
            wav = results.at(results.sound, object="bar-0000", solidity=solidity, material=name)
            stored, _ = soundfile.read(wav)
            assert len(heard) == len(stored)
            heard *= np.abs(stored).max() / np.abs(heard).max()
            assert np.abs(heard - stored).max() < 1e-3 * np.abs(stored).max(), (solidity, name)


def test_struck_points_are_weighted_as_in_the_sounds(vibraverse, results):
    points = [[0.9, 0.1, 0.0], [0.0, 0.2, 0.15]]
    for solidity in SOLIDITIES:
        audio = Path(results.at(results.audio_record, object="bar-0000", solidity=solidity))
        said = read_json(audio)
        said["provenance"]["options"]["points"] = points
        write_json(audio, said)
    bases = [results.at(results.basis, object="bar-0000", solidity=solidity) for solidity in SOLIDITIES]
    data, _ = page_object(vibraverse, results, "bar-0000", "--basis", *bases)
    for solidity, basis in zip(SOLIDITIES, bases, strict=True):
        modes = results.at(results.modes, object="bar-0000", solidity=solidity)
        folder = Path("struck", solidity)
        options = Audio(max_s=0.1, points=points).model_dump_json()
        inputs = ("--basis", basis, "--modes", modes)
        about = ("--object", "bar-0000", "--solidity", solidity, "--options", options)
        assert vibraverse("audio", *about, *inputs, "--sounds", folder)[0] == 0
        record = read_json(folder / "audio.json")["sounds"]
        for name in make_products.MATERIAL_NAMES:
            strikes = data["bodies"][solidity]["strikes"][name]
            assert [one["point"] for one in strikes] == [0, 1]
            for one in strikes:
                said = record[f"{name}-p{one['point']}"]
                np.testing.assert_allclose(one["position"], said["struck_at"], atol=1e-5)
                np.testing.assert_allclose(one["normal"], said["struck_along"], atol=1e-5)
                hz = np.array(data["bodies"][solidity]["modes"][name]["hz"])
                material = data["materials"][name]
                damping = 0.5 * (material["alpha"] + material["beta"] * (2 * np.pi * hz) ** 2)
                made = impact_sound(hz, damping, 44_100, max_s=0.1, weights=one["gains"]).samples
                stored, _ = soundfile.read(folder / f"{name}-p{one['point']}.wav")
                assert np.abs(made * said["gain"] - stored).max() < 1e-3 * np.abs(stored).max()


def test_it_fits_and_states_a_row_of_the_index(vibraverse, results):
    data, record = page_object(vibraverse, results, "bar-0000")
    script = Path(results.at(results.page_object, object="bar-0000"))
    assert script.stat().st_size == record["bytes"] < 25_000
    assert record["provenance"]["output_sha256"]["script"] == sha256(script)
    row = record["row"]
    assert row["bodies"]["solid"]["f1_hz"]["steel"] == pytest.approx(
        data["bodies"]["solid"]["modes"]["steel"]["hz"][0], rel=1e-3
    )
    damping = 0.5 * (
        data["materials"]["steel"]["alpha"]
        + data["materials"]["steel"]["beta"]
        * (2 * np.pi * data["bodies"]["solid"]["modes"]["steel"]["hz"][0]) ** 2
    )
    assert row["bodies"]["solid"]["ring_s"]["steel"] == pytest.approx(np.log(1000) / damping, rel=1e-2)
    assert row["bodies"]["hollow"]["worst_error"] == 1e-3
    assert row["title"] == "A bar"
    assert data["bodies"]["hollow"]["wall"] == 0.5
    assert data["facts"] == {
        "title": "A bar", "family": "bar", "origin": "generated", "source": "bar-0000.ply", "licence": "CC0-1.0",
    }  # fmt: skip


def test_another_body_is_another_version(vibraverse, results):
    _, record = page_object(vibraverse, results, "bar-0000")
    _, again = page_object(vibraverse, results, "bar-0000")
    assert record == again
    changed = Path(results.at(results.page_body_record, object="bar-0000", solidity="hollow"))
    changed.write_text(changed.read_text().replace("0.05", "0.06"))
    _, other = page_object(vibraverse, results, "bar-0000")
    assert other["row"]["version"] != record["row"]["version"]


def test_a_refused_body_says_why(vibraverse, results):
    data, record = page_object(vibraverse, results, "ball-0000")
    assert list(data["bodies"]) == ["solid"]
    assert data["refused"]["hollow"]["reason"] == "too_thin"
    assert data["refused"]["hollow"]["advice"]
    assert record["row"]["bodies"]["hollow"] == {"refused": {"stage": "hollow", "reason": "too_thin"}}
    assert data["turn_frames"] == 3


def test_a_refused_object_has_a_file_and_a_row(vibraverse, results):
    data, record = page_object(vibraverse, results, "leaf")
    assert data["bodies"] == {}
    assert data["turn"] is None
    assert data["audio"] is None
    assert {one["stage"] for one in data["refused"].values()} == {"clean"}
    assert record["row"]["size_m"] is None
    assert record["row"]["title"] == "leaf"
    with Image.open(results.at(results.page_thumbnail, object="leaf")) as picture:
        assert picture.size == (1, 1)


def test_an_object_without_a_source_has_a_row(vibraverse, results):
    for pattern in (results.source_record, results.source_mesh):
        refusal = Refusal("leaf", "sources", "unavailable", "The mesh could not be fetched.", "Try again.")
        Path(results.at(pattern, object="leaf")).write_text(refusal.to_text())
    data, record = page_object(vibraverse, results, "leaf")
    assert data["facts"] == {"title": "leaf", "origin": "unknown"}
    assert record["row"]["bodies"]["solid"]["refused"]["reason"] == "not_a_solid"


def test_hostile_titles_stay_texts(vibraverse, results):
    source = Path(results.at(results.source_record, object="bar-0000"))
    title = "</script><b>\u2028\u202eabc"
    source.write_text(json.dumps({**read_json(source), "title": title}))
    data, _ = page_object(vibraverse, results, "bar-0000")
    assert data["facts"]["title"] == title
    assert "</" not in Path(results.at(results.page_object, object="bar-0000")).read_text()


def test_a_turn_has_up_to_six_views():
    def picture(level: int) -> bytes:
        file = io.BytesIO()
        Image.new("RGB", (64, 64), (level, level, level)).save(file, format="PNG")
        return file.getvalue()

    sheet, frames = turn([picture(20 * number) for number in range(12)])
    assert frames == 6
    with Image.open(io.BytesIO(sheet)) as opened:
        assert opened.size == (768, 512)
        shown = [opened.getpixel((256 * (n % 3) + 128, 256 * (n // 3) + 128))[0] for n in range(6)]
    assert np.abs(np.array(shown) - np.arange(0, 240, 40)).max() <= 3
    assert turn([picture(9)])[1] == 1


def test_a_mode_that_creeps_does_not_ring():
    data = {
        "facts": {"title": "x", "origin": "files"},
        "size_m": 1.0,
        "materials": {"mud": {"alpha": 1e5, "beta": 0.0}},
        "refused": {},
        "bodies": {"solid": {"volume_m3": 1.0, "modes": {"mud": {"hz": [100.0], "error": [0.1]}}}},
    }
    assert index_row("x", data, "0")["bodies"]["solid"]["ring_s"]["mud"] == 0
