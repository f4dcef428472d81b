"""A mode as a moving picture: every frame is a pose of that mode."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import make_products
import page_files
from page_files import OBJECT
from vibraverse.media.animation import FRAMES, PERIOD_S, SWING, poses


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("animate")
    page_files.make(folder / "results")
    return folder


def test_poses_swing_around_the_body():
    vertices = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    shape = np.random.default_rng(1).normal(size=(20, 3))
    found = poses(vertices, shape)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    np.testing.assert_allclose(found[0], vertices - centre)
    np.testing.assert_allclose(found.mean(axis=0), found[0], atol=1e-12)
    moved = np.linalg.norm(found[FRAMES // 4] - found[0], axis=1)
    assert moved.max() == pytest.approx(SWING * np.ptp(vertices, axis=0).max())
    alike = ((found[FRAMES // 4] - found[0]) * shape).sum() / np.linalg.norm(found[FRAMES // 4] - found[0])
    assert alike == pytest.approx(np.linalg.norm(shape))


def test_a_gif_moves_and_comes_back(vibraverse, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    arguments = ("--mode", 3, "--solidity", "hollow", "--material", "wood", "--size-px", 96)
    status, out, errors = vibraverse("animate", OBJECT, *arguments, "-o", tmp_path / "mode.gif")
    assert status == 0, errors
    assert f"{OBJECT}, hollow wood: mode 3, " in out
    with Image.open(tmp_path / "mode.gif") as picture:
        assert (picture.n_frames, picture.size) == (FRAMES, (96, 96))
        assert picture.info["duration"] == round(1000 * PERIOD_S / FRAMES)
        frames = []
        for number in range(FRAMES):
            picture.seek(number)
            frames.append(np.asarray(picture.convert("RGB"), float))
    # A frame and its mirror in time show one pose; half a period apart it is another one.
    same = np.abs(frames[1] - frames[FRAMES // 2 - 1]).mean()
    other = np.abs(frames[FRAMES // 4] - frames[3 * FRAMES // 4]).mean()
    assert same < 0.3 * other


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nothing",), "does not exist; name an object of the run"),
        ((OBJECT, "--mode", "99"), "--mode must lie between 1 and 24, not 99"),
        ((OBJECT, "--material", "gold"), "gold"),
        ((OBJECT, "-o", "x.mp4"), "x.mp4 does not end in .gif"),
        ((OBJECT, "--size-px", "1"), "--size-px must lie between 32 and 2048"),
    ],
)
def test_a_mistake_is_one_sentence(vibraverse, folder, monkeypatch, arguments, sentence):
    monkeypatch.chdir(folder)
    status, _, errors = vibraverse("animate", *arguments)
    assert status == 2
    assert sentence in errors
    assert errors.count("\n") == 1


def test_a_refused_body_says_why(vibraverse, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_products.make(Path("results"), ("ball-0000",))
    status, _, errors = vibraverse("animate", "ball-0000", "--solidity", "hollow")
    assert status == 2
    assert "is refused: The wall of ball-0000 would be too thin." in errors
