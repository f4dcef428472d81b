"""The target ``learn`` through Snakemake: from meshes to the table; killed in training and repeated."""

from __future__ import annotations

import os
import re
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from vibraverse.contract import products  # noqa: E402
from vibraverse.flow.learning import LEARNING_STEPS  # noqa: E402
from vibraverse.flow.paths import Paths  # noqa: E402
from workflow_runs import TINY, Run  # noqa: E402

pytestmark = pytest.mark.learn

LEARNING = {
    **TINY,
    "sources": {"generated": {"count": 10, "families": ["bar", "ring"]}, "bundled": [], "files": []},
    "dataset": {"shards": 2, "splits": {"test": 0.67, "train": 0.21, "validation": 0.12}},
    "learn": {
        "preset": "tiny", "seeds": [0], "splits": ["object"],
        "features": {"points": 512, "view_px": 32, "ritz_degrees": [3], "ritz_unknowns": [300]},
        "frequencies": {
            "models": ["physics"],
            # A checkpoint after every step, so that a kill finds one.
            "training": {"steps": 30, "minutes": 30, "batch_size": 4, "checkpoint_minutes": 0},
        },
        "solidity": {"models": ["sound"], "training": {"steps": 10, "batch_size": 4}},
        "reconstruction": {
            "models": ["truncated"],
            "training": {"steps": 4, "batch_size": 2, "warmup_steps": 1},
            "network": {"width": 64, "latents": 32, "encoder_blocks": 1, "decoder_blocks": 1, "cells": 16},
        },
        "diffsound": {"bodies": 1, "cells": 8, "iterations": 2},
        "cavity": {"models": ["sound"], "training": {"steps": 10, "batch_size": 2}},
        "retrieval": {"models": ["contrast"], "training": {"steps": 10, "batch_size": 4}},
    },
}  # fmt: skip
TRAINING = {"task": "frequencies", "split": "object", "model": "physics", "seed": "0"}


def steps_kept(folder: Path) -> list[int]:
    """Return the steps of the checkpoints below a folder."""
    try:
        kept = list(folder.rglob("step-*/state.pt"))
    except FileNotFoundError:  # one went meanwhile
        return []
    return [int(path.parent.name.removeprefix("step-")) for path in kept]


@pytest.fixture(scope="module")
def learnt(tmp_path_factory, root) -> Run:
    """A run of the target ``learn`` that was killed while it trained, and repeated."""
    run = Run(tmp_path_factory.mktemp("learnt"), root, LEARNING)
    paths = Paths()
    record = run.folder / paths.at(paths.training_record, **TRAINING)
    process = run.start("learn")
    killed = False
    while process.poll() is None and not killed:
        if max(steps_kept(record.parent), default=0) >= 5:
            os.killpg(process.pid, signal.SIGKILL)
            killed = True
        time.sleep(0.01)
    process.wait()
    assert killed, "the training ended before it could be killed"
    assert not record.exists()
    run("learn")
    return run


def test_a_killed_training_goes_on_and_ends_with_the_same_weights(learnt, tmp_path):
    paths = Paths()
    record = learnt.folder / paths.at(paths.training_record, **TRAINING)
    metrics = products.read_json(record)["metrics"]
    assert metrics["steps"] == 30
    assert metrics["interruptions"] == 1
    assert not list(record.parent.glob(".*")), "the work folder goes when the model is there"
    model = learnt.folder / paths.at(paths.trained_model, **TRAINING)
    killed = torch.load(model, weights_only=True)
    model.unlink()
    learnt(str(model.relative_to(learnt.folder)))
    unbroken = torch.load(model, weights_only=True)
    assert products.read_json(record)["metrics"]["interruptions"] == 0
    for part in ("best", "last"):
        for name, weights in unbroken[part].items():
            torch.testing.assert_close(killed[part][name], weights, rtol=0, atol=0)


def test_every_stage_of_learning_has_run(learnt):
    for step in LEARNING_STEPS:
        for output in step.outputs.values():
            pattern = output.path.replace("{shard}", "*")
            for name in ("task", "split", "model", "seed", "part"):
                pattern = pattern.replace(f"{{{name}}}", "*")
            found = list((learnt.folder / "results").glob(pattern))
            assert found, f"no {output.path}"
            assert all(output.record_in(place).stat().st_size > 0 for place in found)


def test_the_table_compares_models_with_baselines(learnt):
    rows = products.read_json(learnt.folder / Paths().results_record)["rows"]
    models = {(row["task"], row["model"]) for row in rows}
    assert models >= {
        ("frequencies", "physics"), ("frequencies", "mean spectrum"), ("frequencies", "nearest shapes"),
        ("solidity", "sound"), ("solidity", "logistic regression"),
        ("reconstruction", "truncated"), ("reconstruction", "smoothed voxels"),
        ("cavity", "sound"), ("cavity", "ridge regression"),
        ("retrieval", "contrast"), ("retrieval", "chance"), ("retrieval", "linear CCA"),
    }  # fmt: skip
    assert {row["preset"] for row in rows if row["model"] == "physics"} == {"tiny"}
    medians = {
        row["model"]: row["value"] for row in rows if (row["source"], row["measure"]) == ("all", "median")
    }
    assert medians["mean spectrum"] < medians["training mean"]


def test_a_prediction_for_a_file_is_the_answer_about_the_object(learnt, tmp_path, monkeypatch, vibraverse):
    """But for the volume: that of the surface here, that of the tetrahedra in the dataset."""
    paths = Paths()
    with np.load(learnt.folder / paths.at(paths.answers, **TRAINING)) as answers:
        row = next(row for row, body in enumerate(answers["test/body"]) if body.endswith(" solid"))
        object_, expected = answers["test/body"][row].split()[0], answers["test/found_hz"][row]
    monkeypatch.chdir(learnt.folder)
    mesh = shutil.copy(paths.at(paths.source_mesh, object=object_), tmp_path / f"{object_}.ply")
    size_m = products.read_json(paths.at(paths.clean_record, object=object_))["size_m"]
    status, _, err = vibraverse(
        "predict", mesh, "--size", size_m, "--material", "steel", "wood", "--json", tmp_path / "found.json"
    )
    assert status == 0, err
    rows = products.read_json(tmp_path / "found.json")["materials"]
    ratio = np.array([row["frequencies_hz"] for row in rows.values()]) / expected
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-5)
    assert ratio[0, 0] == pytest.approx(1, abs=0.01)


def test_the_page_is_of_all_tasks_and_marks_the_toy(learnt):
    text = (learnt.folder / Paths().learn_page).read_text(encoding="utf-8")
    assert re.findall(r'<section id="(\w+)" class="task">', text) == [
        "cavity", "frequencies", "reconstruction", "retrieval", "solidity"
    ]  # fmt: skip
    assert "Search with a sound" in text
    assert "Different data" not in text
    assert "toy run" in text
    assert "<audio" in text


def test_nothing_is_left_to_do_and_a_new_seed_trains_alone(learnt):
    learnt("learn")  # another test may have trained a model anew
    assert learnt.plan("learn")[0] == {}
    before = learnt.config
    learnt.config = {**before, "learn": {**before["learn"], "gpus": 2}}  # makes no model anew
    assert learnt.plan("learn")[0] == {}
    learnt.config = {**before, "learn": {**before["learn"], "seeds": [0, 1]}}
    jobs, _ = learnt.plan("learn")
    everything, _ = learnt.plan()  # the report links the page of learning, and must not make it
    learnt.config = before
    assert jobs == {"train": 5, "evaluate": 5, "results": 1, "learn_page": 1, "learn": 1}
    assert everything["report"] == 1
    assert not {step.name for step in LEARNING_STEPS} & set(everything)
