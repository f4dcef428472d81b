"""The report's content for all kinds of datasets: counts, texts and pictures."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundfile
from PIL import Image

import make_products
from vibraverse.contract import products
from vibraverse.geometry.cleaning import cautions as cleaning
from vibraverse.geometry.meshing import cautions as meshing
from vibraverse.physics import cautions as modal
from vibraverse.report import content, quantities, render
from vibraverse.stages import report
from vibraverse.stages.report import remove_others, write_assets


def test_the_page_names_nothing_outside_its_folder(report_page):
    text = report_page.read_text(encoding="utf-8")
    assert not re.search(r"https?://", text)
    assert str(report_page.parents[1]) not in text
    for name in re.findall(r'(?:src|href)="(assets/[^"]+)"', text):
        assert (report_page.parent / name).is_file(), name
    assert "<title>Things that ring</title>" in text


def test_the_page_of_learning_is_linked_where_there_is_one(report_page, tmp_path):
    assert "Learning</a>" not in report_page.read_text(encoding="utf-8")
    shutil.copytree(report_page.parents[1] / "dataset", tmp_path / "dataset")
    (tmp_path / "learn").mkdir()
    (tmp_path / "learn/index.html").write_text("anything")
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    assert '<a href="../learn/index.html">Learning</a>' in text


def test_an_empty_split_is_said(report_page):
    text = report_page.read_text(encoding="utf-8")
    assert re.search(
        r"<strong>Empty split</strong> The splits? [a-z ]+ holds? no object: take more objects", text
    )


def test_same_dataset_same_bytes(report_page):
    before = {path: products.sha256(path) for path in report_page.parent.rglob("*") if path.is_file()}
    make_products.report(report_page.parents[1], title="Things that ring")
    assert {path: products.sha256(path) for path in report_page.parent.rglob("*") if path.is_file()} == before


def test_objects_beyond_the_limit_are_counted(report_page, tmp_path):
    shutil.copytree(report_page.parents[1] / "dataset", tmp_path / "dataset")
    text = make_products.report(tmp_path, max_objects=1).read_text(encoding="utf-8")
    assert 'id="ball-0000"' in text
    assert 'id="bar-0000"' not in text
    assert "1 more object is in the dataset" in text


def test_a_silent_sound_says_why(report_page, tmp_path):
    shutil.copytree(report_page.parents[1] / "dataset", tmp_path / "dataset")
    with h5py.File(tmp_path / "dataset/shards/1.h5", "r+") as h5:
        h5["objects/bar-0000/solid/sounds/steel"][...] = 0.0
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    assert text.count("silent: no mode rings below 22.1\u202fkHz") == 1
    assert 'aria-label="Play steel, solid" disabled>' in text


def test_sounds_that_are_not_shown_are_counted_apart(report_page, tmp_path):
    shutil.copytree(report_page.parents[1] / "dataset", tmp_path / "dataset")
    shards = sorted((tmp_path / "dataset/shards").glob("*.h5"))
    with h5py.File(shards[1], "r+") as h5:
        sounds = h5["objects/bar-0000/solid/sounds"]
        for number in range(2):
            sounds.copy("steel", f"sampled-000{number}")
    make_products.index(tmp_path, shards)
    counts = products.read_json(tmp_path / "dataset/dataset.json")["counts"]
    assert (counts["sounds"], counts["sampled_sounds"]) == (14, 2)
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    assert text.count('<div class="player ') == 12
    assert "<br>12 sounds.</h1>" in text
    assert "<dt>sounds</dt><dd>12</dd>" in text
    assert "2 more sounds, of sampled materials, are in the dataset and not on this page" in text
    assert "sampled materials, are" not in report_page.read_text(encoding="utf-8")


def test_warnings_are_counted_and_listed(report_page, tmp_path, vibraverse):
    paths = make_products.make(tmp_path)
    clean = Path(paths.at(paths.clean_record, object="ball-0000"))
    products.write_json(
        clean, {**products.read_json(clean), "deviation": {"invented": 0.05}, "repairs": ["wrapped"]}
    )
    record = Path(paths.at(paths.tets_record, object="bar-0000", solidity="hollow"))
    too_many = meshing.cautions(50_000, 5000)
    products.write_json(record, {**products.read_json(record), "warnings": too_many * 25})
    with h5py.File(paths.at(paths.modes, object="ball-0000", solidity="solid"), "r+") as h5:
        h5["materials/wood/discretisation_error"][3] = 0.031
    make_products.index(tmp_path, make_products.pack(tmp_path))
    stated = products.read_json(paths.dataset_record)["warnings_by_kind"]
    assert stated == {"changed_shape": 1, "inaccurate_modes": 1, "many_elements": 25}
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    section = text.partition('<section id="warnings">')[2].partition("</section>")[0]
    assert "2 of 2 objects carry warnings" in " ".join(section.split())
    assert section.count(too_many[0]) == 20
    assert "… and 5 more" in section
    assert "5.0 % of the surface is made up (at most 2 %): wrapped." in section
    assert "reaches 3.1 % in mode 4 (at most 2 %; above in 1 of " in section
    assert "<code>ball-0000</code> <em>solid</em></th><td>the estimated" in section
    assert "<code>ball-0000</code></th><td>5.0 %" in section
    assert '<a href="#warnings">2</a>' in text
    assert 'id="warnings"' not in report_page.read_text(encoding="utf-8")
    status, out, _ = vibraverse("refusals", "--record", paths.dataset_record)
    assert status == 0
    assert (
        "Warnings: changed shape (1), inaccurate modes (1), many elements (25); the report lists them." in out
    )


def test_the_numbers_of_every_mesh_are_a_table(report_page):
    text = report_page.read_text(encoding="utf-8")
    section = text.partition('<section id="meshes">')[2].partition("</section>")[0]
    assert section.count("<tr>") == 1 + 3
    row = section.partition("<code>ball-0000</code>")[2].partition("</tr>")[0]
    cells = re.findall("<td>(.*?)</td>", row)
    assert cells[1:] == ["6,000", "2.5", "1.2", "12°", "0", "0.1 %", "0.1 %"]


def test_common_findings_are_no_warnings():
    """The thresholds lie where the numbers of the default run part (docs/tets.md)."""
    assert not meshing.cautions(21_511, 5000)
    assert meshing.cautions(40_001, 5000)[0].startswith(
        "40001 tetrahedra, 8.0 times tets.target_elements (at most 8)"
    )
    assert not modal.cautions([np.array([0.001, 0.0192])])
    assert (
        "reaches 2.9 % in mode 2 (at most 2 %; above in 1 of 2"
        in modal.cautions([np.array([0.01, 0.005]), [0, 0.0293]])[0]
    )
    record = {"deviation": {"invented": 0.019}, "dropped": {"volume_share": 0.009}, "repairs": ["wrapped"]}
    assert not cleaning.cautions(record)
    (said,) = cleaning.cautions({**record, "dropped": {"volume_share": 0.127}})
    assert said.startswith("12.7 % of the volume is left out (at most 1 %)")


def test_a_dataset_of_refusals_alone_has_a_page(tmp_path):
    make_products.make(tmp_path, objects=("leaf",))
    make_products.index(tmp_path, make_products.pack(tmp_path, groups=(("leaf",),)))
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    assert "No object made it to the dataset." in text
    assert "leaf.obj is flat" in text


def test_texts_from_files_cannot_break_the_page():
    nasty = "</script><script>alert(1)</script>"
    record = {
        "counts": dict.fromkeys(
            ("objects", "bodies", "sounds", "sampled_sounds", "refused_objects", "refused_bodies"), 1
        ),
        "materials": {
            nasty: dict.fromkeys(("density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s"), 1.0)
        },
        "objects_by_split": {},
        "shards": {},
        "made_by": {},
        "ranges": {},
    }
    refusal = {
        "object": nasty,
        "solidity": "",
        "stage": "clean",
        "reason": "empty",
        "message": nasty,
        "advice": nasty,
    }
    text = render.html("<b>", record, [refusal], [], "assets/x")
    assert nasty not in text
    assert "<b>" not in text.split("<body>")[0]


def test_assets_of_another_page_stay_until_they_are_removed(tmp_path):
    first = write_assets(tmp_path, {"a/b.txt": b"1"})
    (tmp_path / ".1.partial").mkdir()
    second = write_assets(tmp_path, {"a/b.txt": b"2"})
    assert (tmp_path / first / "a/b.txt").read_bytes() == b"1"
    assert (tmp_path / second / "a/b.txt").read_bytes() == b"2"
    remove_others(tmp_path, second)
    assert [path.name for path in tmp_path.iterdir()] == [second]


def test_assets_that_are_there_are_kept_and_mended(tmp_path):
    first = write_assets(tmp_path, {"a/b.txt": b"1"})
    before = (tmp_path / first).stat().st_ino
    assert write_assets(tmp_path, {"a/b.txt": b"1"}) == first
    assert (tmp_path / first).stat().st_ino == before
    (tmp_path / first / "a/b.txt").write_bytes(b"")
    assert write_assets(tmp_path, {"a/b.txt": b"1"}) == first
    assert (tmp_path / first / "a/b.txt").read_bytes() == b"1"


def whole_page(page: Path) -> str:
    """Return a page's text, all of whose pictures and sounds are there."""
    text = page.read_text(encoding="utf-8")
    named = re.findall(r'(?:src|href)="(assets/[^"]+)"', text)
    assert named
    assert all((page.parent / name).is_file() for name in named)
    return text


def test_a_page_is_whole_whenever_the_next_one_is_killed(report_page, tmp_path, monkeypatch):
    shutil.copytree(report_page.parents[1] / "dataset", tmp_path / "dataset")
    page = make_products.report(tmp_path)
    before, folders = whole_page(page), set((page.parent / "assets").iterdir())

    def kill(*_):
        raise KeyboardInterrupt

    def publish(partial: Path, final: Path, really=products.publish):
        kill() if final == page else really(partial, final)

    for where, name, instead in ((render, "html", kill), (products, "publish", publish)):
        with monkeypatch.context() as patched:
            patched.setattr(where, name, instead)
            with pytest.raises(AssertionError):  # exit status 130
                make_products.report(tmp_path, max_objects=1)
        assert whole_page(page) == before
    with monkeypatch.context() as patched:
        patched.setattr(report, "remove_others", kill)
        with pytest.raises(AssertionError):
            make_products.report(tmp_path, max_objects=1)
    after = whole_page(page)
    assert after != before
    assert folders < set((page.parent / "assets").iterdir())
    make_products.report(tmp_path, max_objects=1)
    assert whole_page(page) == after
    assert len(list((page.parent / "assets").iterdir())) == 1


def test_spectrogram_shows_the_tone_where_it_is():
    rate = 44_100
    time = np.arange(rate) / rate
    tone = np.exp(-3 * time) * np.sin(2 * np.pi * 4000 * time)
    picture = np.asarray(Image.open(io.BytesIO(content.spectrogram(tone, rate))))
    height = content.marks(rate)["4 k"]
    brightest = picture.astype(int).mean(axis=1).argmax()
    assert 100 * (1 - brightest / len(picture)) == pytest.approx(height, abs=2)
    assert list(content.marks(16_000)) == ["1 k", "4 k"]


def test_flac_keeps_16_bits():
    samples = np.random.default_rng(1).uniform(-0.9, 0.9, 5000).astype(np.float32)
    data = content.flac(samples, 44_100)
    back, rate = soundfile.read(io.BytesIO(data))
    assert rate == 44_100
    assert np.abs(back - samples).max() <= 1 / 2**15
    assert content.flac(samples, 44_100) == data


@pytest.mark.parametrize(
    ("function", "value", "text"),
    [
        (quantities.length, 0.18, "18 cm"),
        (quantities.length, 0.0042, "4.2 mm"),
        (quantities.length, 1.25, "1.25 m"),
        (quantities.volume, 2.16e-4, "216 cm³"),
        (quantities.volume, 2.95e-3, "2.95 L"),
        (quantities.volume, 4e-9, "4 mm³"),
        (quantities.mass, 0.5832, "583 g"),
        (quantities.mass, 23.16, "23.2 kg"),
        (quantities.frequency, 2717.0, "2,720 Hz"),
        (quantities.frequency, 25029.0, "25 kHz"),
        (quantities.duration, 0.3927, "393 ms"),
        (quantities.duration, 1.0334, "1.03 s"),
        (quantities.file_size, 862_315, "862 kB"),
        (quantities.number, 0, "0"),
        (quantities.number, 1_234_567, "1,230,000"),
        (quantities.number, 0.999999, "1"),
    ],
)
def test_quantities(function, value, text):
    assert function(value).replace("\u202f", " ") == text


def test_axis_ticks():
    assert render.ticks(90, 2100) == [100, 200, 500, 1000, 2000]
    low, high = render.axis(100.0, 10_000.0)
    assert low < 100 < 10_000 < high
