"""The page of learning as HTML, with its sounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from vibraverse.learn.judging import THICKNESS
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import unit_hz
from vibraverse.learn.sides import TEST, TRAIN
from vibraverse.report import shell
from vibraverse.report.learning import comparison, figures, listening, search
from vibraverse.report.learning.figures import BASELINE, TRUTH, Line, Panel
from vibraverse.report.learning.trained import Trained, answerers, errors_by_mode
from vibraverse.report.sounds import sound

#: Bodies to listen to, and the name of the baseline that is played beside the models.
BODIES, MEAN = 6, "mean spectrum"


class Learning:
    """What the page shows: ``rows`` of ``results.json``, ``trainings``, and the ``samples`` they learned from.

    ``data`` is the beginning of the checksum of the samples. ``sides`` maps each split to the numbers of the bodies on
    its sides. Trainings on other data are named, and nothing of them is drawn or played.
    """

    def __init__(
        self,
        rows: list[dict],
        trainings: Sequence[Trained],
        samples: Samples,
        data: str,
        sides: Mapping[str, Mapping[str, np.ndarray]],
    ):
        self.rows, self.samples, self.data, self.sides = rows, samples, data, sides
        self.trainings = [one for one in trainings if one.evaluation["data_sha256"] == data]

    def html(self, materials: Mapping[str, Mapping[str, float]], results: str, report: str, listen) -> str:
        """Return the page. ``materials`` have damping; ``results`` and ``report`` are links, "" for none.

        ``listen(assets)`` stores sounds and pictures by name, and returns their folder relative to the page.
        """
        assets: dict[str, bytes] = {}
        tasks = [self._task(task, assets, materials) for task in comparison.tasks(self.rows)]
        return shell.fill(
            "learning.html",
            title="Learning",
            own_style=Markup(shell.text("learning.css")),
            players=Markup(shell.text("players.js")),
            data=self.data,
            objects=len(set(self.samples.object)),
            bodies=len(self.samples),
            materials=list(self.samples.materials),
            families=len(set(self.samples.family)),
            sides=self._sides(),
            strangers=comparison.strangers(self.rows, self.data),
            tasks=tasks,
            results=results,
            report=report,
            assets=listen(assets) if assets else "",
            longest_s=listening.LONGEST_S,
        )

    def _sides(self) -> list[dict]:
        """Return the numbers of bodies trained on and tested, by object and over folds."""
        found = []
        for split in ("object", "shuffled", "family"):
            chosen = [sides for name, sides in self.sides.items() if name.partition("-")[0] == split]
            if chosen:
                trained = [len(sides[TRAIN]) for sides in chosen]
                found.append(
                    {
                        "split": split,
                        "folds": len(chosen),
                        "trained": (min(trained), max(trained)),
                        "tested": sum(len(sides[TEST]) for sides in chosen),
                    }
                )
        return found

    def _task(self, task: str, assets: dict[str, bytes], materials) -> dict:
        methods = comparison.methods(self.rows, task)
        own = [one for one in self.trainings if one.task == task]
        learned = [one["model"] for one in methods if one["kind"] != "baseline"]
        inks = {name: figures.ink(number) for number, name in enumerate(learned)}
        predicting = [one for one in own if one.predicts_frequencies]
        return {
            **comparison.table(self.rows, task, self.data),
            "making": comparison.making(self.rows, task, self.data),
            "inks": inks,
            "both": len({one.by_family for one in own}) > 1,
            "curves": [
                {"model": name, "picture": self._curves(task, name, inks[name])}
                for name in learned
                if any(one.model == name for one in own)
            ],
            "by_mode": self._by_mode(task, predicting, inks),
            "by_thickness": self._by_thickness(task, methods, inks),
            "listening": self._listening(predicting, inks, assets, materials),
            "heard": answerers(predicting)[:1],
            "directions": search.directions(self.rows, methods, self.data) if task == "retrieval" else [],
            "ways": search.WAYS,
            "search": search.searches(own, methods, self.samples, materials, assets),
        }

    def _curves(self, task: str, model: str, ink: str) -> Markup:
        own = [one for one in self.trainings if (one.task, one.model) == (task, model)]
        panels = []
        for column, title in (("loss", "loss in training"), ("validation", "validation")):
            lines = [
                Line(one.curves["step"][there], one.curves[column][there], ink, one.by_family, width=0.9)
                for one in own
                if (there := np.isfinite(one.curves[column])).any()
            ]
            panels.append(Panel(title, lines, "step"))
        return Markup(figures.chart(panels, f"curves {task} {model}", 3.4))

    def _by_mode(self, task: str, trainings: list[Trained], inks: dict[str, str]) -> list[dict]:
        found = []
        errors = errors_by_mode(trainings)
        for percentile, title in ((50, "median"), (90, "90th percentile")) if errors else ():
            lines = [
                Line(
                    np.arange(1, len(values[percentile]) + 1),
                    100 * values[percentile],
                    inks[model],
                    by_family,
                )
                for (model, by_family), values in errors.items()
            ]
            panel = Panel("", lines, "mode", " %")
            found.append({"title": title, "picture": Markup(figures.chart([panel], f"mode {task} {title}"))})
        return found

    def _by_thickness(self, task: str, methods: list[dict], inks: dict[str, str]) -> list[dict]:
        """Return a plot of the first measure against the thickness for each split; models, and thin, baselines."""
        measure = comparison.measures(self.rows, task)[0]
        spans = {f"t {low:g}-{high:g}": (low + high) / 2 for low, high in pairwise(THICKNESS)}
        marks = {middle: span.removeprefix("t ").replace("-", "–") for span, middle in spans.items()}
        found = []
        for side in (side for side in comparison.SIDES if side.side == TEST):
            at = {
                (row["model"], row["source"]): row
                for row in self.rows
                if row["task"] == task
                and row["data_sha256"] == self.data
                and (row["split"], row["side"], row["measure"]) == (side.split, side.side, measure.name)
            }
            lines = []
            for place, method in enumerate(methods):
                points = [
                    (middle, at[method["model"], span])
                    for span, middle in spans.items()
                    if (method["model"], span) in at
                ]
                if points:
                    lines.append(_with_intervals(points, place, inks.get(method["model"], BASELINE), measure))
            if lines:
                unit = " %" if measure.percent else ""
                panel = Panel("", lines, "thickness t", unit, bool(measure.less_is_better), marks)
                picture = figures.chart([panel], f"thickness {task} {side.title}")
                found.append({"side": side, "measure": measure, "picture": Markup(picture)})
        return found

    def _listening(self, trainings: list[Trained], inks, assets: dict[str, bytes], materials) -> list[dict]:
        """Return the bodies to listen to, each with a plot of its spectra and a player for each of them."""
        playing = sorted(answerers(trainings), key=lambda one: list(inks).index(one.model))
        if not playing:
            return []
        names = list(self.samples.materials)
        rows = [{str(body): row for row, body in enumerate(one.answers[f"{TEST}/body"])} for one in playing]
        both = sorted(set.intersection(*map(set, rows)))
        first = playing[0].answers[f"{TEST}/true_hz"]

        def rings(body: str, material: str) -> bool:
            return listening.is_heard(first[rows[0][body], names.index(material)], materials[material])

        mean = np.exp(listening.mean_log_omega(self.samples, self.sides[playing[0].split][TRAIN]))
        number = {name: place for place, name in enumerate(self.samples.ids)}
        found = []
        for place, (body, material) in enumerate(listening.chosen(both, names, rings, BODIES)):
            column = names.index(material)
            true_hz = first[rows[0][body], column]
            spectra = {
                one.model: one.answers[f"{TEST}/found_hz"][row[body], column]
                for one, row in zip(playing, rows, strict=True)
            }
            spectra[MEAN] = mean * self._unit_hz(number[body], material)
            found.append(_body(place, body, material, true_hz, spectra, inks, materials[material], assets))
        return found

    def _unit_hz(self, body: int, material: str) -> float:
        one = self.samples.materials[material]
        return float(unit_hz(self.samples.row("volume_m3", body), one["young_pa"], one["density_kg_m3"]))


def _with_intervals(points: list[tuple[float, dict]], place: int, ink: str, measure) -> Line:
    """Return the values at thicknesses as a line, moved aside a little so that intervals do not cover each other."""
    scale = 100 if measure.percent else 1
    value, low, high = ([scale * row[name] for _, row in points] for name in ("value", "low", "high"))
    aside = 0.006 * ((place % 5) - 2)
    return Line(
        [middle + aside for middle, _ in points],
        value,
        ink,
        low=low,
        high=high,
        width=0.8 if ink == BASELINE else 1.5,
    )


def _body(
    place: int, body: str, material: str, true_hz, spectra: dict, inks, damped, assets: dict[str, bytes]
) -> dict:
    """Return a body to listen to: a plot of its spectra, and a player for each."""
    made = listening.sounds(true_hz, spectra, damped)
    colours = {"": TRUTH, **{name: inks.get(name, BASELINE) for name in spectra}}
    players, drawn = [], []
    for number, (name, samples) in enumerate(made.items()):
        hz = spectra[name] if name else true_hz
        drawn.append((name or "true", colours[name], hz))
        players.append(
            {
                **sound(samples, listening.SAMPLE_RATE_HZ, f"{place}/{number}", assets),
                "name": name or "true",
                "ink": colours[name],
                "error": float(np.median(np.abs(hz / true_hz - 1.0))),
                "f1_hz": float(hz[0]),
            }
        )
    return {
        "body": body,
        "material": material,
        "picture": Markup(figures.spectra(drawn, true_hz, f"spectra {place}")),
        "players": players,
    }
