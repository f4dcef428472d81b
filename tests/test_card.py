"""The card and the Croissant metadata: they agree with the dataset, and hold everything that the format requires."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from PIL import Image

import make_products
from vibraverse.config.dataset import Card
from vibraverse.contract import products
from vibraverse.dataset.publish.card import card, cite

#: What Croissant 1.0 asks of a dataset, of its files and of its record sets and fields.
REQUIRED = (
    "@context",
    "@type",
    "conformsTo",
    "name",
    "description",
    "license",
    "url",
    "creator",
    "datePublished",
)
REQUIRED_FILE = ("@type", "@id", "name", "contentUrl", "encodingFormat", "sha256")
REQUIRED_FIELD = ("@type", "@id", "name", "description", "dataType", "source")
ABOUT = {
    "name": "Bells & bars",
    "creators": ["A. Maker", "B. Maker"],
    "url": "https://example.org/bells",
    "published": "2026-03-01",
    "version": "2.1.0",
}


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    results = tmp_path_factory.mktemp("card") / "results"
    paths = make_products.make(results)
    make_products.index(results, make_products.pack(results), "--options", json.dumps({"card": ABOUT}))
    return paths


def test_croissant_holds_all_that_the_format_asks_for(paths):
    about = products.read_json(paths.croissant)
    assert set(REQUIRED) <= set(about)
    assert about["@type"] == "sc:Dataset"
    assert about["conformsTo"] == "http://mlcommons.org/croissant/1.0"
    assert about["name"] == "Bells & bars"
    assert about["license"] == ["CC0-1.0"]
    assert [one["name"] for one in about["creator"]] == ["A. Maker", "B. Maker"]
    assert about["@context"]["cr"] == "http://mlcommons.org/croissant/"
    ids = set()
    for file in about["distribution"]:
        assert set(REQUIRED_FILE) <= set(file)
        path = f"{paths.dataset}/{file['contentUrl']}"
        assert file["sha256"] == products.sha256(path)
        ids.add(file["@id"])
    assert {"index.tsv", "splits.tsv", "refusals.tsv", "shards/0.h5", "shards/1.h5"} == ids
    for records in about["recordSet"]:
        fields = {field["@id"] for field in records["field"]}
        assert {key["@id"] for key in records["key"]} <= fields
        table = next(iter(records["field"]))["source"]["fileObject"]["@id"]
        with open(f"{paths.dataset}/{table}", encoding="utf-8", newline="") as file:
            header = next(csv.reader(file, delimiter="\t"))
        assert [field["source"]["extract"]["column"] for field in records["field"]] == header
        for field in records["field"]:
            assert set(REQUIRED_FIELD) <= set(field)
            assert field["source"]["fileObject"]["@id"] in ids
            assert field["dataType"] in ("sc:Text", "sc:Integer", "sc:Float")


def test_missing_metadata_is_left_out_and_not_invented(tmp_path):
    make_products.build(tmp_path)
    about = products.read_json(tmp_path / "dataset/croissant.json")
    assert set(REQUIRED) - set(about) == {"url", "datePublished"}


def test_the_card_says_what_the_dataset_holds(paths):
    text = Path(paths.card).read_text(encoding="utf-8")
    assert text.startswith("# Bells & bars\n")
    for line in (
        "| objects | 2 |",
        "| items | 12 |",
        "| sampled | 9 |",
        "| CC0-1.0 | 2 |",
        "| generated | 2 |",
        "| steel | 7850 | 2e+11 | 0.29 | 5 | 3e-08 |",
        "> A. Maker, B. Maker (2026): Bells & bars, version 2.1.0. Made with VibraVerse",
        "1 objects and 1 bodies more were refused: 1 not_a_solid, 1 too_thin.",
        "![Some of the objects](overview.png)",
    ):
        assert line in text, line
    for heading in ("Sources and licences", "Ranges", "Known limits", "Cite it", "Rebuild it", "Read it"):
        assert f"\n## {heading}\n" in text
    picture = Image.open(paths.overview)
    assert picture.size == (256, 128)
    assert len(picture.getcolors(1 << 20)) > 50


def test_attributions_that_licences_require_are_named(paths):
    record = products.read_json(paths.dataset_record)
    text = card(record, Card(), ["Z. Sculptor", "", "A. Sculptor", "Z. Sculptor"], "")
    assert "- A. Sculptor\n- Z. Sculptor\n" in text
    assert "overview.png" not in text
    assert cite(Card()).startswith("VibraVerse: VibraVerse dataset, version 1.0.0. Made with VibraVerse ")


def test_a_dataset_without_objects_has_a_card(tmp_path):
    make_products.make(tmp_path, objects=("leaf",))
    make_products.index(tmp_path, make_products.pack(tmp_path, groups=(("leaf",),)))
    assert "| objects | 0 |" in (tmp_path / "dataset/README.md").read_text(encoding="utf-8")
