"""Searching with a sound: tested bodies to hear, and the shapes and pictures that a model takes for theirs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from vibraverse.contract.seeds import stable_hash
from vibraverse.learn.pools import ALL, DIRECTIONS, SAME, SMALLEST, SOME, alike, key_of
from vibraverse.learn.samples import Samples
from vibraverse.learn.sides import TEST
from vibraverse.report.learning import listening
from vibraverse.report.learning.comparison import SIDES, Measure
from vibraverse.report.learning.trained import Trained, answerers
from vibraverse.report.sounds import sound

#: Sounds to search with, and what is shown of the order of each.
QUERIES, NEAREST = 12, 5
#: What the pools are called, in the order of the table.
POOLS = {
    ALL: "all tested bodies, each in its own material",
    SOME: "a hundred of them, drawn at random",
    SAME: "all tested bodies in one material, mean over materials",
}
_MEASURE = "map"
_NAMES = {"sound": "sound", "image": "picture", "shape": "shape"}
#: The directions as people read them.
WAYS = [f"{_NAMES[one]} → {_NAMES[other]}" for one, other in DIRECTIONS]


def directions(rows: Sequence[dict], methods: Sequence[dict], data: str) -> list[dict]:
    """Return the mean average precision of methods in all directions, for each pool of each split that has rows.

    Each is ``title``, ``pool`` and ``lines`` with a method's ``name``, ``kind`` and ``cells`` (values as text). Rows
    of other data than ``data`` are left out.
    """
    show = Measure("", "", percent=True).text
    found = []
    for side in SIDES:
        at = {
            (row["source"], row["model"], row["measure"]): row["value"]
            for row in rows
            if (row["task"], row["split"], row["side"]) == ("retrieval", side.split, side.side)
            and row["data_sha256"] == data
        }
        for source, title in POOLS.items():
            lines = []
            for method in methods:
                names = [
                    (source, method["model"], f"{one}_to_{other}_{_MEASURE}") for one, other in DIRECTIONS
                ]
                if any(name in at for name in names):
                    cells = [show(at[name]) if name in at else "–" for name in names]
                    lines.append({"name": method["model"], "kind": method["kind"], "cells": cells})
            if lines:
                found.append({"title": side.title, "pool": title, "lines": lines})
    return found


def searches(
    trainings: Sequence[Trained],
    methods: Sequence[dict],
    samples: Samples,
    materials: Mapping[str, Mapping[str, float]],
    assets: dict[str, bytes],
) -> dict:
    """Return the model whose answers are shown, and for some sounds what it finds; nothing without a model.

    The model is the best one, or else the published one. Sounds and pictures go to ``assets``.
    """
    able = answerers([one for one in trainings if one.retrieves])
    able = [one for one in able if len(one.answers[f"{TEST}/body"]) >= SMALLEST]
    if not able:
        return {}
    order = [one["model"] for one in sorted(methods, key=lambda one: one["kind"] != "model")]
    training = min(able, key=lambda one: order.index(one.model))
    pool = _Pool(training, samples)
    chosen = pool.chosen(materials)
    queries = [pool.query(place, number, materials, assets) for place, number in enumerate(chosen)]
    return {"training": training, "count": len(pool.bodies), "queries": queries}


class _Pool:
    """The tested bodies of a training, each in its own material."""

    def __init__(self, training: Trained, samples: Samples):
        number = {name: body for body, name in enumerate(samples.ids)}
        self.samples, self.names = samples, list(samples.materials)
        self.bodies = np.array([number[str(name)] for name in training.answers[f"{TEST}/body"]])
        self.material = training.answers[f"{TEST}/material"]
        self.alike = {name: own[self.bodies] for name, own in alike(samples).items()}
        rows = np.arange(len(self.bodies))
        self.vectors = {}
        for name in ("sound", "image", "shape"):
            values = training.answers[f"{TEST}/{name}"]
            self.vectors[name] = values[rows, np.minimum(self.material, values.shape[1] - 1)]

    def chosen(self, materials: Mapping[str, Mapping[str, float]]) -> list[int]:
        """Return the places of some bodies by hashes of their names, those that are heard well first."""

        def order(place: int) -> tuple[bool, int]:
            material = self.names[self.material[place]]
            heard = listening.is_heard(self._hz(place), materials[material])
            return not heard, stable_hash(self.samples.ids[self.bodies[place]], "search")

        return sorted(range(len(self.bodies)), key=order)[:QUERIES]

    def query(self, number: int, place: int, materials, assets: dict[str, bytes]) -> dict:
        """Return a sound, and what is nearest to it, each marked as right or wrong."""
        material = self.names[self.material[place]]
        samples = listening.sounds(self._hz(place), {}, materials[material])[""]
        return {
            **self._entry(place, assets),
            "player": sound(samples, listening.SAMPLE_RATE_HZ, f"search/{number}", assets),
            "f1_hz": float(self._hz(place)[0]),
            "found": [self._found(place, wanted, assets) for wanted in ("shape", "image")],
        }

    def _found(self, place: int, wanted: str, assets: dict[str, bytes]) -> dict:
        """Return the nearest entries, and the place of the first right one; a picture of two bodies counts once."""
        order = np.argsort(-(self.vectors[wanted] @ self.vectors["sound"][place]), kind="stable")
        if wanted == "image":
            firsts = np.unique(self.alike["look"][order], return_index=True)[1]
            order = order[np.sort(firsts)]
        own = self.alike[key_of(("sound", wanted))]
        right = own[order] == own[place]
        nearest = [
            {**self._entry(entry, assets), "right": bool(good)}
            for entry, good in zip(order[:NEAREST], right[:NEAREST], strict=True)
        ]
        return {"wanted": wanted, "nearest": nearest, "place": int(right.argmax()) + 1, "of": len(order)}

    def _entry(self, place: int, assets: dict[str, bytes]) -> dict:
        """Return how a body is called and looks."""
        body = self.bodies[place]
        picture = f"search/look-{self.alike['look'][place]}.png"
        if picture not in assets:
            file = io.BytesIO()
            Image.fromarray(np.asarray(self.samples.row("views", body)[0])).save(file, "PNG", optimize=True)
            assets[picture] = file.getvalue()
        return {
            "object": str(self.samples.object[body]),
            "solidity": str(self.samples.solidity[body]),
            "material": self.names[self.material[place]],
            "picture": picture,
        }

    def _hz(self, place: int) -> np.ndarray:
        return self.samples.row("frequencies_hz", self.bodies[place])[self.material[place]]
