"""The page in Firefox, with its own rules for files and for sound: from disk, and over HTTP at a network address."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import firefox
import page_files
from browsers import served
from page_files import OBJECT
from page_views import OFFLINE, at, loudest_hz, texts, wait
from test_front import prefix  # noqa: F401
from vibraverse.report import library

MODELLED = "return Boolean(objectView.state && objectView.state.modelled)"
#: Keeps what the page makes to be heard with.
WATCH = """
const Real = AudioContext;
window.AudioContext = function (given) { return (window.heard = new Real(given)); };
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return page_files.make(tmp_path_factory.mktemp("page") / "results")


@pytest.fixture(scope="module")
def page(results, prefix):  # noqa: F811
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(library, "PREFIX", prefix)
        return page_files.page(results)


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    with firefox.opened(tmp_path_factory.mktemp("firefox")) as browser:
        yield browser


@pytest.fixture
def browser(started):
    """The one browser of these tests; what it logs is an error."""
    started.get("about:blank")
    started.errors.clear()
    started.asked.clear()
    yield started
    started.execute_script("return 0")  # events of all that went before have come
    assert started.errors == []


def strike(browser, x: float, y: float) -> np.ndarray:
    """Click the model at a share of its size; return the samples that are heard."""
    before = browser.execute_script("return document.querySelector('.said').textContent")
    browser.click(".stage canvas", x, y)
    wait(browser, f"return document.querySelector('.said').textContent !== {before!r}")
    assert browser.execute_script("return Boolean(objectView.state.choices.place)")
    return np.array(browser.execute_async_script(OFFLINE))


def test_a_body_from_disk_is_struck_and_heard(browser, page, results):
    """Two clicks give two sounds of the body's own modes; the first one wakes the audio, which nothing else may."""
    at(browser, f"#/object/{OBJECT}?material=steel", page)
    wait(browser, MODELLED)
    assert browser.execute_script(f"{WATCH} return new Real().state") == "suspended"
    with h5py.File(results.at(results.modes, object=OBJECT, solidity="solid")) as h5:
        hz = h5["materials/steel/frequencies_hz"][()]
    heard = [strike(browser, *place) for place in ((0.45, 0.6), (0.62, 0.42))]
    wait(browser, "return window.heard.state === 'running'")
    for samples in heard:
        for one in loudest_hz(samples, 3):
            assert np.abs(hz - one).min() < 1
    length = min(map(len, heard))
    assert abs(np.corrcoef(heard[0][:length], heard[1][:length])[0, 1]) < 0.95
    assert [url for url in browser.asked if not url.startswith(("file://", "data:"))] == []


def test_the_lists_from_disk(browser, page):
    at(browser, "#", page)
    assert texts(browser, "nav [aria-current]") == ["Overview"]
    at(browser, "#/explore?family=bell")
    assert texts(browser, ".count-line")[0].startswith("25 of 300 objects")
    browser.execute_script("document.querySelector('input[type=search]').focus()")
    browser.press(*"0003")
    wait(browser, "return location.hash.includes('q=0003')")
    assert texts(browser, ".grid .name") == ["A bell 37"]
    wait(browser, "return document.querySelectorAll('.grid .item').length === 1")
    for address in ("overview", "explore", "run"):
        at(browser, f"#/{address}")
        assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth"), address


def test_the_page_over_plain_http(browser, page):
    with served(page.parent) as address:
        browser.get(f"{address}/index.html#/explore?family=bell")
        wait(browser, "return document.querySelectorAll('.grid .item').length > 5")
        assert browser.execute_script("return isSecureContext") is False
        at(browser, f"#/object/{OBJECT}?material=glass")
        wait(browser, MODELLED)
        assert len(strike(browser, 0.5, 0.5)) > 1000
        assert [url for url in browser.asked if not url.startswith((address, "data:"))] == []
