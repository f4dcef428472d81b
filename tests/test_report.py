"""The report: opens from disk, shows, plays and lists everything, and asks nothing of a network."""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundfile
from PIL import Image

import make_products
from vibraverse import products
from vibraverse.geometry.cautions import cautions, kind_of
from vibraverse.report import content, quantities, render
from vibraverse.stages.report import write_assets

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-component-update",
    "--disable-sync",
    "--mute-audio",
    "--autoplay-policy=no-user-gesture-required",
)


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    results = tmp_path_factory.mktemp("report") / "results"
    make_products.build(results)
    return make_products.report(results, title="Things that ring")


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    if not (CHROMIUM and DRIVER):
        pytest.skip("Chromium and its driver are not installed (apt-get install chromium chromium-driver)")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}", "--window-size=1280,900"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service(DRIVER))
    driver.set_script_timeout(20)
    driver.get("about:blank")
    driver.get_log("performance")  # what the browser's own start page asked for
    driver.get(page.as_uri())
    yield driver
    driver.quit()


def run(browser, script: str):
    """Return what an asynchronous script hands to ``done``."""
    return browser.execute_async_script(f"const done = arguments[0]; {script}")


def test_every_picture_loads(browser):
    sizes = run(
        browser,
        """
        const images = [...document.images];
        images.forEach((image) => { image.loading = "eager"; });
        Promise.all(images.map((image) => image.decode().catch(() => {})))
          .then(() => done(images.map((image) => [image.currentSrc, image.naturalWidth])));
        """,
    )
    # 2 in the gallery, 2 views, 4 + 8 spectrograms
    assert len(sizes) == 16
    assert [source for source, width in sizes if width == 0] == []


def test_every_sound_loads_with_its_length_and_plays(browser, page):
    heard = run(
        browser,
        """
        const players = [...document.querySelectorAll(".player")];
        Promise.all(players.map((player) => new Promise((resolve) => {
          const audio = player.querySelector("audio");
          audio.muted = true;
          const answer = () => resolve({
            source: decodeURI(audio.currentSrc), duration: audio.duration, stated: Number(player.dataset.duration),
            state: audio.readyState, error: audio.error && audio.error.message,
          });
          audio.addEventListener("canplaythrough", answer);
          audio.addEventListener("error", answer);
          audio.preload = "auto";
          audio.load();
        }))).then(done);
        """,
    )
    assert len(heard) == 12
    for sound in heard:
        assert sound["error"] is None, sound
        assert sound["state"] >= 3
        samples = soundfile.info(sound["source"].removeprefix("file://"))
        assert sound["duration"] == pytest.approx(samples.frames / samples.samplerate, abs=2e-3)
        assert sound["duration"] == pytest.approx(sound["stated"], abs=2e-3)


def test_playing_moves_the_cursor_and_one_sound_stops_another(browser):
    first, second = run(
        browser,
        """
        const [first, second] = ["steel", "glass"].map((name) =>
          document.querySelector(`#bar-0000 .row[data-material=${name}] .player.hollow`));
        const state = (player) => [player.classList.contains("playing"), player.querySelector("audio").currentTime,
          parseFloat(player.style.getPropertyValue("--at")), player.querySelector(".play").getAttribute("aria-label")];
        first.querySelector(".play").click();
        setTimeout(() => {
          const before = state(first);
          second.querySelector(".play").click();
          setTimeout(() => done([[before, state(first)], state(second)]), 250);
        }, 450);
        """,
    )
    (playing, time, at, label), stopped = first
    assert playing
    assert time > 0.05
    assert at > 3
    assert label == "Pause steel, hollow"
    assert stopped[0] is False
    assert second[0] is True
    chosen = browser.execute_script("return document.querySelector('#bar-0000 .row.chosen').dataset.material")
    assert chosen == "glass"
    assert browser.execute_script("return document.querySelector('#bar-0000 .view').src").endswith(
        "glass-00.png"
    )
    browser.execute_script("document.querySelectorAll('audio').forEach((audio) => audio.pause())")


def test_the_keyboard_plays_seeks_and_steps_through_modes(browser):
    from selenium.webdriver.common.keys import Keys

    track = browser.find_element("css selector", "#bar-0000 .row[data-material=steel] .player.solid .track")
    browser.execute_script("arguments[0].focus({preventScroll: true})", track)
    track.send_keys(Keys.END)
    assert float(track.get_attribute("aria-valuenow")) == pytest.approx(
        float(track.get_attribute("aria-valuemax")), abs=0.02
    )
    track.send_keys(Keys.HOME, Keys.ARROW_RIGHT)
    assert float(track.get_attribute("aria-valuenow")) == pytest.approx(
        float(track.get_attribute("aria-valuemax")) / 20, abs=0.02
    )
    strip = browser.find_element("css selector", "#ball-0000 .strip")
    strip.send_keys(Keys.HOME, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert strip.get_attribute("aria-valuenow") == "3"
    expected = make_products.frequencies("ball-0000", "solid", make_products.MATERIALS["ceramic"])[2]
    assert f"{float(f'{expected:.3g}'):,.0f} Hz" in strip.get_attribute("aria-valuetext")


def test_all_frequencies_are_listed_for_solid_and_hollow(browser):
    rows = browser.execute_script(
        """
        const card = document.getElementById("bar-0000");
        card.querySelector(".row[data-material=wood] .material").click();
        card.querySelector("details").open = true;
        card.querySelector("details").dispatchEvent(new Event("toggle"));
        const texts = (row) => [...row.children].map((cell) => cell.textContent);
        return [...card.querySelectorAll(".table tbody tr")].map(texts);
        """
    )
    assert [row[0] for row in rows] == [str(number) for number in range(1, 65)]
    for column, solidity in ((1, "solid"), (3, "hollow")):
        listed = np.array([float(row[column].replace(",", "")) for row in rows])
        expected = make_products.frequencies("bar-0000", solidity, make_products.MATERIALS["wood"])
        np.testing.assert_allclose(listed, expected, rtol=6e-5)
    lines = browser.execute_script(
        "return document.querySelectorAll('#bar-0000 .strip line[data-mode]').length"
    )
    assert lines == 128


def test_refusals_are_listed_with_reason_and_advice(browser):
    text = browser.find_element("id", "refusals").text
    assert "The shape bounds no volume" in text
    assert "leaf.obj is flat: it bounds no volume. Use a closed mesh with a thicker wall." in text
    assert "ball-0000 hollow" in text
    notice = browser.find_element("css selector", "#ball-0000 .notice").text
    assert notice.startswith("No hollow body (refused at hollow). The wall of ball-0000 would be too thin.")


def test_the_advised_command_names_the_folder_that_the_page_lies_in(browser, page, tmp_path):
    assert "vibraverse refusals --results RESULTS --retry" in page.read_text(encoding="utf-8")
    for report in (page.parent, shutil.copytree(page.parent, tmp_path / "it's mine/report")):
        browser.get((report / page.name).as_uri())
        words = ["vibraverse", "refusals", "--results", str(report.parent), "--retry"]
        assert browser.find_element("id", "retry").text == shlex.join(words)
        assert not browser.find_element("id", "where").is_displayed()
    browser.get(page.as_uri())


def test_filters(browser):
    def shown(name="", material=""):
        return browser.execute_script(
            """
            const find = document.getElementById("find");
            find.value = arguments[0];
            document.querySelector(`.segments input[value="${arguments[1]}"]`).checked = true;
            find.dispatchEvent(new Event("input"));
            const visible = (element) => element.offsetParent !== null;
            return [[...document.querySelectorAll(".card")].filter(visible).map((card) => card.id),
              [...new Set([...document.querySelectorAll(".row")].filter(visible).map((row) => row.dataset.material))],
              document.getElementById("shown").textContent, visible(document.querySelector(".empty"))];
            """,
            name,
            material,
        )

    everything = ["ceramic", "glass", "wood", "steel"]
    assert shown("BALL") == [["ball-0000"], everything, "1 object", False]
    assert shown("", "wood") == [["ball-0000", "bar-0000"], ["wood"], "2 objects", False]
    assert shown("nothing like it") == [[], [], "0 objects", True]
    assert shown() == [["ball-0000", "bar-0000"], everything, "2 objects", False]


def test_pictures_turn_and_themes_switch(browser):
    before, after = browser.execute_script(
        """
        const card = document.getElementById("ball-0000"), turn = card.querySelector(".turn");
        card.querySelector(".looks input[value=clay]").click();
        turn.value = 2;
        turn.dispatchEvent(new Event("input"));
        const paper = () => getComputedStyle(document.body).backgroundColor;
        const light = paper();
        document.getElementById("theme").click();
        return [[light, card.querySelector(".view").src.slice(-11)], paper()];
        """
    )
    assert before[1] == "clay-02.png"
    assert before[0] != after


@pytest.mark.parametrize("width", [360, 768, 1280])
def test_nothing_sticks_out(browser, width):
    metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width


def test_no_request_leaves_the_disk_and_no_error_is_logged(browser):
    # Runs after the others, so it has seen all they did.
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 20
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
    assert browser.get_log("browser") == []


def test_the_page_names_nothing_outside_its_folder(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?://", text)
    assert str(page.parents[1]) not in text
    for name in re.findall(r'(?:src|href)="(assets/[^"]+)"', text):
        assert (page.parent / name).is_file(), name
    assert "<title>Things that ring</title>" in text


def test_an_empty_split_is_said(page):
    text = page.read_text(encoding="utf-8")
    assert re.search(
        r"<strong>Empty split</strong> The splits? [a-z ]+ holds? no object: take more objects", text
    )


def test_same_dataset_same_bytes(page):
    before = {path: products.sha256(path) for path in page.parent.rglob("*") if path.is_file()}
    make_products.report(page.parents[1], title="Things that ring")
    assert {path: products.sha256(path) for path in page.parent.rglob("*") if path.is_file()} == before


def test_objects_beyond_the_limit_are_counted(page, tmp_path):
    shutil.copytree(page.parents[1] / "dataset", tmp_path / "dataset")
    text = make_products.report(tmp_path, max_objects=1).read_text(encoding="utf-8")
    assert 'id="ball-0000"' in text
    assert 'id="bar-0000"' not in text
    assert "1 more object is in the dataset" in text


def test_a_silent_sound_says_why(page, tmp_path):
    shutil.copytree(page.parents[1] / "dataset", tmp_path / "dataset")
    with h5py.File(tmp_path / "dataset/shards/1.h5", "r+") as h5:
        h5["objects/bar-0000/solid/sounds/steel"][...] = 0.0
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    assert text.count("silent: no mode rings below 22.1\u202fkHz") == 1
    assert 'aria-label="Play steel, solid" disabled>' in text


def test_sounds_that_are_not_shown_are_counted_apart(page, tmp_path):
    shutil.copytree(page.parents[1] / "dataset", tmp_path / "dataset")
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
    assert "sampled materials, are" not in page.read_text(encoding="utf-8")


def test_warnings_about_meshes_are_counted_and_listed(page, tmp_path, vibraverse):
    table = {"layers": {"thin_share": 0.5, "median": 0.9}, "slivers": 3}
    said = cautions(table, 9000, 5000)
    assert [kind_of(sentence) for sentence in said] == ["thin_walls", "many_elements", "slivers"]
    assert not cautions({"layers": {"thin_share": 0.0, "median": 3}, "slivers": 0}, 5000, 5000)
    paths = make_products.make(tmp_path)
    for object_id, solidity, found in (
        ("ball-0000", "solid", said),
        ("bar-0000", "hollow", [*said[2:], *["What no version says."] * 25]),
    ):
        record = Path(paths.at(paths.tets_record, object=object_id, solidity=solidity))
        products.write_json(record, {**products.read_json(record), "warnings": found})
    make_products.index(tmp_path, make_products.pack(tmp_path))
    stated = products.read_json(paths.dataset_record)["warnings_by_kind"]
    assert stated == {"many_elements": 1, "other": 25, "slivers": 2, "thin_walls": 1}
    text = make_products.report(tmp_path).read_text(encoding="utf-8")
    section = text.partition('<section id="warnings">')[2].partition("</section>")[0]
    assert "2 of 3 meshes carry warnings" in section
    assert section.count("What no version says.") == 20
    assert "… and 5 more" in section
    assert '<h3>Some tetrahedra are nearly flat <span class="count">2</span></h3>' in section
    assert section.count(said[2]) == 2
    assert '<a href="#warnings">2</a>' in text
    assert 'id="warnings"' not in page.read_text(encoding="utf-8")
    status, out, _ = vibraverse("refusals", "--record", paths.dataset_record)
    assert status == 0
    assert "Warnings about meshes: 1 of many elements, 25 of other, 2 of slivers, 1 of thin walls" in out


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


def test_assets_replace_those_of_an_earlier_page(tmp_path):
    first = write_assets(tmp_path, {"a/b.txt": b"1"})
    assert write_assets(tmp_path, {"a/b.txt": b"1"}) == first
    (tmp_path / ".1.partial").mkdir()
    second = write_assets(tmp_path, {"a/b.txt": b"2"})
    assert first != second
    assert [path.name for path in tmp_path.iterdir()] == [second]
    assert (tmp_path / second / "a/b.txt").read_bytes() == b"2"


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
