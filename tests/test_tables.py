"""Tables: what is written is read back, here and by other programs."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from vibraverse.dataset.schema import tables


def test_tables_give_back_what_was_written():
    columns = {"name": (str, ""), "value": (float, ""), "count": (int, "")}
    rows = [{"name": "a\tb\n c", "value": np.float64(0.1) / 3, "count": np.int64(4)}]
    text = tables.to_tsv(rows, columns)
    assert text.splitlines()[0] == "name\tvalue\tcount"
    assert tables.from_tsv(text, columns) == [{"name": "a b c", "value": 0.1 / 3, "count": 4}]
    assert tables.from_tsv(tables.to_tsv([], columns), columns) == []
    with pytest.raises(ValueError, match="columns are"):
        tables.from_tsv("other\n", columns)
    with pytest.raises(ValueError, match="no table"):
        tables.from_tsv(f'{text}"{"x" * 200_000}', columns)


def test_tables_are_read_by_other_programs_whatever_a_text_holds():
    columns = {"title": (str, ""), "count": (int, "")}
    titles = ['"Quoted', 'a 12" pipe', "a\0b\x85c\ud800", "# it's plain"]
    text = tables.to_tsv([{"title": title, "count": 1} for title in titles], columns)
    expected = ['"Quoted', 'a 12" pipe', "a b c", "# it's plain"]
    assert [row["title"] for row in csv.DictReader(io.StringIO(text), delimiter="\t")] == expected
    assert [row["title"] for row in tables.from_tsv(text, columns)] == expected
    assert text.splitlines()[-1] == "# it's plain\t1"  # as it is where nothing has to be quoted
