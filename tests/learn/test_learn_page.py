"""The page of learning: its numbers, pictures and sounds, for whole results and for those that lack something."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import soundfile
from scipy.signal import find_peaks

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_results import DAMPING, OBJECTS, Made, full  # noqa: E402
from read_page import Page  # noqa: E402

from accessible import faults  # noqa: E402
from page_views import resize  # noqa: E402
from vibraverse.cli import main  # noqa: E402
from vibraverse.contract import products  # noqa: E402
from vibraverse.report.learning import comparison, search  # noqa: E402
from vibraverse.report.learning import page as page_of_learning  # noqa: E402

pytestmark = pytest.mark.learn
#: Bodies that the pages of these tests play: few, for speed.
BODIES = 2
TOY = "a toy run: shows that all works and nothing else"


@pytest.fixture(scope="module", autouse=True)
def few_bodies():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(page_of_learning, "BODIES", BODIES)
        patched.setattr(search, "QUERIES", BODIES)
        yield


@pytest.fixture(scope="module")
def made(few_bodies, tmp_path_factory) -> Made:
    """Results of everything, with their page."""
    made = full(tmp_path_factory.mktemp("page"))
    made.write()
    return made


@pytest.fixture
def small(tmp_path) -> Made:
    """The page of a single model."""
    made = Made(tmp_path).data(OBJECTS).train("frequencies", "physics")
    made.write()
    return made


def words(text: str) -> str:
    return " ".join(re.sub(r"<[^>]+>", "", text).split())


def test_the_numbers_are_those_of_the_results(page, rows):
    shown = {
        (task, line["name"], split, side, measure): cell["value"]
        for (task, split, side), lines in page.sides.items()
        for line in lines
        for measure, cell in line["cells"].items()
    }
    named = {(task, one.name) for task, columns in comparison.MEASURES.items() for one in columns}
    expected = {
        tuple(row[name] for name in ("task", "model", "split", "side", "measure")): row["value"]
        for row in rows
        if row["source"] == "all"
        and (row["task"], row["measure"]) in named
        and (row["split"], row["side"])
        != ("family", "held_out")  # those of the split by object stand for them
    }
    assert {task for task, *_ in expected} == {"frequencies", "retrieval", "solidity"}
    assert {side for *_, side, _ in expected} == {"test", "held_out"}
    assert shown == expected


def test_values_and_intervals_are_rounded_to_three_digits(page, rows):
    row = next(
        row
        for row in rows
        if (row["model"], row["split"], row["side"], row["source"], row["measure"])
        == ("published", "object", "test", "all", "median")
    )
    line = page.sides["frequencies", "object", "test"][0]
    texts = line["cells"]["median"]["texts"]
    assert float(texts[0]) == pytest.approx(100 * row["value"], rel=5e-3)
    assert [float(end) for end in texts[1].split("–")] == pytest.approx(
        [100 * row["low"], 100 * row["high"]], rel=5e-3
    )
    assert row["low"] < row["high"]
    assert row["trainings"] == 2


def test_the_best_of_each_column_is_bold(page):
    seen = 0
    for (task, *_), lines in page.sides.items():
        for column in comparison.MEASURES[task]:
            lines_of_it = [
                line for line in lines if column.name in line["cells"]
            ]  # a small pool has its size alone
            if not lines_of_it:
                continue
            values = {line["name"]: line["cells"][column.name]["value"] for line in lines_of_it}
            bold = {line["name"] for line in lines_of_it if line["cells"][column.name]["best"]}
            wanted = (min if column.less_is_better else max)(values.values())
            best = {name for name, value in values.items() if value == wanted}
            assert bold == (best if len(set(values.values())) > 1 else set())
            seen += len(bold)
    assert seen > 10


def test_models_come_first_and_toys_and_controls_are_marked(page):
    by_object = page.sides["frequencies", "object", "test"]
    kinds = [line["kind"] for line in by_object]
    assert kinds == ["published", "model", "baseline", "baseline", "baseline"]
    assert [line["name"] for line in by_object if "toy run" in line["text"]] == ["physics"]
    assert TOY in page.all("title")
    assert {line["name"]: line["kind"] for line in page.sides["solidity", "object", "test"]} == {
        "published": "published", "sound": "control", "logistic regression": "baseline",
    }  # fmt: skip
    assert [
        line["name"] for line in page.sides["solidity", "object", "test"] if " control" in line["text"]
    ] == ["sound"]


def test_what_was_made_how_is_said(made, rows):
    text = made.page.read_text(encoding="utf-8")
    section = text.partition('<section id="making">')[2]
    for name in ("config_hash", "data_sha256", "version"):
        assert all(row[name] in section for row in rows)
    assert "a &lt;fast&gt; one" in section
    assert re.search(r"physics.*?<td>object</td><td>2</td><td>tiny</td><td>2</td>", section, re.DOTALL)


def test_the_head_says_which_dataset_and_what_the_sides_are(made):
    head = words(made.page.read_text(encoding="utf-8").partition("<main")[0])
    assert re.search(r"Dataset [0-9a-f]{12}: 43 objects, 86 bodies, 2 materials \(steel, wood\)", head)
    assert (
        "By object: siblings of the family were seen in training; trained on 56 bodies, tested on 16." in head
    )
    assert "By family: whole families unseen; 1 fold of 6 families" in head
    assert "Different data" not in head


def test_the_page_is_well_formed_and_its_links_resolve(made, page):
    ids = page.all("id")
    assert len(ids) == len(set(ids))
    targets = [*page.all("href"), *page.all("src"), *page.all("xlink:href")]
    assert len(targets) > 20
    for target in targets:
        if target.startswith("#"):
            assert target[1:] in ids, target
        elif target != "data:,":
            assert (made.page.parent / target).is_file(), target
    text = made.page.read_text(encoding="utf-8")
    assert not re.search(r"https?://", text)
    assert set(re.findall(r"url\(#([^)]+)\)", text)) <= set(ids)


def test_pictures_have_texts(page):
    pictures = [values for tag, values in page.tags if tag == "img" or values.get("class") == "plot"]
    assert len(pictures) > 15
    assert all(len(values.get("alt") or values.get("aria-label")) > 20 for values in pictures)
    assert sum(tag == "svg" and "viewbox" in values for tag, values in page.tags) == page.all("role").count(
        "img"
    )


def test_same_results_same_bytes_and_a_link_back_where_there_is_a_report(small):
    before = {path: products.sha256(path) for path in small.page.parent.rglob("*") if path.is_file()}
    assert main(small.arguments()) == 0
    assert {path: products.sha256(path) for path in small.page.parent.rglob("*") if path.is_file()} == before
    assert "../report/index.html" not in small.page.read_text(encoding="utf-8")
    report = small.folder / "report/index.html"
    report.parent.mkdir()
    report.write_text("anything")
    assert main([*small.arguments(), "--report", str(report)]) == 0
    assert '<a href="../report/index.html">Dataset</a>' in small.page.read_text(encoding="utf-8")


def test_each_player_sounds_the_frequencies_of_its_answers(made, page):
    """The lowest frequencies of truth and prediction, found again as peaks of the sounds that the page plays."""
    labels = [label.removeprefix("Play ") for label in page.all("aria-label") if label.startswith("Play ")]
    labels = [label for label in labels if not label.startswith("the sound of")]  # those to search with
    played = [values for _, values in page.tags if "/search/" not in values.get("src", "")]
    sounds = [values["src"] for values in played if values.get("src", "").endswith(".flac")]
    materials = [values["alt"].rpartition(", ")[2] for values in played if "alt" in values]
    assert len(labels) == len(sounds) == len(materials) == BODIES * 4
    checked = 0
    for label, place, material in zip(labels, sounds, materials, strict=True):
        name, _, body = label.partition(", ")
        if name not in ("true", "published", "physics"):
            continue
        model = "published" if name == "true" else name
        answers = np.load(made.folder / f"learn/frequencies/object/{model}/seed-0/answers.npz")
        row = answers["test/body"].tolist().index(body)
        kind = "true" if name == "true" else "found"
        hz = answers[f"test/{kind}_hz"][row, ["steel", "wood"].index(material)]
        samples, rate = soundfile.read(made.page.parent / place)
        spectrum = np.abs(np.fft.rfft(samples * np.hanning(len(samples)), 4 * rate))
        peaks = np.fft.rfftfreq(4 * rate, 1 / rate)[find_peaks(spectrum, height=spectrum.max() / 20)[0]]
        assert np.abs(peaks - hz.min()).min() < 12, (label, hz.min(), peaks)
        checked += 1
    assert checked == 3 * BODIES


def test_results_of_other_data_are_named_and_marked(tmp_path):
    other = {"vibraverse": "0.0.test", "input_sha256": {"features": {"features.json": "0" * 64}}}
    made = Made(tmp_path).data(OBJECTS).train("frequencies", "published", wrong=0.05)
    made.train("frequencies", "physics", wrong=0.001, data_of=other).train(
        "frequencies", "physics", seed=1, wrong=0.001
    )
    rows = made.results()
    (mixed,) = {row["data_sha256"] for row in rows if row["model"] == "physics"}
    right, strange = (products.read_json(path)["data_sha256"] for path in made.evaluations[:2])
    assert sorted(mixed.split(", ")) == sorted([right, strange])
    text = made.write()
    said = words(text.partition("<main")[0])
    assert f"Not all results are of the dataset {right}: physics is of {strange}." in said
    assert "Numbers of different data cannot be compared" in said
    published, physics = Page(text).sides["frequencies", "object", "test"]
    assert "other data" in physics["text"]
    assert "other data" not in published["text"]
    assert not any(cell["best"] for cell in physics["cells"].values())


def test_results_of_other_data_alone_have_a_table_and_no_pictures(tmp_path):
    other = {"vibraverse": "0.0.test", "input_sha256": {"features": {"features.json": "0" * 64}}}
    made = Made(tmp_path).data(OBJECTS).train("frequencies", "physics", data_of=other)
    text = made.write()
    assert "Different data" in text
    assert 'class="plot"' not in text
    assert "<audio" not in text
    assert "other data" in Page(text).sides["frequencies", "object", "test"][0]["text"]


@pytest.mark.parametrize("what", ["one model", "one task", "by family"])
def test_results_that_lack_something_have_a_page(tmp_path, what):
    made = Made(tmp_path).data(OBJECTS)
    if what == "one model":
        made.train("frequencies", "physics")
        made.train("solidity", "published")
    elif what == "one task":
        made.train("solidity", "image").compare("solidity", count=1)
    else:
        made.train("frequencies", "published", "family-1").train(
            "frequencies", "physics", "family-1", wrong=2.0
        )
    text = made.write()
    page = Page(text)
    assert {side for _, _, side in page.sides} == {"test"}
    if what == "one model":
        assert {task for task, *_ in page.sides} == {"frequencies", "solidity"}
        assert "The published network was not trained in this run." in text
        assert text.count("<audio") == BODIES * 3
    elif what == "one task":
        assert {task for task, *_ in page.sides} == {"solidity"}
        assert "Accuracy by wall thickness" in text
        assert "<audio" not in text
    else:
        assert {split for _, split, _ in page.sides} == {"family"}
        assert "split family-1" in text
        assert text.count("<audio") == BODIES * 4  # frequencies below zero are left out


def test_names_are_texts(tmp_path):
    names = [f"<i>&\"'$x^2$</script>-{number:04d}" for number in range(20)]
    made = Made(tmp_path).data(names).train("frequencies", "physics")
    text = made.write()
    assert "<i>&" not in text
    assert text.count("</script>") == 2
    assert "&lt;i&gt;&amp;&#34;&#39;$x^2$&lt;/script&gt;-" in text
    Page(text)


def test_a_missing_file_of_a_training_is_one_sentence(made, capsys):
    arguments = made.arguments()
    place = arguments.index("--curves") + 1
    assert main(arguments[:place] + arguments[place + 1 :]) == 2
    assert re.search(
        r"--curves has no file in the folder of .*metrics.json.*name the curves of every",
        capsys.readouterr().err,
    )


def test_a_dataset_without_the_materials_is_one_sentence(made, tmp_path, capsys):
    dataset = tmp_path / "dataset.json"
    dataset.write_text(json.dumps({"materials": {"steel": DAMPING}}))
    arguments = [str(dataset) if one.endswith("dataset.json") else one for one in made.arguments()]
    assert main(arguments) == 2
    assert "lacks the material 'wood' of the features" in capsys.readouterr().err


def test_sounds_of_an_earlier_page_go(small):
    place = small.evaluations[0].parent / "answers.npz"
    answers = dict(np.load(place))
    np.savez(place, **{**answers, "test/found_hz": 1.01 * answers["test/found_hz"]})
    before = set((small.page.parent / "assets").iterdir())
    assert main(small.arguments()) == 0
    after = set((small.page.parent / "assets").iterdir())
    assert len(before) == len(after) == 1
    assert before != after
    page = Page(small.page.read_text(encoding="utf-8"))
    assert all((small.page.parent / place).is_file() for place in page.all("src"))


def test_in_a_browser_all_loads_and_nothing_overflows(browser, made):
    browser.set_script_timeout(20)
    loaded = browser.execute_async_script(
        """
        const done = arguments[0];
        const images = [...document.images], sounds = [...document.querySelectorAll("audio")];
        images.forEach((image) => { image.loading = "eager"; });
        Promise.all([
          ...images.map((image) => image.decode().then(() => image.naturalWidth > 0, () => false)),
          ...sounds.map((audio) => new Promise((resolve) => {
            audio.addEventListener("canplaythrough", () => resolve(true));
            audio.addEventListener("error", () => resolve(false));
            audio.preload = "auto";
            audio.load();
          })),
        ]).then(done);
        """
    )
    # A sound and its picture for each; to search with, a sound, two pictures, and five shapes and pictures found.
    assert loaded == [True] * (BODIES * (4 * 2 + 3 + 2 * search.NEAREST))
    playing = browser.execute_async_script(
        """
        const done = arguments[0], players = document.querySelectorAll(".player");
        players[0].querySelector("audio").loop = true;
        players[0].querySelector(".play").click();
        setTimeout(() => {
          const before = players[0].classList.contains("playing");
          players[1].querySelector(".play").click();
          setTimeout(() => done([before, players[0].classList.contains("playing")]), 100);
        }, 100);
        """
    )
    assert playing == [True, False]
    before = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    browser.execute_script("document.getElementById('theme').click()")
    assert browser.execute_script("return getComputedStyle(document.body).backgroundColor") != before
    for width in (400, 768, 1280):
        metrics = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 15
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
    assert browser.get_log("browser") == []


def test_in_a_browser_nothing_serious_is_inaccessible(browser):
    for width in (360, 1280):
        resize(browser, width)
        for opened in ("false", "true"):
            browser.execute_script("document.getElementById('theme').click()")
            browser.execute_script(
                f"document.querySelectorAll('details').forEach((one) => (one.open = {opened}))"
            )
            assert faults(browser) == [], (width, opened)
