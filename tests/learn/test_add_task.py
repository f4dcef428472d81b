"""docs/add-a-task.md, followed word by word in a copy of the project."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from make_features import write, write_splits

pytest.importorskip("torch", reason="PyTorch belongs to the learning environment")
pytestmark = pytest.mark.learn
ROOT = Path(__file__).resolve().parents[2]
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan") for number in range(10)]


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the package to which the page's task is added."""
    page = (ROOT / "docs/add-a-task.md").read_text(encoding="utf-8")
    module, line, models, section = re.findall(r"```(?:python)?\n(.*?)```", page, re.DOTALL)
    (path,) = re.findall(r"Its module\*\*, `(.*?)`", page)
    copy = tmp_path_factory.mktemp("add-task")
    shutil.copytree(ROOT / "workflow", copy / "workflow", ignore=shutil.ignore_patterns("__pycache__"))
    (copy / path).write_text(module, encoding="utf-8")
    for file, before, text in (
        ("learn/tasks/__init__.py", "TASKS = {\n", line),
        ("config/learn.py", "MODELS = {\n", models),
        ("config/learn.py", "    frequencies: LearningTask", section + "\n"),
    ):
        place = copy / "workflow/vibraverse" / file
        source = place.read_text(encoding="utf-8")
        at = source.index(before) + (len(before) if before.endswith("\n") else 0)
        place.write_text(source[:at] + text + source[at:], encoding="utf-8")
    return copy


def vibraverse(copy: Path, *arguments) -> str:
    """Run a command of the copy and return what it prints."""
    environment = os.environ | {"PYTHONPATH": str(copy / "workflow")}
    command = [sys.executable, "-m", "vibraverse", *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=copy)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_task_of_the_page_is_trained_and_judged(copy, tmp_path):
    features = write(tmp_path / "features", OBJECTS)
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS)
    asked = {"task": "thickness", "model": "wall", "split": "object", "preset": "tiny"}
    asked |= {"training": {"steps": 20, "batch_size": 8}, "network": {"width": 16, "layers": 1}}
    seen = ["--features", features, "--splits", splits, "--options", json.dumps(asked)]
    model, curves, record = (tmp_path / name for name in ("model.pt", "curves.csv", "training.json"))
    vibraverse(copy, "train", *seen, "--model", model, "--curves", curves, "--record", record)
    answers, measures = tmp_path / "answers.npz", tmp_path / "metrics.json"
    outputs = ["--answers", answers, "--record", measures]
    vibraverse(copy, "evaluate", *seen, "--model", model, "--training", record, *outputs)
    simple = tmp_path / "baselines.json"
    vibraverse(copy, "baselines", *seen, "--record", simple)
    table, joined = tmp_path / "results.tsv", tmp_path / "results.json"
    outputs = ["--table", table, "--record", joined]
    vibraverse(copy, "results", "--evaluations", measures, "--baselines", simple, *outputs)
    (row,) = json.loads(joined.read_text())["rows"]
    found = np.load(answers)
    assert list(found["test/body"]) == [f"{one} hollow" for n, one in enumerate(OBJECTS) if n % 10 > 7]
    true = np.load(features / "thickness.npy")[1::2][[n for n in range(40) if n % 10 > 7]]
    assert row["value"] == pytest.approx(np.median(np.abs(found["test/t"] - true)), rel=1e-6)
    assert (row["task"], row["model"], row["count"]) == ("thickness", "wall", 8)


def test_the_configuration_knows_the_task(copy):
    (copy / "config.yaml").write_text(
        "learn: {tasks: [thickness]}\nsources: {generated: {count: 8}, bundled: []}\n"
    )
    assert "is valid" in vibraverse(copy, "config", "check")
    assert '"thickness"' in vibraverse(copy, "config", "schema")
