"""The index of the page: every object has a short row, and scripts read from it what the dataset holds."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

import make_page
from scripts import run_script
from vibraverse.config.dataset import ReportOptions
from vibraverse.physics.materials import MATERIALS
from vibraverse.report import assembly, quantities
from vibraverse.report.facts import facts, times
from vibraverse.report.index import MESSAGE_LENGTH, SHOWN_WARNINGS, index, pictured, short
from vibraverse.report.sheets import ACROSS, SIDE_PX, sheets

GLASS = MATERIALS["glass"]
#: CPU seconds by object and stage.
COSTS = {"ball": {"clean": 1.5, "basis": 20.25}, "plate": {"clean": 3.0, "basis": 0.5}}


def shelf(given: dict, **options) -> dict:
    """Return the data of the page, as a script would get them."""
    said = facts(make_page.record(given), ReportOptions(**options))
    return json.loads(json.dumps({**said, **index(**given)}))


def read(body: str, data: dict, **more):
    """Return what a function body makes of the objects of the page, ``shelf``."""
    return run_script(
        f"const shelf = catalogue.read(given.data, given.times); {body}",
        {"data": data, "times": times(COSTS), **more},
        "catalogue.js",
    )


@pytest.fixture(scope="module")
def few():
    """Two objects with known numbers, a body that is refused, and an object that is."""
    items = []
    for name, size, volume, f1 in (("ball", 0.1, 5e-4, 9000.0), ("plate", 0.4, 1e-3, 100.0)):
        for solidity in ("solid", "hollow") if name == "ball" else ("solid",):
            for material in ("glass", "wood"):
                row = make_page.item(name, "round", solidity, material, size, volume, 1.0, 0)
                items.append(
                    {
                        **row,
                        "title": name if name == "ball" else "A thin plate",
                        "f1_hz": f1,
                        "f_last_hz": 10 * f1,
                    }
                )
    refusals = [
        make_page.refusal("plate", "hollow", "hollow", "too_thin", "The wall is too thin."),
        make_page.refusal(
            "leaf", "", "clean", "not_a_solid", "leaf.obj is flat. " + 40 * "It bounds nothing. "
        ),
    ]
    bodies = {"solid": {"worst_error": 0.00123}, "hollow": {"worst_error": 0.029}}
    warnings = [
        {"solidity": "solid", "kind": "changed_shape", "text": "5 % is made up"},
        {"solidity": "hollow", "kind": "inaccurate_modes", "text": "2.9 % in mode 2"},
        {"solidity": "hollow", "kind": "changed_shape", "text": "5 % is made up"},
    ]
    seen = {
        "ball": {"row": {"version": "0123abcd", "bodies": bodies}, "warnings": warnings},
        "leaf": {"row": {"title": "A leaf", "source": "files", "version": "89abcdef", "bodies": {}}},
    }
    return {
        "items": items,
        "refusals": refusals,
        "seen": seen,
        "materials": ("glass", "wood"),
    }


def test_a_row_holds_what_the_dataset_says(few):
    made = index(**few)
    rows = {row[0]: dict(zip(made["columns"], row, strict=True)) for row in made["rows"]}
    assert list(rows) == ["ball", "leaf", "plate"]
    ball = rows["ball"]
    assert ball["title"] == ""  # as the id
    assert (ball["version"], ball["thumb"], ball["size_m"]) == ("0123abcd", 0, 0.1)
    assert ball["solid"] == [5e-4, 0.0012, 1, 64, 90_000, 9000, 9000]
    assert ball["hollow"][1:3] == [0.029, 0b101]
    plate = rows["plate"]
    assert (plate["thumb"], plate["version"], plate["hollow"]) == (-1, "", 0)
    ((solidity, reason, stage, message, advice),) = plate["refused"]
    assert made["solidities"][solidity - 1] == "hollow"
    names = made["names"]
    assert (names["reason"][reason], names["stage"][stage], names["advice"][advice]) == (
        "too_thin",
        "hollow",
        make_page.ADVICE,
    )
    assert message == "The wall is too thin."
    leaf = rows["leaf"]
    assert (leaf["title"], names["source"][leaf["source"]], leaf["solid"]) == ("A leaf", "files", 0)
    assert leaf["refused"][0][0] == 0
    assert leaf["refused"][0][3].endswith(" It …")
    assert len(leaf["refused"][0][3]) <= MESSAGE_LENGTH + 2
    assert pictured(made) == ["ball"]


def test_warnings_are_counted_and_those_of_both_bodies_shown_once(few):
    said = {one["kind"]: one for one in index(**few)["warnings"]}
    assert said["changed_shape"]["shown"] == [["ball", "", "5 % is made up"]]
    assert said["inaccurate_modes"]["shown"] == [["ball", "hollow", "2.9 % in mode 2"]]
    assert said["many_elements"]["count"] == 0
    many = {str(number): few["seen"]["ball"] for number in range(30)}
    said = {one["kind"]: one for one in index(**{**few, "seen": many})["warnings"]}
    assert (said["changed_shape"]["count"], len(said["changed_shape"]["shown"])) == (30, SHOWN_WARNINGS)


def test_ring_times_and_weyls_law_follow_from_the_row(few):
    """Independent: the decay of a mode by 60 dB, and the count of modes of a solid by its volume."""
    data = shelf(few)
    found = read("return shelf.entries.map((one) => one.bodies.solid || null);", data)
    ball, leaf, plate = found
    assert leaf is None
    time = np.linspace(0, 20, 2_000_001)
    for hz, body in ((9000.0, ball), (100.0, plate)):
        damping = 0.5 * (GLASS["alpha_per_s"] + GLASS["beta_s"] * (2 * np.pi * hz) ** 2)
        silent = time[np.argmax(np.exp(-damping * time) < 1e-3)]
        assert body["ring"][0] == pytest.approx(silent, rel=1e-4)
    shear = np.sqrt(GLASS["young_pa"] / 2 / (1 + GLASS["poisson"]) / GLASS["density_kg_m3"])
    modulus = GLASS["young_pa"] * (1 - GLASS["poisson"]) / (1 + GLASS["poisson"]) / (1 - 2 * GLASS["poisson"])
    pressure = np.sqrt(modulus / GLASS["density_kg_m3"])
    law = 4 / 3 * np.pi * 1e-3 * 1000.0**3 * (2 / shear**3 + 1 / pressure**3)
    assert plate["density"] == pytest.approx(64 / law, rel=1e-9)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ("", ["ball", "leaf", "plate"]),
        ("q=THIN", ["plate"]),
        ("q=a+leaf", ["leaf"]),
        ("q=nothing", []),
        ("source=files", ["leaf"]),
        ("family=round", ["ball", "plate"]),
        ("state=refused", ["leaf", "plate"]),
        ("state=refused: too_thin", ["plate"]),
        ("state=warning: inaccurate_modes", ["ball"]),
        ("state=made", ["ball", "plate"]),
        ("solidity=hollow", ["ball", "leaf", "plate"]),
        ("solidity=hollow&state=made", ["ball", "plate"]),
        ("f1=50..200", ["plate"]),
        ("f1=..200&material=wood", ["plate"]),
        ("size=0.1..0.2", ["ball"]),
        ("error=0.01..", ["ball"]),
        ("error=0.01..&solidity=solid", []),
        ("dearest=clean", ["plate"]),
        ("f1=nonsense&sort=nonsense&material=nonsense", ["ball", "leaf", "plate"]),
        ("sort=f1", ["plate", "ball", "leaf"]),
        ("sort=cost", ["ball", "plate", "leaf"]),
        ("sort=size", ["ball", "plate", "leaf"]),
    ],
)
def test_an_address_chooses_objects(few, settings, expected):
    body = "const asked = catalogue.asked(new URLSearchParams(given.settings), shelf);"
    body += "return catalogue.choose(shelf, asked).map((one) => one.id);"
    assert read(body, shelf(few), settings=settings) == expected


def test_a_count_beside_a_value_is_what_choosing_it_leaves():
    """Each facet's counts against a count in Python, with another filter in force."""
    given = make_page.invented(300)
    body = "return catalogue.offered(shelf, catalogue.asked(new URLSearchParams({split: 'test'}), shelf), 'family');"
    found = read(body, shelf(given))
    expected = {}
    for object_id, family in {
        (one["object"], one["category"]) for one in given["items"] if one["split"] == "test"
    }:
        expected[family] = expected.get(family, 0) + bool(object_id)
    assert dict(found["values"]) == expected
    assert [count for _, count in found["values"]] == sorted(expected.values(), reverse=True)


def test_a_facet_of_many_values_offers_the_most_frequent():
    given = make_page.invented(200)
    for one in given["items"]:
        one["category"] = one["object"]
    for object_id, one in given["seen"].items():
        one["row"]["family"] = object_id
    found = read(
        "return catalogue.offered(shelf, catalogue.asked(new URLSearchParams('family=vase-0007'), shelf), 'family');",
        shelf(given),
    )
    assert len(found["values"]) in (60, 61)
    assert "vase-0007" in dict(found["values"])
    assert found["more"] + len(found["values"]) == 200


@pytest.mark.parametrize("refused", [None, 900])
def test_a_row_takes_at_most_250_bytes(refused):
    """The names of the test are as long as those of a run."""
    made = index(**make_page.invented(1000, refused))
    text = json.dumps(made["rows"], separators=(",", ":"))
    assert len(made["rows"]) == 1000
    assert len(text) / 1000 < 250


def test_hostile_texts_cannot_end_the_script(few):
    nasty = "</script><b>\u2028\u202e"
    given = {**few, "items": [{**one, "title": nasty} for one in few["items"]]}
    script = assembly.files(shelf(given), [])["index.js"].decode("ascii")
    assert "</" not in script
    assert json.loads(script[len("vibraverse.index(") : -3])["rows"][0][1] == nasty


def test_a_published_set_states_how_to_use_it_and_names_no_place(few):
    card = {"name": "Bells", "licence": "CC-BY-4.0", "creators": ["A. Ringer"], "published": "2026-11-30"}
    said = shelf(few, kind="dataset", card=card, results="/home/somebody/results")
    assert said["publication"]["licences"] == ["CC-BY-4.0"]
    assert said["publication"]["citation"].startswith("A. Ringer (2026): Bells")
    assert 'split="train", material="glass"' in said["publication"]["loader"]
    compile(said["publication"]["loader"], "loader", "exec")
    assert "somebody" not in json.dumps(said)
    assert "publication" not in shelf(few, kind="run")


def test_times_are_those_of_the_costs():
    assert times(COSTS) == {
        "stages": {"clean": [2, 4.5, 2.25], "basis": [2, 20.8, 10.38]},
        "objects": {"ball": [21.8, "basis"], "plate": [3.5, "clean"]},
    }


def test_sheets_hold_a_hundred_thumbnails_each():
    colours = [(int(250 * place / 120), 90, 200 - place) for place in range(120)]

    def picture(colour):
        file = io.BytesIO()
        Image.new("RGB", (SIDE_PX, SIDE_PX), colour).save(file, format="PNG")
        return file.getvalue()

    made = list(sheets(map(picture, colours)))
    assert len(made) == 2
    for place, colour in enumerate(colours):
        number, rest = divmod(place, ACROSS**2)
        sheet = np.asarray(Image.open(io.BytesIO(made[number])).convert("RGB"))
        assert sheet.shape == (ACROSS * SIDE_PX, ACROSS * SIDE_PX, 3)
        down, across = divmod(rest, ACROSS)
        there = sheet[
            down * SIDE_PX + 20 : down * SIDE_PX + 70, across * SIDE_PX + 20 : across * SIDE_PX + 70
        ]
        assert np.abs(there.mean((0, 1)) - colour).max() < 6


def test_numbers_take_few_characters():
    assert [short(value) for value in (0.123456, 1234.5, 2.0, 0, 1e-7)] == [0.123, 1230, 2, 0, 1e-7]
    assert isinstance(short(2.0), int)


@pytest.mark.parametrize("name", ["length", "volume", "mass", "frequency", "duration", "fileSize"])
def test_the_page_writes_quantities_as_python_does(name):
    values = [*np.logspace(-6, 4, 61).tolist(), 9.995, 999.6, 1e4, 123_456.0]
    values = [value for value in values if name != "fileSize" or value >= 1]
    python = {"fileSize": "file_size"}.get(name, name)
    expected = [getattr(quantities, python)(value) for value in values]
    assert run_script(f"return given.map((one) => words.{name}(one));", values, "words.js") == expected


def test_bins_of_a_plot_count_every_value_once():
    random = np.random.default_rng(4)
    for span in (0.1, 1.0, 8.0):
        values = np.exp(random.uniform(-span, span, 500)).tolist()
        scripts = ("words.js", "elements.js", "plots.js")
        body = "return [plots.edges(given), plots.counted(given, plots.edges(given))];"
        edges, counts = run_script(body, values, *scripts)
        assert len(counts) <= 22
        assert sum(counts) == 500
        assert counts == np.histogram(values, edges)[0].tolist()


def test_a_single_value_has_a_bin():
    edges = run_script("return plots.edges(given);", [840.0, 840.0], "words.js", "elements.js", "plots.js")
    assert edges[0] <= 840.0 < edges[-1]
