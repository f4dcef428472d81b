"""The object view in a real browser, from disk: strike, hear, compare, isolate, share; and what goes wrong."""

from __future__ import annotations

import json
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import browsers
import page_files
from page_files import OBJECT
from page_views import OFFLINE, loudest_hz
from test_front import bundle, prefix  # noqa: F401
from vibraverse.report import library, shell

_SHELL = """<!doctype html><html lang="en" data-theme="light"><meta charset="utf-8"><title>x</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,"><link rel="stylesheet" href="page/style.css">
<link rel="stylesheet" href="page/object.css">
<main id="view"></main><p id="said" role="status"></p>{scripts}<script>route.start();</script></html>"""
REFUSED = {
    "stage": "clean",
    "reason": "not_a_solid",
    "message": "It bounds no volume.",
    "advice": "Close it.",
}


def write_page(report: Path, library_js: str) -> Path:
    """Write the scripts and styles of the object view beside the data, and a page that loads them."""
    page = report / "page"
    page.mkdir(parents=True)
    (page / "three.js").write_text(library_js)
    (page / "style.css").write_text(shell.text("style.css"))
    (page / "object.css").write_text(shell.text("page/object.css"))
    for name in library.SCRIPTS:
        (page / name).write_text(shell.text(f"page/{name}"))
    scripts = "".join(f'<script src="page/{name}"></script>' for name in ("three.js", *library.SCRIPTS))
    index = report / "index.html"
    index.write_text(_SHELL.format(scripts=scripts))
    return index


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return page_files.make(tmp_path_factory.mktemp("page") / "results")


@pytest.fixture(scope="module")
def index(results, bundle) -> Path:  # noqa: F811
    report = Path(results.page_object).parent.parent.parent
    objects = report / "data/objects"
    data = page_files.data(results)
    refused = {**data, "bodies": {}, "refused": {"solid": REFUSED, "hollow": REFUSED}}
    half = {**data, "bodies": {"solid": data["bodies"]["solid"]}, "refused": {"hollow": REFUSED}}
    for name, one in (("leaf", refused), ("half", half), ("harmed", data)):
        (objects / f"{name}.js").write_text(f'vibraverse.object("{name}", {json.dumps(one)});')
    (objects / "half.solid.js").write_text("vibraverse.body(")
    body = page_files.body(results, "solid")
    body["columns"]["data"] = body["columns"]["data"][: len(body["columns"]["data"]) // 2]
    (objects / "harmed.solid.js").write_text(f'vibraverse.body("harmed", "solid", {json.dumps(body)});')
    return write_page(report, bundle)


@pytest.fixture(scope="module")
def driver(index, tmp_path_factory):
    with browsers.opened(index, tmp_path_factory.mktemp("profile"), browsers.DRAWS) as opened:
        yield opened


def wait(driver, condition: str, seconds: float = browsers.PATIENCE_S):
    """Return the value of a JavaScript expression as soon as it is true."""
    end = time.monotonic() + seconds
    while not (found := driver.execute_script(f"return {condition};")):
        assert time.monotonic() < end, (condition, driver.get_log("browser"))
        time.sleep(0.1)
    return found


def go(driver, index: Path, address: str) -> None:
    """Open an address anew, and wait until its object or its failure is shown."""
    driver.get("about:blank")
    driver.get(f"{index.as_uri()}#/object/{address}")
    wait(driver, "document.querySelector('.object, .notice')")


def ready(driver, index: Path, settings: str = "") -> None:
    """Open the object, and wait until it can be struck."""
    go(driver, index, f"{OBJECT}?{settings}")
    wait(driver, "objectView.state && objectView.state.modelled")
    time.sleep(0.3)


def errors(driver) -> list[str]:
    """Return what the browser's console holds of errors, but those about files that a test left out."""
    return [one["message"] for one in driver.get_log("browser") if one["level"] == "SEVERE"]


def click(driver, x: float, y: float, to: tuple[float, float] | None = None) -> None:
    """Press on the model at a share of its size, and release there or elsewhere."""
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    canvas = driver.find_element(By.CSS_SELECTOR, ".stage canvas")
    size = canvas.size

    def at(share_x, share_y):
        return round((share_x - 0.5) * size["width"]), round((share_y - 0.5) * size["height"])

    chain = ActionChains(driver, duration=50).move_to_element_with_offset(canvas, *at(x, y)).click_and_hold()
    if to:
        chain = chain.move_to_element_with_offset(canvas, *at(*to))
    chain.release().perform()
    time.sleep(0.3)


def test_two_points_give_two_sounds_of_the_bodys_modes(driver, index, results):
    ready(driver, index, "material=steel")
    assert errors(driver) == []
    with h5py.File(results.at(results.modes, object=OBJECT, solidity="solid")) as h5:
        hz = h5["materials/steel/frequencies_hz"][()]
    heard = []
    for x, y in ((0.45, 0.6), (0.62, 0.42)):
        click(driver, x, y)
        assert driver.execute_script("return Boolean(objectView.state.choices.place);")
        heard.append(np.array(driver.execute_async_script(OFFLINE)))
        for one in loudest_hz(heard[-1], 3):
            assert np.abs(hz - one).min() < 1
    length = min(map(len, heard))
    alike = np.corrcoef(heard[0][:length], heard[1][:length])[0, 1]
    assert abs(alike) < 0.95
    assert errors(driver) == []


def test_a_drag_turns_and_strikes_nothing(driver, index):
    ready(driver, index)
    before = driver.execute_script("return [location.href, document.querySelector('.said').textContent];")
    click(driver, 0.45, 0.55, to=(0.6, 0.6))
    after = driver.execute_script("return [location.href, document.querySelector('.said').textContent];")
    assert after == before
    click(driver, 0.02, 0.02)  # beside the body
    assert driver.execute_script("return document.querySelector('.said').textContent;") == before[1]


def press(driver, *keys: str) -> None:
    from selenium.webdriver import ActionChains

    for key in keys:
        ActionChains(driver).send_keys(key).perform()
    time.sleep(0.4)


def test_the_keyboard_alone_strikes_and_compares(driver, index):
    from selenium.webdriver import ActionChains, Keys

    ready(driver, index, "material=steel")

    def tab_to(condition: str) -> None:
        for _ in range(45):
            ActionChains(driver).send_keys(Keys.TAB).perform()
            if driver.execute_script(f"const one = document.activeElement; return {condition};"):
                return
        pytest.fail(f"no tab stop where {condition}")

    status = "return document.querySelector('[role=status]').textContent;"
    tab_to("one.tagName === 'CANVAS'")
    press(driver, Keys.ARROW_RIGHT, Keys.ENTER)
    assert "Struck solid steel at" in driver.execute_script(status)
    press(driver, "h")
    wait(driver, "document.querySelector('[role=status]').textContent.includes('Struck hollow steel')")
    tab_to("one.name === 'body'")
    tab_to("one.textContent === 'Strike'")
    press(driver, Keys.ENTER)
    tab_to("one.closest('.places')")
    press(driver, Keys.ARROW_RIGHT, Keys.ENTER)
    assert driver.execute_script("return document.activeElement.closest('.places') !== null;")
    tab_to("one.name === 'material'")
    press(driver, Keys.ARROW_RIGHT)
    wait(driver, "document.querySelector('[role=status]').textContent.includes('Struck hollow wood')")
    tab_to("one.classList.contains('strip')")
    press(driver, Keys.HOME, Keys.ENTER)
    wait(driver, "document.querySelector('[role=status]').textContent.includes('mode 1 alone')")
    press(driver, Keys.ESCAPE)
    assert driver.execute_script("return objectView.state.choices.mode;") is None
    driver.execute_script("document.activeElement.blur();")
    driver.execute_script("document.querySelector('[role=status]').textContent = '';")
    press(driver, " ")
    assert "Struck" in driver.execute_script(status)


def test_a_mode_is_read_heard_alone_and_seen(driver, index):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    ready(driver, index, "material=steel")
    strip = driver.find_element(By.CSS_SELECTOR, ".strip")
    hz = driver.execute_script("return Array.from(objectView.state.found.hz);")
    place = np.log(hz[2] / 20) / np.log(22_050 / 20)
    offset = round((place - 0.5) * strip.size["width"])
    ActionChains(driver).move_to_element_with_offset(strip, offset, 0).perform()
    assert "mode 3" in driver.execute_script("return document.querySelector('.reading').textContent;")
    ActionChains(driver).click().perform()
    wait(driver, "document.querySelector('.said').textContent.includes('mode 3 alone')")
    samples = np.array(driver.execute_async_script(OFFLINE))
    assert loudest_hz(samples, 1)[0] == pytest.approx(hz[2], abs=1)
    assert "mode=3" in driver.current_url


@pytest.mark.parametrize(
    ("damping", "said"),
    [
        ("", "s all modes together have fallen by 60 dB."),
        ("&alpha=0.1&beta=0", "Sounds end after 1 s; this one rings on."),
    ],
)
def test_it_is_said_why_a_sound_ends(driver, index, damping, said):
    ready(driver, index, f"material=steel{damping}")
    driver.execute_script("document.querySelector('.again').click();")
    note = driver.execute_script("return document.querySelector('.spectrogram .note').textContent;")
    assert said in note.replace("\u202f", " ")


def test_a_link_opens_in_the_same_state(driver, index):
    settings = "body=hollow&material=wood&E=2e10&nu=0.3&size=0.1&contact=0.001&observable=velocity"
    settings += "&at=0.9,0.2,0.1&mode=2"
    ready(driver, index, settings)
    state = "const {place, ...rest} = objectView.state.choices; return [rest, place.position, location.hash];"
    first = driver.execute_script(state)
    assert (first[0]["solidity"], first[0]["name"], first[0]["mode"]) == ("hollow", "wood", 1)
    assert (first[0]["material"]["young"], first[0]["material"]["poisson"], first[0]["size"]) == (
        2e10,
        0.3,
        0.1,
    )
    driver.get("about:blank")
    driver.get(index.as_uri() + first[2])
    wait(driver, "objectView.state && objectView.state.modelled && objectView.state.choices.place")
    assert driver.execute_script(state) == first


def test_hostile_titles_are_texts(driver, index):
    ready(driver, index)
    assert driver.execute_script("return document.querySelector('h1').textContent;") == page_files.TITLE
    assert driver.execute_script("return document.querySelectorAll('h1 *').length;") == 0


def test_a_refused_object_says_why_and_what_to_do(driver, index):
    go(driver, index, "leaf")
    said = driver.execute_script("return document.querySelector('.object').textContent;")
    assert "Refused It bounds no volume. Close it." in said
    assert errors(driver) == []


@pytest.mark.parametrize("name", ["half", "harmed"])
def test_a_damaged_body_leaves_its_own_sounds(driver, index, name):
    go(driver, index, f"{name}?material=steel")
    wait(driver, "document.querySelector('.notices').textContent.includes('Striking anywhere does not work')")
    driver.execute_script("document.querySelector('.again').click();")
    assert "everywhere alike" in driver.execute_script("return document.querySelector('.said').textContent;")
    errors(driver)


def test_a_missing_object_says_so_and_others_work(driver, index):
    go(driver, index, "nowhere")
    assert "nowhere.js is missing" in driver.execute_script(
        "return document.querySelector('.notice').textContent;"
    )
    errors(driver)
    ready(driver, index)
    assert errors(driver) == []


def test_what_no_ear_hears_can_be_slowed_down(driver, index):
    ready(driver, index, "material=steel&size=0.01")
    assert "No ear hears this body" in driver.execute_script(
        "return document.querySelector('.notices').textContent;"
    )
    driver.execute_script("document.querySelector('.notices button').click();")
    wait(driver, "objectView.state.heard && objectView.state.heard.made.rendered > 0")
    assert "slower=10" in driver.current_url


def test_a_browser_without_audio_says_so(driver, index):
    stub = {"source": "delete window.AudioContext; delete window.webkitAudioContext;"}
    added = driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", stub)
    try:
        ready(driver, index)
        driver.execute_script("document.querySelector('.again').click();")
        said = driver.execute_script("return document.querySelector('.notices').textContent;")
        assert "This browser plays no sound. Save the WAV file" in said
        assert errors(driver) == []
    finally:
        driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)


def test_nothing_is_cut_off(driver, index):
    ready(driver, index, "material=steel&at=0.9,0.2,0.1")
    try:
        for width in (200, 360, 768, 1280):
            metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
            driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
            driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
            wide, nodes = driver.execute_script(
                "return [document.documentElement.scrollWidth, document.querySelectorAll('*').length];"
            )
            assert wide <= width
            assert nodes < 1500
            stops = driver.execute_script(
                "const seen = new Set(); let count = 0;"
                "for (const one of document.querySelectorAll('a, button, input, summary, [tabindex]')) {"
                "  if (one.tabIndex < 0 || one.disabled || !one.getClientRects().length) continue;"
                "  if (one.type === 'radio') { if (seen.has(one.name)) continue; seen.add(one.name); }"
                "  count += 1; } return count;"
            )
            assert stops <= 40
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_without_webgl_there_are_pictures_and_buttons(index, tmp_path):
    with browsers.opened(index, tmp_path, "--disable-3d-apis") as driver:
        go(driver, index, f"{OBJECT}?material=steel")
        wait(driver, "document.querySelector('.places').children.length > 10")
        said = driver.execute_script("return document.querySelector('.still').textContent;")
        assert "Strike with the buttons" in said
        top = "[...document.querySelectorAll('.places button')].find((one) => one.textContent === 'top')"
        driver.execute_script(f"{top}.click();")
        assert "Struck at top" in driver.execute_script("return document.querySelector('.said').textContent;")
        turn = "one.value = 4; one.dispatchEvent(new Event('input'));"
        driver.execute_script(f"const one = document.querySelector('.still input'); {turn}")
        found = driver.execute_script("return document.querySelector('.frame').style.backgroundPosition;")
        assert found == "50% 100%"
