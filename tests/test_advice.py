"""Commands in messages do what they promise when pasted, whichever run they concern."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import yaml

import make_products


@pytest.fixture
def wrong(tmp_path, monkeypatch) -> Path:
    """A run with other names than ``results`` and ``config.yaml``, and with a wrong product."""
    monkeypatch.chdir(tmp_path)
    make_products.build(Path("my results"))
    Path("mine.yaml").write_text(yaml.safe_dump({"results": "my results"}))
    with open("my results/dataset/index.tsv", "a", encoding="utf-8") as file:
        file.write("more\n")
    return Path("my results/dataset")


def advised(text: str) -> list[str]:
    """Return the command in a text, as a list of words."""
    (command,) = re.findall(r"`(vibraverse [^`]*)`", text)
    return shlex.split(command)


@pytest.mark.parametrize("named", [("--config", "mine.yaml"), ("--results", "my results")])
def test_repair_names_the_run(wrong, vibraverse, named):
    status, out, _ = vibraverse("repair", *named)
    assert status == 1
    assert advised(out) == ["vibraverse", "repair", *named, "--delete"]
    status, out, _ = vibraverse(*advised(out)[1:])
    assert status == 0
    assert out.endswith("Deleted 10 products; the next run rebuilds them and what depends on them.\n")


def test_check_names_the_run_as_far_as_the_folder_tells(wrong, vibraverse, monkeypatch):
    assert advised(vibraverse("check", wrong, "--sample", 0)[1]) == [
        "vibraverse", "repair", "--results", "my results",
    ]  # fmt: skip
    wrong.rename("copy")
    out = vibraverse("check", "copy", "--sample", 0)[1]
    assert "`vibraverse repair`, with the --config or --results of the run that made it, says" in out
    Path("copy").rename(wrong)
    results = wrong.parent.absolute()
    monkeypatch.chdir(wrong)
    assert advised(vibraverse("check", ".", "--sample", 0)[1])[-1] == str(results)


def test_provenance_names_the_run(wrong, vibraverse):
    Path("my results/objects/bar-0000/clean.json").write_text("{")
    out = vibraverse("provenance", "my results/objects/bar-0000/grids.h5")[1]
    assert advised(out) == ["vibraverse", "repair", "--results", "my results"]
