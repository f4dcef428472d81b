"""A reader of the page of learning, which fails where elements do not close in order."""

from __future__ import annotations

from html.parser import HTMLParser

#: Elements without an end, in HTML.
VOID = {"meta", "link", "input", "img", "br", "hr"}


class Page(HTMLParser):
    """A page as tags: whether they close in order, their ids, links and texts, and the tables of comparison."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.sides: dict[tuple[str, str, str], list[dict]] = {}
        self.task, self.side, self.row, self.bold = "", None, None, False
        self.feed(text)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.tags.append((tag, values))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "section":
            self.task = values.get("id", "")
        elif tag == "tbody" and "data-side" in values:
            self.side = self.sides.setdefault((self.task, values["data-split"], values["data-side"]), [])
        elif tag == "tr" and "data-method" in values:
            self.row = {"name": values["data-method"], "kind": values["class"], "cells": {}, "text": ""}
            self.side.append(self.row)
        elif tag == "td" and self.row is not None and "data-measure" in values:
            self.row["cells"][values["data-measure"]] = {
                "value": float(values["data-value"]),
                "best": False,
                "texts": [],
            }
        elif tag == "b" and self.row is not None:
            list(self.row["cells"].values())[-1]["best"] = True

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"{tag} closes what is not open"
        if tag == "tr":
            self.row = None

    def handle_data(self, data):
        if self.row is not None and data.strip():
            self.row["text"] += f" {data.strip()}"
            if "td" in self.open and self.row["cells"]:
                list(self.row["cells"].values())[-1]["texts"].append(data.strip())

    def all(self, attribute: str) -> list[str]:
        return [values[attribute] for _, values in self.tags if attribute in values]
