"""What axe-core finds wrong with a page, in the browser that shows it."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
_RUN = """
const done = arguments[arguments.length - 1];
axe.run(document, {resultTypes: ["violations"]}).then(({violations}) => done(
  violations.filter((one) => ["serious", "critical"].includes(one.impact)).flatMap(({id, help, nodes}) =>
    nodes.map((node) => `${id}: ${help}: ${node.target}: ${node.html} ${node.failureSummary}`))));
"""


def faults(driver) -> list[str]:
    """Return the serious and critical faults of the page as it is; the test is skipped where npm is not reached."""
    if not driver.execute_script("return window.axe !== undefined"):
        driver.execute_script(_axe())
    return driver.execute_async_script(_RUN)


@cache
def _axe() -> str:
    """Return the script of axe-core, from the locked packages of the tests."""
    spec = importlib.util.spec_from_file_location("front", ROOT / "envs/front.py")
    front = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(front)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "packages"
        shutil.copytree(ROOT / "tests/packages", folder)
        try:
            front.packages(front.node(Path(name)), folder)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"npm reaches no registry ({error})")
        return (folder / "node_modules/axe-core/axe.min.js").read_text(encoding="utf-8")
