"""Retrieval in the page of learning: its table of directions, and the search with a sound."""

from __future__ import annotations

import re

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_results import OBJECTS, OWN, Made  # noqa: E402

from vibraverse.report.learning import search  # noqa: E402

pytestmark = pytest.mark.learn


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    """Results of two models and some baselines, with a page of two sounds; three objects are held out."""
    made, hold_out = Made(tmp_path_factory.mktemp("page")).data([*OBJECTS, *OWN]), ("files",)
    made.train("retrieval", "published", wrong=0.5, hold_out=hold_out)
    made.train("retrieval", "contrast", wrong=0.2, hold_out=hold_out).compare("retrieval", "object", hold_out)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(search, "QUERIES", 2)
        made.write()
    return made


def test_a_search_shows_what_the_vectors_say(made):
    """The nearest shapes and pictures of each sound, calculated again from the answers of the best model."""
    text = made.page.read_text(encoding="utf-8")
    assert "<b>contrast</b> (seed 0, split object)" in text
    with np.load(made.folder / "learn/retrieval/object/contrast/seed-0/answers.npz") as answers:
        bodies, vectors = answers["test/body"].tolist(), {name: answers[f"test/{name}"][:, 0] for name in
                                                           ("sound", "shape", "image")}  # fmt: skip
    articles = re.findall(
        r'<article class="heard searched" id="retrieval-\d+"( hidden)?>(.*?)</article>', text, re.S
    )
    assert [hidden for hidden, _ in articles] == ["", " hidden"]
    objects = [body.split()[0] for body in bodies]
    for _, article in articles:
        asked = " ".join(
            re.search(r"<code>(.+?)</code>.*?<span>(solid|hollow)</span>", article, re.S).groups()
        )
        lists = re.findall(
            r'number ([\d,]+) of (\d+)</small>.*?<ol class="nearest">(.*?)</ol>', article, re.S
        )
        for wanted, (place, count, entries) in zip(("shape", "image"), lists, strict=True):
            scores = vectors[wanted] @ vectors["sound"][bodies.index(asked)]
            order = np.argsort(-scores).tolist()
            names = [bodies[number] if wanted == "shape" else objects[number] for number in order]
            names = list(dict.fromkeys(names))
            right = asked if wanted == "shape" else asked.split()[0]
            assert (int(place), int(count)) == (names.index(right) + 1, len(names))
            shown = re.findall(r'<li class="(\w+)">.*?<code>(.+?)</code>(?:<span>(\w+), )?', entries)
            assert [" ".join(filter(None, one[1:])) for one in shown] == names[: search.NEAREST]
            assert [one[0] == "right" for one in shown] == [name == right for name in names[: search.NEAREST]]


def test_all_directions_are_those_of_the_results(made, rows):
    text = made.page.read_text(encoding="utf-8").partition("<h3>By direction</h3>")[2].partition("<h3>")[0]
    section = " ".join(re.sub(r"<[^>]+>", " ", text).split())
    ways = "sound → picture sound → shape picture → sound picture → shape shape → sound shape → picture"
    assert ways in section
    values = {row["measure"]: row["value"] for row in rows if (row["model"], row["source"], row["side"]) ==
              ("contrast", "one material", "test")}  # fmt: skip
    wanted = values["sound_to_shape_map"], values["image_to_sound_map"]
    line = re.search(r"in one material, mean over materials.*?contrast ([\d. ]+)", section)[1].split()
    assert (float(line[1]), float(line[2])) == pytest.approx([100 * value for value in wanted], rel=5e-3)
    assert "a hundred" not in section  # sixteen bodies are tested


def test_small_pools_are_counted(page):
    """Three held-out objects are six bodies: too few to measure, and said so."""
    lines = page.sides["retrieval", "object", "held_out"]
    assert {line["name"] for line in lines} >= {"published", "contrast", "chance"}
    assert all({name: cell["value"] for name, cell in line["cells"].items()} == {"pool": 6} for line in lines)


def test_in_a_browser_another_sound_is_picked(browser):
    shown = "return [...document.querySelectorAll('.searched')].map((one) => !one.hidden)"
    assert browser.execute_script(shown) == [True, False]
    browser.execute_script("document.querySelectorAll('.pick')[1].click()")
    assert browser.execute_script(shown) == [False, True]
    pressed = "return [...document.querySelectorAll('.pick')].map((one) => one.getAttribute('aria-pressed'))"
    assert browser.execute_script(pressed) == ["false", "true"]
    browser.execute_script("document.querySelectorAll('.pick')[0].click()")
