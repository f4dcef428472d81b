"""The examples of the documentation run as they stand."""

from __future__ import annotations

import ast
import os
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from PIL import Image

import make_products
import vibraverse.dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    results = tmp_path_factory.mktemp("examples") / "results"
    make_products.build(results)
    return results / "dataset"


def test_a_mode_is_plotted_and_a_sound_written(root, folder, tmp_path):
    script = root / "examples/read_dataset.py"
    environment = {**os.environ, "MPLBACKEND": "agg"}
    command = [sys.executable, script, folder]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with vibraverse.dataset.open(folder) as reader:
        expected = reader.read("sound", "ball-0000", "solid", "ceramic")
    samples, rate = soundfile.read(tmp_path / "sound.wav", dtype="float32")
    assert rate == 44_100
    np.testing.assert_allclose(samples, expected, atol=2**-15)
    pixels = np.asarray(Image.open(tmp_path / "mode.png").convert("RGB"))
    assert (np.ptp(pixels.astype(int), axis=2) > 60).mean() > 0.02  # a coloured surface, not an empty frame


def test_a_folder_that_is_not_there_is_one_sentence(root, tmp_path):
    script = root / "examples/read_dataset.py"
    command = [sys.executable, script]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == (
        f"there is no results/dataset; name the dataset: python {script} PATH/TO/results/dataset\n"
    )


def test_it_is_twenty_lines(root):
    text = (root / "examples/read_dataset.py").read_text(encoding="utf-8")
    docstring = ast.parse(text).body[0]
    lines = [line for line in text.splitlines()[docstring.end_lineno :] if line.strip()]
    assert len(lines) <= 20
    documented = (root / "docs/dataset.md").read_text(encoding="utf-8")
    assert "\n".join(text.splitlines()[docstring.end_lineno :]).strip() in documented
