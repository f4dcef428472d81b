"""A page in Chromium, which logs what it asks for and what goes wrong."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

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


#: How long a busy machine may take for one step.
PATIENCE_S = 300
#: Lets Chromium draw models without a graphics card.
DRAWS = "--enable-unsafe-swiftshader"


@contextmanager
def opened(page: Path, profile: Path, *more: str) -> Iterator:
    """Open a page; yield the driver. The test is skipped where there is no browser. ``more`` are flags."""
    if not (CHROMIUM and DRIVER):
        pytest.skip("Chromium and its driver are not installed (apt-get install chromium chromium-driver)")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, "--window-size=1280,900", f"--user-data-dir={profile}", *more):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service(DRIVER))
    try:
        driver.command_executor.client_config.timeout = PATIENCE_S
        driver.set_script_timeout(PATIENCE_S)
        driver.get("about:blank")
        driver.get_log("performance")  # what the browser's own start page asked for
        driver.get(page.as_uri())
        yield driver
    finally:
        driver.quit()
