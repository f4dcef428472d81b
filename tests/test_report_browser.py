"""The page in a browser, from disk and over plain HTTP: it lists, filters and counts, and survives what is damaged."""

from __future__ import annotations

import contextlib
import functools
import http.server
import json
import shlex
import shutil
import socket
import threading
import time

import pytest

import make_page
from browsers import opened

#: Bounds for any view of any dataset.
NODES, TAB_STOPS = 1500, 40
NASTY = "</script><b id='broken'>\u2028\u202eליס"
#: A stand-in for the view of an object, and for sounds.
VIEW = """
route.add("object", {show(root, asked) {
  root.append(elements.make("h1", {tabindex: "-1"}, asked.subject), elements.make("p", {}, String(asked.settings)));
}});
"""
SOUND = """
const played = [];
const sound = {unlock() { played.push("unlocked"); return true; },
  play(given) { played.push(given); return {stop() { played.push("stopped"); }}; }};
"""
TABS = """
return [...document.querySelectorAll("a[href], button, input, select, summary, [tabindex]")].filter((one) =>
  one.tabIndex >= 0 && !one.disabled && one.getClientRects().length).length;
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A page of 300 objects, one of them with a hostile title."""
    given = make_page.invented(300)
    for one in given["items"]:
        if one["object"] == "bell-0003":
            one["title"] = NASTY
    folder = tmp_path_factory.mktemp("page") / "it's mine/report"
    return make_page.write(folder, given, VIEW + SOUND, make_page.validation())


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    with opened(page, tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


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


def test_a_run_opens_on_what_happened(browser, page):
    at(browser, "#", page)
    assert browser.execute_script("return document.documentElement.dataset.view") == "overview"
    counts = dict(zip(texts(browser, ".tiles dt"), texts(browser, ".tiles dd"), strict=True))
    assert counts["objects"] == "270"
    reasons = texts(browser, ".panels .panel:first-child .named .what")
    assert "The shape bounds no volume" in reasons
    assert texts(browser, "nav [aria-current]") == ["Overview"]
    assert len(texts(browser, ".picked a")) == 10


def test_a_bar_of_a_plot_is_a_filter(browser, page):
    """The number in the bar's label is the number of objects that the link leads to, for plots of single bodies."""
    at(browser, "#/overview?material=steel", page)
    bars = browser.execute_script(
        """
        return [...document.querySelectorAll(".plot:first-child .bar")].map((one) =>
          [one.getAttribute("href"), one.getAttribute("aria-label")]);
        """
    )
    href, _ = max(bars, key=lambda one: len(one[1]))
    assert "material=steel" in href
    at(browser, href)
    low, high = map(float, href.split("f1=")[1].split("&")[0].split(".."))
    pitches = browser.execute_script(
        """
        const shelf = catalogue.read(arguments[0]);
        return shelf.entries.filter((one) => Object.values(one.bodies).some((body) =>
          body.f1[2] >= arguments[1] && body.f1[2] <= arguments[2])).length;
        """,
        browser.execute_async_script("vibraverse.loadIndex().then(arguments[0])"), low, high,
    )  # fmt: skip
    assert pitches > 0
    assert texts(browser, ".count-line")[0].startswith(f"{pitches} of 300 objects")
    assert texts(browser, ".chip bdi")[0].startswith("Lowest frequency: ")


def test_filters_are_in_the_address_and_come_back_from_it(browser, page):
    at(browser, "#/explore", page)
    assert texts(browser, ".count-line")[0].startswith("300 objects, ")
    browser.execute_script(
        """
        const select = document.querySelector("select[name=family]");
        select.value = "bell";
        select.dispatchEvent(new Event("change"));
        """
    )
    assert texts(browser, ".count-line")[0].startswith("25 of 300 objects")
    assert browser.execute_script("return location.hash") == "#/explore?family=bell"
    find = browser.find_element("css selector", "input[type=search]")
    find.send_keys("0003")
    wait(browser, "return location.hash.includes('q=0003')")
    assert texts(browser, ".grid .name") == [NASTY]
    address = browser.execute_script("return location.hash")
    at(browser, address, page)
    assert texts(browser, ".grid .name") == [NASTY]
    assert texts(browser, ".chip bdi") == ["“0003”", "bell"]
    browser.execute_script("document.querySelector('.chip').click()")
    assert len(texts(browser, ".grid .name")) > 5


def test_hostile_titles_are_texts(browser, page):
    at(browser, "#/explore?q=bell-0003", page)
    assert texts(browser, ".grid .name") == [NASTY]
    assert browser.execute_script("return document.getElementById('broken')") is None


def test_nothing_fits_and_all_come_back(browser, page):
    at(browser, "#/explore?q=nothing+like+it", page)
    assert browser.find_element("css selector", ".empty").is_displayed()
    browser.find_element("css selector", ".empty button").click()
    assert texts(browser, ".count-line")[0].startswith("300 objects")
    assert not browser.find_element("css selector", ".empty").is_displayed()


def test_a_refused_object_says_why_and_what_to_do(browser, page):
    at(browser, "#/explore?state=refused%3A+not_a_solid", page)
    (text,) = set(texts(browser, ".gone b"))
    assert text == "The shape bounds no volume"
    assert all(make_page.ADVICE in text for text in texts(browser, ".gone .why"))


def test_the_keyboard_alone_finds_and_opens_an_object(browser, page):
    from selenium.webdriver.common.keys import Keys

    resize(browser, 1280)
    at(browser, "#/explore?state=made", page)
    active = browser.switch_to.active_element
    active.send_keys("/")
    assert browser.execute_script("return document.activeElement.type") == "search"
    for _ in range(TAB_STOPS):
        browser.switch_to.active_element.send_keys(Keys.TAB)
        if browser.execute_script("return document.activeElement.classList.contains('item')"):
            break
    place = "return Number(document.activeElement.parentElement.getAttribute('aria-posinset'))"
    columns = browser.execute_script(
        "const tops = [...document.querySelectorAll('.grid li')].map((one) => one.getBoundingClientRect().top);"
        "return tops.filter((one) => one === tops[0]).length;"
    )
    assert browser.execute_script(place) == 1
    for key, expected in (
        (Keys.ARROW_RIGHT, 2), (Keys.ARROW_DOWN, 2 + columns), (Keys.ARROW_UP, 2), (Keys.END, 270), (Keys.HOME, 1),
        (Keys.ARROW_LEFT, 1), (Keys.ARROW_RIGHT, 2),
    ):  # fmt: skip
        browser.switch_to.active_element.send_keys(key)
        assert browser.execute_script(place) == expected
    name = browser.execute_script("return document.activeElement.getAttribute('href')")
    browser.switch_to.active_element.send_keys(Keys.ENTER)
    wait(browser, "return document.documentElement.dataset.view === 'object'")
    assert browser.execute_script("return location.hash") == name
    # A reader's place is the heading of what came.
    assert browser.execute_script("return document.activeElement.tagName") == "H1"


def test_the_list_comes_back_where_it_was(browser, page):
    at(browser, "#/explore", page)
    browser.execute_script("scrollTo({top: 4000, behavior: 'instant'})")
    wait(browser, "return [...document.querySelectorAll('.grid li')].some((one) => one.ariaPosInSet > 80)")
    at(browser, "#/object/bar-0001")
    browser.back()
    wait(browser, "return document.documentElement.dataset.view === 'explore'")
    assert browser.execute_script("return scrollY") == pytest.approx(4000, abs=2)
    browser.execute_script("document.querySelector('select[name=family]').value = 'bell'")
    browser.execute_script("document.querySelector('select[name=family]').dispatchEvent(new Event('change'))")
    assert browser.execute_script("return scrollY") == 0


def test_the_tab_key_comes_back_to_the_object_that_one_left(browser, page):
    at(browser, "#/explore", page)
    browser.execute_script("document.querySelectorAll('.grid .item')[7].focus()")
    name = browser.execute_script("return document.activeElement.getAttribute('href')")
    at(browser, name)
    browser.back()
    wait(browser, "return document.documentElement.dataset.view === 'explore'")
    stops = "return [...document.querySelectorAll('.item[tabindex=\"0\"]')].map((one) => one.getAttribute('href'))"
    assert browser.execute_script(stops) == [name]


def test_only_what_is_in_sight_is_in_the_document(browser, page):
    resize(browser, 1280)
    at(browser, "#/explore", page)
    for top in (0, 2000, 5000, 100_000):
        browser.execute_script("scrollTo({top: arguments[0], behavior: 'instant'})", top)
        browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
        seen = browser.execute_script(
            """
            const boxes = [...document.querySelectorAll(".grid li")].map((one) => one.getBoundingClientRect());
            const list = document.querySelector(".grid").getBoundingClientRect();
            const covered = boxes.filter((box) => box.bottom > 0 && box.top < innerHeight).length;
            return [boxes.length, covered, list.bottom];
            """
        )
        assert seen[0] < 60
        assert seen[1] >= 3


def test_objects_sound_on_hover_after_a_switch(browser, page):
    """From the object's own file: its first mode at 440 Hz is the strongest line of what is played."""
    folder = page.parent / "data/objects"
    folder.mkdir(parents=True, exist_ok=True)
    body = {
        "modes": {name: {"hz": [440.0, 1500.0], "error": [0, 0], "mass_kg": 1} for name in make_page.NAMES}
    }
    data = {
        "bodies": {"solid": body},
        "materials": {name: {"alpha": 6.0, "beta": 1e-7} for name in make_page.NAMES},
        "audio": {"sample_rate_hz": 44_100, "decay_db": 60, "max_s": 1, "contact_s": 0, "observable": "displacement"},
    }  # fmt: skip
    at(browser, "#/explore?state=made", page)
    first = browser.execute_script("return document.querySelector('.grid .item').getAttribute('href')")
    name = first.split("/")[2].split("?")[0]
    (folder / f"{name}.js").write_text(f'vibraverse.object("{name}", {json.dumps(data)});\n')
    entered = "new PointerEvent('pointerenter', {pointerType: 'mouse'})"
    over = f"document.querySelector('.grid .item').dispatchEvent({entered})"
    browser.execute_script(over)
    time.sleep(0.3)
    assert browser.execute_script("return played.length") == 0
    button = browser.find_element("css selector", ".tools .quiet")
    assert "Hear on hover" in button.text
    button.click()
    browser.execute_script(over)
    wait(browser, "return played.length > 1")
    heard = browser.execute_script(
        """
        const {samples, rate, gain_db} = played.find((one) => one.samples);
        const level = (hz) => Math.hypot(...["sin", "cos"].map((wave) =>
          samples.reduce((sum, one, place) => sum + one * Math[wave]((2 * Math.PI * hz * place) / rate), 0)));
        const loudest = samples.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
        return [level(440) / level(460), level(440) / level(1500), 20 * Math.log10(loudest) + gain_db];
        """
    )
    assert heard[0] > 10
    assert heard[1] > 1
    assert heard[2] == pytest.approx(-12, abs=0.01)
    button.click()
    assert browser.execute_script("return played[played.length - 1]") == "stopped"


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [200, 360, 768, 1280, 2560])
def test_nothing_overflows_and_little_is_in_the_document(browser, page, width, theme):
    resize(browser, width)
    at(browser, "#", page)
    if browser.execute_script("return document.documentElement.dataset.theme") != theme:
        browser.execute_script("document.querySelector('#theme').click()")
    addresses = [
        "overview",
        "explore",
        *(f"run?part={part}" for part in ("refusals", "warnings", "validation", "making")),
    ]
    for address in addresses:
        at(browser, f"#/{address}")
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width, address
        assert browser.execute_script("return document.querySelectorAll('*').length") <= NODES, address
        assert browser.execute_script(TABS) <= TAB_STOPS, address
    resize(browser, 1280)


def test_the_run_names_the_command_for_its_own_folder(browser, page):
    at(browser, "#/run?part=refusals", page)
    words = ["vibraverse", "refusals", "--results", str(page.parents[1]), "--retry"]
    assert texts(browser, "#retry") == [shlex.join(words)]
    assert "The body or its wall is too thin to resolve" in texts(browser, ".part h3")[0]


def test_the_validation_is_drawn_and_what_was_missed_is_said(browser, page):
    at(browser, "#/run?part=validation", page)
    assert len(texts(browser, ".part svg .curve")) == 4 * 3
    assert texts(browser, ".part svg .P2.dotted text")[0] == "−1.30"
    assert "102.00 Hz instead of 100.00 Hz" in texts(browser, ".part .notice")[0]
    assert len(texts(browser, ".part .missed")) == 1


def test_no_request_leaves_the_disk_and_no_error_is_logged(browser):
    # Runs after the others of this browser, so it has seen all they did.
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 20
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
    assert browser.get_log("browser") == []


@pytest.mark.parametrize(("count", "refused"), [(1000, None), (10_000, None), (10_000, 9000)])
def test_ten_thousand_objects_are_listed_and_filtered(tmp_path, count, refused):
    page = make_page.write(tmp_path / "report", make_page.invented(count, refused), VIEW)
    with opened(page, tmp_path / "chromium") as browser:
        browser.get("about:blank")
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
        print(
            f"{count} objects, {refused} refused: first seen after {shown:.0f} ms, filtered in {chosen:.0f} ms"
        )
        assert chosen < 20_000
        for address in ("explore", "overview", "run", "run?part=warnings"):
            at(browser, f"#/{address}")
            assert browser.execute_script("return document.querySelectorAll('*').length") <= NODES, address
            assert browser.execute_script(TABS) <= TAB_STOPS, address
        at(browser, "#/explore")
        browser.execute_script("scrollTo({top: 1e9, behavior: 'instant'})")
        wait(browser, f"return document.querySelector('.grid li:last-child').ariaPosInSet === '{count}'")
        assert browser.get_log("browser") == []


def test_a_published_set_opens_on_its_objects_and_says_how_to_use_it(tmp_path):
    card = {
        "name": "Bells",
        "licence": "CC-BY-4.0",
        "creators": ["A. Ringer"],
        "url": "https://example.org/bells",
    }
    page = make_page.write(tmp_path / "report", make_page.invented(50), kind="dataset", card=card)
    with opened(page, tmp_path / "chromium") as browser:
        at(browser, "#", page)
        assert browser.execute_script("return document.documentElement.dataset.view") == "explore"
        at(browser, "#/overview")
        said = " ".join(texts(browser, "#view"))
        assert all(
            text in said
            for text in ("CC-BY-4.0", "A. Ringer", "https://example.org/bells", "vibraverse.dataset")
        )
        at(browser, "#/run?part=refusals")
        assert str(tmp_path) not in browser.page_source
        assert "--retry" not in browser.page_source


def test_an_empty_dataset_says_so(tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(4, 4), VIEW)
    with opened(page, tmp_path / "chromium") as browser:
        at(browser, "#", page)
        assert len(texts(browser, ".gone")) == 0
        assert "4" in texts(browser, ".tiles dd")
        at(browser, "#/explore")
        assert len(texts(browser, ".gone")) == 4
        assert browser.get_log("browser") == []


@pytest.mark.parametrize("damage", [None, "vibraverse.index({", ""])
def test_a_damaged_index_is_said(tmp_path, damage):
    page = make_page.write(tmp_path / "report", make_page.invented(20), VIEW)
    (index,) = page.parent.glob("page/*/index.js")
    if damage is None:
        index.unlink()
    else:
        index.write_text(damage)
    with opened(page, tmp_path / "chromium") as browser:
        text = wait(browser, "return document.querySelector('#view [role=alert]')?.textContent")
        assert "The list of objects cannot be shown" in text
        assert ("is missing" if damage is None else "is damaged") in text


def test_an_object_whose_file_is_missing_leaves_the_others(tmp_path):
    """The thumbnails' sheet is missing, too: the list works without pictures."""
    page = make_page.write(tmp_path / "report", make_page.invented(30), VIEW + SOUND)
    next(page.parent.glob("page/*/thumbs-0.webp")).unlink()
    with opened(page, tmp_path / "chromium") as browser:
        at(browser, "#/explore?state=made", page)
        browser.find_element("css selector", ".tools .quiet").click()
        browser.execute_script("document.querySelector('.grid .item').focus()")
        said = wait(browser, "return document.querySelector('#said').textContent")
        assert "is missing: copy the whole folder of the page" in said
        assert len(texts(browser, ".grid .item")) > 5


def test_forbidden_storage_takes_nothing_away(tmp_path):
    page = make_page.write(tmp_path / "report", make_page.invented(20), VIEW)
    forbid = "Object.defineProperty(window, 'localStorage', {get() { throw new DOMException('no'); }});"
    with opened(page, tmp_path / "chromium") as browser:
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": forbid})
        at(browser, "#/explore", page)
        browser.refresh()
        at(browser, "#/explore")
        before = browser.execute_script("return document.documentElement.dataset.theme")
        browser.execute_script("document.querySelector('#theme').click()")
        assert browser.execute_script("return document.documentElement.dataset.theme") != before
        assert browser.get_log("browser") == []


def address_of_this_machine() -> str:
    """Return a network address of this machine, not the loopback; skip the test without one."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            pytest.skip("this machine has no network address")
        return probe.getsockname()[0]


def test_the_page_works_over_plain_http(page, tmp_path):
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    host = address_of_this_machine()
    handler = functools.partial(Quiet, directory=str(page.parent))
    with http.server.ThreadingHTTPServer((host, 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with opened(page, tmp_path / "chromium") as browser:
                browser.get(f"http://{host}:{server.server_port}/index.html#/explore?family=bell")
                wait(browser, "return document.querySelectorAll('.grid .item').length > 5")
                assert browser.execute_script("return isSecureContext") is False
                assert texts(browser, ".count-line")[0].startswith("25 of 300 objects")
                at(browser, "#/run?part=refusals")
                assert texts(browser, "#retry") == ["vibraverse refusals --results RESULTS --retry"]
                assert browser.get_log("browser") == []
        finally:
            server.shutdown()


def test_a_page_that_was_copied_works_as_it_did(page, tmp_path):
    copy = shutil.copytree(page.parent, tmp_path / "elsewhere")
    with opened(copy / "index.html", tmp_path / "chromium") as browser:
        at(browser, "#/explore?q=bell-0003", copy / "index.html")
        assert texts(browser, ".grid .name") == [NASTY]
