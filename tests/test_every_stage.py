"""Every stage of the table really runs, including the validation and its part of the report.

The tiny run makes all but the validation. Its own rules run the latter for the body that takes
least; the comparisons of the other bodies are copies of its.
"""

from __future__ import annotations

import json
import shlex
import shutil

import pytest

from test_report import data_of
from vibraverse.contract import products
from vibraverse.contract.refusal import read_refusal
from vibraverse.flow.learning import LEARNING_STEPS
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import STEPS
from vibraverse.validation.bodies import BODIES
from workflow_runs import Run

#: The body that takes least: see ``elements`` and ``modes``.
KNOWN = "block"


@pytest.fixture(scope="module")
def validated(finished, tmp_path_factory) -> Run:
    """A copy of the tiny run after ``snakemake validation``, and the report that shows the validation."""
    run = Run(tmp_path_factory.mktemp("validated"), finished.root)
    shutil.copytree(finished.folder, run.folder, dirs_exist_ok=True)
    paths = Paths()
    comparison = run.folder / paths.at(paths.validation_comparison, body=KNOWN)
    run(str(comparison.relative_to(run.folder)))
    said = products.read_json(comparison)
    for body in BODIES.keys() - {KNOWN}:
        products.write_text(run.folder / paths.at(paths.validation_meshes, body=body), "stands for meshes")
        rows = [{**row, "body": body} for row in said["rows"]]
        products.write_json(
            run.folder / paths.at(paths.validation_comparison, body=body),
            {**said, "body": body, "rows": rows},
        )
    run("validation")
    run()
    return run


def commands(run: Run) -> dict[str, list[str]]:
    """Return the command of a job of each stage, as the first lines of the logs have it."""
    logs = (run.folder / "results/logs").rglob("*.log")
    firsts = (shlex.split(log.read_text(encoding="utf-8").partition("\n")[0]) for log in logs)
    return {words[1]: words for words in firsts if words[:1] == ["vibraverse"]}


def test_every_stage_was_run(validated):
    """The tiny configuration of ``workflow_runs.py`` or the fixture here must run a new stage.

    Those of learning need PyTorch: ``tests/learn/test_learning_run.py`` runs them.
    """
    ran = commands(validated)
    for step in (step for step in STEPS if step not in LEARNING_STEPS):
        assert step.name in ran, f"no test runs the stage {step.name}"
        for name, output in step.outputs.items():
            option = f"--{name.replace('_', '-')}"
            assert option in ran[step.name], (step.name, name)
            place = validated.folder / ran[step.name][ran[step.name].index(option) + 1]
            record = output.record_in(place)
            assert record.stat().st_size > 0, (step.name, name)
            assert read_refusal(record) is None, (step.name, name)


def test_the_validation_holds_for_the_body_that_was_computed(validated):
    paths = Paths()
    record = products.read_json(validated.folder / paths.validation_record)
    assert record["missed"] == []
    assert set(record["bodies"]) == set(BODIES)
    assert products.read_json(validated.folder / paths.validation_verdict) == {"accepted": True, "missed": []}
    comparison = products.read_json(validated.folder / paths.at(paths.validation_comparison, body=KNOWN))
    assert comparison["provenance"]["stage"] == "validation_modes"
    assert {row["verdict"] for row in comparison["rows"]} == {"met", "shown"}


def test_the_report_shows_the_validation(validated, finished):
    shown = data_of(validated.folder / "results/report/index.html")["validation"]
    assert {body["title"] for body in shown["bodies"].values()} == {body.title for body in BODIES.values()}
    assert data_of(finished.folder / "results/report/index.html")["validation"] is None
    assert json.loads((validated.folder / "results/verdict.json").read_text())["accepted"] is True


def test_nothing_is_left_to_do_after_it(validated):
    assert validated.plan("validation", "all")[0] == {}
