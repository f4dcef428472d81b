"""A page in Firefox, driven by WebDriver BiDi over its own socket: Debian has no geckodriver.

The methods that tests share with Selenium have the same names.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from browsers import PATIENCE_S

FIREFOX = shutil.which("firefox") or shutil.which("firefox-esr")
DISPLAY = shutil.which("Xvfb")  # without any display, Firefox has no WebGL
#: What differs from the settings of a user. ``remote.prefs.recommended`` would relax the rules for files and for sound,
#: which are what these tests are about; so the little that a test needs of it stands here.
SETTINGS = {
    "remote.prefs.recommended": False,
    "app.normandy.enabled": False,
    "app.update.disabledForTesting": True,
    "browser.aboutwelcome.enabled": False,
    "browser.safebrowsing.update.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.page": 0,
    "datareporting.policy.dataSubmissionEnabled": False,
    "extensions.getAddons.cache.enabled": False,
    "extensions.systemAddon.update.enabled": False,
    "media.cubeb.force_mock_context": True,  # a sound card, where there is none
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "services.settings.server": "data:,",
    "toolkit.telemetry.enabled": False,
    "webgl.force-enabled": True,  # without a graphics card
}
_EVENTS = ["log.entryAdded", "network.beforeRequestSent"]


class Firefox:
    """The one tab of a running Firefox. ``errors`` and ``asked`` hold what was logged and requested so far."""

    def __init__(self, socket):
        self._socket = socket
        self._number = 0
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.command("session.new", capabilities={})
        (tab,) = self.command("browsingContext.getTree")["contexts"]
        self._tab = tab["context"]
        self.command("session.subscribe", events=_EVENTS, contexts=[self._tab])

    def command(self, method: str, **parameters) -> dict:
        """Send a command of the protocol, note the events before its answer, and return that."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (said := json.loads(self._socket.recv())).get("id") != self._number:
            self._note(said)
        assert said["type"] == "success", said
        return said["result"]

    def _note(self, event: dict) -> None:
        about = event.get("params", {})
        if event.get("method") == "log.entryAdded" and about["level"] in ("error", "warn"):
            self.errors.append(about["text"])
        elif event.get("method") == "network.beforeRequestSent":
            self.asked.append(about["request"]["url"])

    def get(self, address: str) -> None:
        self.command("browsingContext.navigate", context=self._tab, url=address, wait="complete")

    def execute_script(self, script: str, *given):
        return self._call(
            f"(...given) => JSON.stringify((function () {{ {script} }})(...given)) ?? 'null'", given
        )

    def execute_async_script(self, script: str, *given):
        body = f"new Promise((done) => (function () {{ {script} }})(...given, done))"
        return self._call(f"async (...given) => JSON.stringify(await {body}) ?? 'null'", given)

    def _call(self, function: str, given):
        target, values = {"context": self._tab}, json.dumps(given)
        found = self.command(
            "script.evaluate", target=target, awaitPromise=True, expression=f"({function})(...{values})"
        )
        assert found["type"] == "success", found["exceptionDetails"]["text"]
        return json.loads(found["result"]["value"])

    def resize(self, width: int, height: int) -> None:
        self.command(
            "browsingContext.setViewport", context=self._tab, viewport={"width": width, "height": height}
        )

    def click(self, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """Press and release at a share of an element's size, as a hand does."""
        left, top, width, height = self.execute_script(
            "const one = document.querySelector(arguments[0]); one.scrollIntoView({block: 'center'});"
            "const box = one.getBoundingClientRect(); return [box.left, box.top, box.width, box.height];",
            selector,
        )
        place = {"x": round(left + x * width), "y": round(top + y * height)}
        steps = [
            {"type": "pointerMove", **place},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerUp", "button": 0},
        ]
        self._act({"type": "pointer", "id": "mouse", "actions": steps})

    def press(self, *keys: str) -> None:
        steps = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        self._act({"type": "key", "id": "keyboard", "actions": steps})

    def _act(self, source: dict) -> None:
        self.command("input.performActions", context=self._tab, actions=[source])


@contextmanager
def opened(folder: Path) -> Iterator[Firefox]:
    """Start Firefox with an empty profile; the test is skipped where it, or a display to draw models on, is missing."""
    if not (FIREFOX and DISPLAY):
        pytest.skip("Firefox or a display for it is not installed (apt-get install firefox-esr xvfb)")
    from websocket import create_connection

    profile = folder / "profile"
    profile.mkdir()
    lines = (f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in SETTINGS.items())
    (profile / "user.js").write_text("\n".join(lines))
    words = [
        "--headless",
        "--no-remote",
        "--profile",
        str(profile),
        "--remote-debugging-port",
        "0",
        "about:blank",
    ]
    with ExitStack() as stack:
        number = stack.enter_context(_running([DISPLAY, "-displayfd", "1"], folder / "display", r"(\d+)\n"))
        found = _running(
            [FIREFOX, *words], folder / "firefox", r"listening on (ws://\S+)", DISPLAY=f":{number}"
        )
        address = stack.enter_context(found)
        socket = create_connection(f"{address}/session", timeout=PATIENCE_S, suppress_origin=True)
        stack.callback(socket.close)
        yield Firefox(socket)


@contextmanager
def _running(words: list[str], log: Path, pattern: str, **environment: str) -> Iterator[str]:
    """Run a program; yield what it says after ``pattern`` once it is ready, and end it afterwards."""
    with log.open("w") as said:
        process = subprocess.Popen(words, stdout=said, stderr=said, env={**os.environ, **environment})
    try:
        end = time.monotonic() + PATIENCE_S
        while not (found := re.search(pattern, log.read_text(errors="replace"))):
            assert process.poll() is None, log.read_text(errors="replace")
            assert time.monotonic() < end, log.read_text(errors="replace")
            time.sleep(0.05)
        yield found[1]
    finally:
        process.terminate()
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
