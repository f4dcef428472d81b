"""Every view of the page, in both themes, wide and narrow: axe-core finds nothing serious or critical."""

from __future__ import annotations

import pytest

import browsers
import page_files
from accessible import faults
from page_files import OBJECT
from page_views import at, resize, wait
from test_front import prefix  # noqa: F401
from vibraverse.report import library

RUN = tuple(f"run?part={part}" for part in ("refusals", "warnings", "validation", "making"))


@pytest.fixture(scope="module")
def page(prefix, tmp_path_factory):  # noqa: F811
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(library, "PREFIX", prefix)
        return page_files.page(page_files.make(tmp_path_factory.mktemp("page") / "results"))


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    with browsers.opened(page, tmp_path_factory.mktemp("chromium"), browsers.DRAWS) as driver:
        yield driver


@pytest.fixture(params=["light", "dark"])
def theme(request, browser, page):
    at(browser, "#/overview", page)
    if browser.execute_script("return document.documentElement.dataset.theme") != request.param:
        browser.execute_script("document.querySelector('#theme').click()")
    yield request.param
    resize(browser, 1280)


@pytest.mark.parametrize("width", [360, 1280])
def test_lists_are_accessible(browser, theme, width):
    resize(browser, width)
    for address in ("overview", "explore", "explore?state=refused", "explore?q=nothing+like+it", *RUN):
        at(browser, f"#/{address}")
        assert faults(browser) == [], address


@pytest.mark.parametrize("width", [360, 1280])
def test_an_object_is_accessible(browser, theme, width):
    resize(browser, width)
    at(browser, f"#/object/{OBJECT}?material=steel&at=0.9,0.2,0.1&mode=2&size=0.01")
    wait(browser, "return Boolean(objectView.state && objectView.state.modelled)")
    browser.execute_script("document.querySelector('.again').click()")
    for details in ("false", "true"):
        browser.execute_script(
            f"document.querySelectorAll('details').forEach((one) => (one.open = {details}))"
        )
        assert faults(browser) == [], details


def test_a_fault_would_be_found(browser, page):
    at(browser, "#/explore", page)
    browser.execute_script("document.querySelector('#view').append(document.createElement('button'))")
    (found,) = faults(browser)
    assert found.startswith("button-name")
