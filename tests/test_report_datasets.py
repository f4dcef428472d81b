"""The page in a browser for datasets of any size and kind, damaged ones included, from disk and over plain HTTP."""

from __future__ import annotations

import shutil

import pytest

import make_page
from browsers import opened, served
from page_views import NODES, SOUND, TAB_STOPS, TABS, VIEW, at, texts, wait


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chromium")
    nothing = folder / "nothing.html"
    nothing.write_text('<!doctype html><title>nothing</title><link rel="icon" href="data:,">')
    with opened(nothing, folder / "profile") as driver:
        yield driver


@pytest.fixture
def browser(chromium):
    """The one browser of these tests, with nothing in it and nothing in its log."""
    chromium.get("about:blank")
    chromium.get_log("browser")
    return chromium


@pytest.mark.parametrize("refused", [None, 9000])
def test_ten_thousand_objects_are_listed_and_filtered(browser, tmp_path, refused):
    count = 10_000
    page = make_page.write(tmp_path / "report", make_page.invented(count, refused), VIEW)
    browser.get(page.as_uri() + "#/explore")
    wait(browser, "return document.querySelector('.grid li') !== null")
    shown, chosen = browser.execute_async_script(
        """
        const shown = performance.now(), select = document.querySelector("select[name=family]");
        select.value = "bell";
        select.dispatchEvent(new Event("change"));
        requestAnimationFrame(() => requestAnimationFrame(() => arguments[0]([shown, performance.now() - shown])));
        """
    )
    print(f"{count} objects, {refused} refused: first seen after {shown:.0f} ms, filtered in {chosen:.0f} ms")
    assert chosen < 20_000
    for address in ("explore", "overview", "run", "run?part=warnings"):
        at(browser, f"#/{address}")
        assert browser.execute_script("return document.querySelectorAll('*').length") <= NODES, address
        assert browser.execute_script(TABS) <= TAB_STOPS, address
    at(browser, "#/explore")
    browser.execute_script("scrollTo({top: 1e9, behavior: 'instant'})")
    wait(browser, f"return document.querySelector('.grid li:last-child').ariaPosInSet === '{count}'")
    assert browser.get_log("browser") == []


def test_a_published_set_opens_on_its_objects_and_says_how_to_use_it(browser, tmp_path):
    card = {
        "name": "Bells",
        "licence": "CC-BY-4.0",
        "creators": ["A. Ringer"],
        "url": "https://example.org/bells",
    }
    page = make_page.write(tmp_path / "report", make_page.invented(50), kind="dataset", card=card)
    at(browser, "#", page)
    assert browser.execute_script("return document.documentElement.dataset.view") == "explore"
    at(browser, "#/overview")
    said = " ".join(texts(browser, "#view"))
    assert all(
        text in said for text in ("CC-BY-4.0", "A. Ringer", "https://example.org/bells", "vibraverse.dataset")
    )
    at(browser, "#/run?part=refusals")
    assert str(tmp_path) not in browser.page_source
    assert "--retry" not in browser.page_source


def test_an_empty_dataset_says_so(browser, tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(4, 4), VIEW)
    at(browser, "#", page)
    assert len(texts(browser, ".gone")) == 0
    assert "4" in texts(browser, ".tiles dd")
    at(browser, "#/explore")
    assert len(texts(browser, ".gone")) == 4
    assert browser.get_log("browser") == []


@pytest.mark.parametrize("damage", [None, "vibraverse.index({", ""])
def test_a_damaged_index_is_said(browser, tmp_path, damage):
    page = make_page.write(tmp_path / "report", make_page.invented(20), VIEW)
    (index,) = page.parent.glob("page/*/index.js")
    if damage is None:
        index.unlink()
    else:
        index.write_text(damage)
    browser.get(page.as_uri())
    text = wait(browser, "return document.querySelector('#view [role=alert]')?.textContent")
    assert "The list of objects cannot be shown" in text
    assert ("is missing" if damage is None else "is damaged") in text


def test_an_object_whose_file_is_missing_leaves_the_others(browser, tmp_path):
    """The thumbnails' sheet is missing, too: the list works without pictures."""
    page = make_page.write(tmp_path / "report", make_page.invented(30), VIEW + SOUND)
    next(page.parent.glob("page/*/thumbs-0.webp")).unlink()
    at(browser, "#/explore?state=made", page)
    browser.find_element("css selector", ".tools .quiet").click()
    browser.execute_script("document.querySelector('.grid .item').focus()")
    said = wait(browser, "return document.querySelector('#said').textContent")
    assert "is missing: copy the whole folder of the page" in said
    assert len(texts(browser, ".grid .item")) > 5


def test_forbidden_storage_takes_nothing_away(browser, tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(20), VIEW)
    forbid = "Object.defineProperty(window, 'localStorage', {get() { throw new DOMException('no'); }});"
    added = browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": forbid})
    try:
        at(browser, "#/explore", page)
        browser.refresh()
        at(browser, "#/explore")
        before = browser.execute_script("return document.documentElement.dataset.theme")
        browser.execute_script("document.querySelector('#theme').click()")
        assert browser.execute_script("return document.documentElement.dataset.theme") != before
        assert browser.get_log("browser") == []
    finally:
        browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)


def test_the_page_works_over_plain_http(browser, tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(300), VIEW)
    with served(page.parent) as address:
        browser.get(f"{address}/index.html#/explore?family=bell")
        wait(browser, "return document.querySelectorAll('.grid .item').length > 5")
        assert browser.execute_script("return isSecureContext") is False
        assert texts(browser, ".count-line")[0].startswith("25 of 300 objects")
        at(browser, "#/run?part=refusals")
        assert texts(browser, "#retry") == ["vibraverse refusals --results RESULTS --retry"]
        assert browser.get_log("browser") == []


def test_a_page_that_was_copied_works_as_it_did(browser, tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(40), VIEW)
    copy = shutil.copytree(page.parent, tmp_path / "elsewhere")
    at(browser, "#/explore?q=bell-0003", copy / "index.html")
    assert texts(browser, ".grid .name") == ["A bell 37"]
