"""The check of the learning image, with its packages alone, as tests/test_preflight.py checks the others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from vibraverse.flow.steps import STEPS

pytest.importorskip("torch", reason="PyTorch belongs to the learning environment")
pytestmark = pytest.mark.learn


def test_the_learning_images_own_test_runs_every_stage_of_learning(tmp_path):
    command = [sys.executable, Path(__file__).parents[1] / "family_only.py", "learn", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) >= {step.name for step in STEPS if step.family == "learn"}
