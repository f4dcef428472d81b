"""What the tests of the page of learning share; each file has its own ``made``, the results and their page."""

from __future__ import annotations

import pytest
from read_page import Page

from browsers import opened
from vibraverse.contract import products


@pytest.fixture(scope="module")
def page(made) -> Page:
    return Page(made.page.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def rows(made) -> list[dict]:
    return products.read_json(made.folder / "learn/results.json")["rows"]


@pytest.fixture(scope="module")
def browser(made, tmp_path_factory):
    with opened(made.page, tmp_path_factory.mktemp("chromium")) as driver:
        yield driver
