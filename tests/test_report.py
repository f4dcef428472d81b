"""The report in a browser: it opens from disk, shows, plays and lists everything, and needs no network."""

from __future__ import annotations

import json
import shlex
import shutil

import numpy as np
import pytest
import soundfile

import make_products
from browsers import opened


@pytest.fixture(scope="module")
def browser(report_page, tmp_path_factory):
    with opened(report_page, tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


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


def test_every_sound_loads_with_its_length_and_plays(browser, report_page):
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


def test_the_advised_command_names_the_folder_that_the_page_lies_in(browser, report_page, tmp_path):
    assert "vibraverse refusals --results RESULTS --retry" in report_page.read_text(encoding="utf-8")
    for report in (report_page.parent, shutil.copytree(report_page.parent, tmp_path / "it's mine/report")):
        browser.get((report / report_page.name).as_uri())
        words = ["vibraverse", "refusals", "--results", str(report.parent), "--retry"]
        assert browser.find_element("id", "retry").text == shlex.join(words)
        assert not browser.find_element("id", "where").is_displayed()
    browser.get(report_page.as_uri())


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
def test_nothing_overflows_the_page(browser, width):
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
