"""Going about the page in a browser."""

from __future__ import annotations

import time

import numpy as np

#: Bounds for any view of any dataset.
NODES, TAB_STOPS = 1500, 40
#: A stand-in for the view of an object, and for sounds.
VIEW = """
route.add("object", {show(root, asked) {
  root.append(elements.make("h1", {tabindex: "-1"}, asked.subject), elements.make("p", {}, String(asked.settings)));
}});
"""
SOUND = """
const played = [];
Object.assign(sound, {unlock() { played.push("unlocked"); return true; },
  play(given) { played.push(given); return {stop() { played.push("stopped"); }}; }});
"""
TABS = """
return [...document.querySelectorAll("a[href], button, input, select, summary, [tabindex]")].filter((one) =>
  one.tabIndex >= 0 && !one.disabled && one.getClientRects().length).length;
"""

#: Renders what was heard last as the browser itself does, offline.
OFFLINE = """
  const done = arguments[arguments.length - 1];
  const {made, gain_db} = objectView.state.heard;
  const audio = new OfflineAudioContext(1, made.samples.length, made.rate);
  const buffer = audio.createBuffer(1, made.samples.length, made.rate);
  buffer.copyToChannel(Float32Array.from(made.samples, (one) => one * 10 ** (gain_db / 20)), 0);
  const source = audio.createBufferSource();
  source.buffer = buffer;
  source.connect(audio.destination);
  source.start();
  audio.startRendering().then((found) => done(Array.from(found.getChannelData(0))));
"""


def at(browser, address: str, page=None) -> None:
    """Go to an address within the page, or open ``page`` anew at it; wait until it is shown."""
    if page is not None:
        browser.get("about:blank")
        browser.get(page.as_uri() + address)
    else:
        browser.execute_script("location.hash = arguments[0]", address)
    wait(browser, "return document.querySelector('#view h1') !== null")
    browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")


def wait(browser, condition: str, seconds: float = 20):
    """Return what a script returns once that is true."""
    end = time.monotonic() + seconds
    while not (found := browser.execute_script(condition)):
        assert time.monotonic() < end, condition
        time.sleep(0.02)
    return found


def texts(browser, selector: str) -> list[str]:
    return browser.execute_script(
        "return [...document.querySelectorAll(arguments[0])].map((one) => one.textContent)", selector
    )


def resize(browser, width: int, height: int = 800) -> None:
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def loudest_hz(samples, count: int) -> np.ndarray:
    """Return the frequencies of the largest lines of a spectrum, interpolated."""
    padded = 16 * len(samples)
    spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), padded))
    inside = spectrum[1:-1]
    peaks = 1 + np.flatnonzero((inside > spectrum[:-2]) & (inside >= spectrum[2:]))
    return np.sort(peaks[np.argsort(spectrum[peaks])[-count:]]) * 44_100 / padded
