"""Stage ``learn_page``: results, curves and answers of all models in, a page with sounds in a folder beside it out.

The folder of sounds is named by a hash of their content, as that of the report.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

from vibraverse.contract import products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write sounds, then the page."""
    from vibraverse.config.learn import RunOptions
    from vibraverse.contract.errors import UsageError
    from vibraverse.learn.facts import identity
    from vibraverse.learn.samples import Samples
    from vibraverse.learn.tasks import samples_and_sides
    from vibraverse.report.learning.page import Learning
    from vibraverse.stages.report import remove_others, write_assets

    rows = products.read_json(job.inputs["results"])["rows"]
    trainings = _trainings(job)
    data = identity(job.provenance()["input_sha256"]["features"])
    asked = {
        one.split: RunOptions(**one.evaluation["provenance"]["options"])
        for one in trainings
        if one.evaluation["data_sha256"] == data
    }
    sides = {
        split: samples_and_sides(job.inputs["features"], job.inputs["splits"], options)[1]
        for split, options in asked.items()
    }
    try:
        samples = Samples([record.parent for record in job.inputs["features"]])
    except ValueError as error:
        raise UsageError(f"learn_page: {error}") from None
    materials = products.read_json(job.inputs["dataset"])["materials"]
    missing = sorted(set(samples.materials) - set(materials))
    if missing:
        raise UsageError(
            f"learn_page: {job.inputs['dataset']} lacks the material {missing[0]!r} of the features: they are of "
            "different datasets; run `snakemake learn` again, which makes what is out of date"
        )
    page = job.final["page"]
    assets = page.parent / "assets"

    def listen(files: dict[str, bytes]) -> str:
        folder = write_assets(assets, files)
        job.afterwards.append(lambda: remove_others(assets, folder))
        return f"{assets.name}/{folder}"

    links = {
        name: os.path.relpath(job.inputs[name], page.parent) if name in job.inputs else ""
        for name in ("results", "report")
    }
    text = Learning(rows, trainings, samples, data, sides).html(materials, **links, listen=listen)
    job.outputs["page"].write_text(text, encoding="utf-8")


def _trainings(job: Job) -> list:
    """Return the trainings; those are one whose evaluation, curves and answers lie in one folder."""
    import numpy as np

    from vibraverse.report.learning.trained import Trained

    curves, answers = (_by_folder(job.inputs[name]) for name in ("curves", "answers"))
    found = []
    for path in job.inputs["evaluations"]:
        for name, files in (("curves", curves), ("answers", answers)):
            if path.parent not in files:
                raise _alone(path, name)
        found.append(
            Trained(products.read_json(path), _columns(curves[path.parent]), np.load(answers[path.parent]))
        )
    return found


def _by_folder(paths: Sequence[Path]) -> dict[Path, Path]:
    return {path.parent: path for path in paths}


def _alone(path: Path, name: str):
    from vibraverse.contract.errors import UsageError

    return UsageError(
        f"learn_page: --{name} has no file in the folder of {path}, where those of one training lie together; name "
        f"the {name} of every evaluation"
    )


def _columns(path: Path) -> dict:
    """Return the columns of curves by name; an empty cell is not a number."""
    import numpy as np

    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        name: np.array([float(row[name] or "nan") for row in rows]) for name in ("step", "loss", "validation")
    }
