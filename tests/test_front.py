"""What pages consist of: made small from locked packages, the same bytes each time, or done without."""

from __future__ import annotations

import gzip
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from scripts import node
from vibraverse.report import assembly, library, shell

ROOT = Path(__file__).resolve().parent.parent
FRONT = ROOT / "workflow/vibraverse/report/front"


def load_front():
    spec = importlib.util.spec_from_file_location("front", ROOT / "envs/front.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


front = load_front()


@pytest.fixture(scope="session")
def prefix(tmp_path_factory) -> Path:
    """The environment, or another folder with what pages consist of; the test is skipped where npm is not reached."""
    own = Path(sys.prefix)
    found = own if front.up_to_date(own) else tmp_path_factory.mktemp("prefix")
    front.main(found)
    if not front.up_to_date(found):
        pytest.skip("npm reaches no registry")
    return found


@pytest.fixture
def front_made(prefix, monkeypatch) -> None:
    """Pages consist of what was made, even if the environment lacks it."""
    monkeypatch.setattr(library, "PREFIX", prefix)


@pytest.fixture(scope="session")
def bundle(prefix) -> str:
    return (prefix / front.SHARE / front.BUNDLE).read_text(encoding="utf-8")


def test_two_builds_have_the_same_bytes(prefix, bundle, tmp_path):
    node()
    front.main(tmp_path)
    first, second = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (prefix / front.SHARE, tmp_path / front.SHARE)
    )
    assert first == second
    assert len(first) == 2 + len(front.OWN)
    assert len(bundle) < 700_000
    assert "SPDX-License-Identifier: MIT" in bundle


def test_the_bundle_exports_what_scripts_use_and_no_more(bundle, tmp_path):
    program = f"{bundle}; process.stdout.write(JSON.stringify(Object.keys(three)));"
    (tmp_path / "run.js").write_text(program)
    done = subprocess.run([node(), tmp_path / "run.js"], capture_output=True, text=True, check=True)
    scripts = "".join(shell.text(f"page/{name}") for name in library.SCRIPTS)
    assert set(json.loads(done.stdout)) == set(re.findall(r"\bthree\.(\w+)", scripts))


def made_by_hand(folder: Path) -> None:
    share = folder / front.SHARE
    (share / front.SMALL).mkdir(parents=True)
    (share / front.BUNDLE).write_text("var three = {};")
    (share / front.STAMP).write_text(front.checksum())


def test_it_is_built_once(tmp_path, monkeypatch):
    made_by_hand(tmp_path)
    monkeypatch.setattr(front, "build", lambda *_: pytest.fail("built again"))
    front.main(tmp_path)
    monkeypatch.setattr(library, "PREFIX", tmp_path)
    assert library.bundle() == "var three = {};"


def test_where_npm_is_not_reached_one_sentence_says_so(tmp_path, monkeypatch, capfd):
    node()
    monkeypatch.setenv("NPM_CONFIG_REGISTRY", "http://127.0.0.1:9/")
    monkeypatch.setenv("NPM_CONFIG_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NPM_CONFIG_FETCH_RETRIES", "0")
    prefix = tmp_path / "venv"
    front.main(prefix)
    said = capfd.readouterr().err
    start = "Pages will carry their scripts as they are written"
    assert said.startswith(f"{start} and show pictures in place of models that turn, because npm's packages")
    assert said.count("\n") == 1
    monkeypatch.setattr(library, "PREFIX", prefix)
    assert library.bundle() is None
    assert library.small("page/main.js") == shell.text("page/main.js")
    # What an environment has of before stays in use.
    made_by_hand(prefix)
    (prefix / front.SHARE / front.STAMP).write_text("of other sources")
    front.main(prefix)
    assert capfd.readouterr().err.startswith(f"{start}, because npm's packages")
    assert library.bundle() == "var three = {};"


def test_an_image_gets_what_its_builder_has(tmp_path, monkeypatch):
    made_by_hand(tmp_path / "project")
    monkeypatch.setattr(front, "PROJECT", tmp_path / "project")
    monkeypatch.setattr(front, "build", lambda *_: pytest.fail("built"))
    made_by_hand(tmp_path / "venv")
    (tmp_path / "venv" / front.SHARE / front.STAMP).write_text("of other sources")
    (tmp_path / "venv" / front.SHARE / front.SMALL / "old.js").touch()
    front.main(tmp_path / "venv")
    assert front.up_to_date(tmp_path / "venv")
    assert not list((tmp_path / "venv" / front.SHARE / front.SMALL).iterdir())


@pytest.mark.parametrize("folder", [FRONT, ROOT / "tests/packages"], ids=["page", "tests"])
def test_the_lock_holds_hashes_and_no_address(folder):
    locked = json.loads((folder / "package-lock.json").read_text())["packages"]
    asked = json.loads((folder / "package.json").read_text())
    packages = {name: one for name, one in locked.items() if name}
    assert all(one["integrity"].startswith("sha512-") for one in packages.values())
    assert all("resolved" not in one for one in packages.values())
    assert not re.search(r"https?://(?!opencollective)", "".join(p.read_text() for p in folder.iterdir()))
    for name, version in {**asked.get("dependencies", {}), **asked["devDependencies"]}.items():
        assert packages[f"node_modules/{name}"]["version"] == version


def test_the_pages_own_code_is_small(front_made):
    """All that a page's folder gets but the library and data; and what a server sends of it, compressed."""
    texts = [library.small(path) for path in (*assembly.SCRIPTS, *assembly.STYLES)]
    assert sum(len(text.encode()) for text in texts) < 115_000
    assert len(gzip.compress("".join(texts).encode())) < 40_000


def test_the_pages_own_code_as_it_is_written_does_not_grow():
    texts = [shell.text(path) for path in (*assembly.SCRIPTS, *assembly.STYLES)]
    assert sum(len(text.encode()) for text in texts) < 210_000


def test_a_script_that_was_changed_is_not_taken_for_what_was_made(front_made, monkeypatch):
    written = shell.text("page/main.js")
    assert len(library.small("page/main.js")) < len(written)
    monkeypatch.setattr(shell, "text", lambda name: f"{written}// changed")
    assert library.small("page/main.js") == f"{written}// changed"
