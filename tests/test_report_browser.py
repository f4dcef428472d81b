"""The page in a browser, from disk: it lists, filters and counts, with the mouse and with the keyboard alone."""

from __future__ import annotations

import json
import shlex
import time

import pytest

import make_page
from browsers import opened
from page_views import NODES, SOUND, TAB_STOPS, TABS, VIEW, at, resize, texts, wait

NASTY = "</script><b id='broken'>\u2028\u202eליס"


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
        const shelf = catalogue.read(arguments[0], vibraverse.taken());
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
    modes = {name: {"hz": [440.0, 1500.0], "error": [0, 0], "mass_kg": 1} for name in make_page.NAMES}
    material = {"density": 2500, "young": 7e10, "poisson": 0.2, "alpha": 6.0, "beta": 1e-7}
    data = {
        "bodies": {"solid": {"modes": modes, "strikes": {name: [] for name in modes}, "volume_m3": 1e-3}},
        "materials": dict.fromkeys(make_page.NAMES, material),
        "size_m": 0.2, "scale_m": 0.1,
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
