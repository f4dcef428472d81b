"""Results of learning without any training: models that answer with the truth, wrong by a known share.

Evaluations, baselines and the table are made by the library and the stages; only the answers are invented.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from make_features import MATERIALS, write, write_splits

from vibraverse.cli import main
from vibraverse.config.learn import Learn
from vibraverse.contract import products
from vibraverse.contract.seeds import rng
from vibraverse.learn import judging
from vibraverse.learn.baselines.rows import baselines
from vibraverse.learn.curves import write_csv
from vibraverse.learn.judging import judged
from vibraverse.learn.metrics import bootstrap
from vibraverse.learn.pools import MODALITIES
from vibraverse.learn.results import evaluation
from vibraverse.learn.tasks import task_at

OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan", "rod") for number in range(8)]
OWN = [f"own-{number:04d}" for number in range(3)]
DAMPING = {"alpha_per_s": 4.0, "beta_s": 3e-8}
VERSION = "0.0.test"


@dataclass
class Made:
    """A folder with everything that the stage of the page reads."""

    folder: Path
    evaluations: list[Path] = field(default_factory=list)
    baselines: list[Path] = field(default_factory=list)

    @property
    def page(self) -> Path:
        return self.folder / "learn/index.html"

    def data(self, objects: list[str]) -> Made:
        """Write features of two shards, splits and the record of the dataset."""
        shards = [self.folder / f"learn/features/0000{number}" for number in range(2)]
        for number, shard in enumerate(shards):
            write(shard, objects[number::2], invented_ritz=True)
        (self.folder / "dataset").mkdir()
        write_splits(self.folder / "dataset/splits.tsv", sorted(objects))
        materials = {name: {**one, **DAMPING} for name, one in MATERIALS.items()}
        products.write_json(self.folder / "dataset/dataset.json", {"materials": materials})
        return self

    @property
    def features(self) -> list[Path]:
        return sorted((self.folder / "learn/features").glob("*/features.json"))

    @property
    def provenance(self) -> dict:
        checksums = {f"{one.parent.name}/{one.name}": products.sha256(one) for one in self.features}
        return {"vibraverse": VERSION, "input_sha256": {"features": checksums}}

    def train(
        self,
        task: str,
        model: str,
        split: str = "object",
        seed: int = 0,
        wrong: float = 0.1,
        preset: str = "cpu",
        hold_out: tuple[str, ...] = (),
        data_of: dict | None = None,
    ) -> Made:
        """Write the evaluation, answers and curves of a model whose frequencies are ``wrong`` by this share.

        A classifier answers wrongly about this share of the bodies. ``data_of`` is the provenance of other features.
        """
        options = Learn(preset=preset, hold_out=list(hold_out)).run(task, split, model, seed)
        made = task_at(self.features, self.folder / "dataset/splits.tsv", options)
        with fast_intervals():
            found = judged(made, _answers(made, wrong, seed))
        place = self.folder / f"learn/{task}/{split}/{model}/seed-{seed}"
        place.mkdir(parents=True)
        np.savez(place / "answers.npz", **found.answers)
        steps = [
            dict.fromkeys(("gradient_norm", "samples_per_s", "waiting_share"))
            | {"step": step, "learning_rate": 1e-3, "loss": 3.0 / (step + seed + 1)}
            | {"validation": wrong + 1.0 / step if step % 20 == 0 else None}
            for step in range(1, 61)
        ]
        write_csv(place / "curves.csv", steps)
        training = {
            "kind": made.kind,
            "preset": preset,
            "minutes": 1.5 + seed,
            "threads": 2,
            "hardware": "a <fast> one",
        }
        record = evaluation(options, model, found, training, data_of or self.provenance)
        record["provenance"] = {"options": options.model_dump(mode="json")}
        products.write_json(place / "metrics.json", record)
        self.evaluations.append(place / "metrics.json")
        return self

    def compare(
        self, task: str, split: str = "object", hold_out: tuple[str, ...] = (), count: int = 3
    ) -> Made:
        """Write the first baselines of a task, really fitted."""
        options = Learn(hold_out=list(hold_out)).run(task, split, "published", 0)
        made = task_at(self.features, self.folder / "dataset/splits.tsv", options)
        about = {"kind": "baseline", "preset": "", "hardware": "a <fast> one", "threads": 1, "minutes": 0.01}
        with fast_intervals():
            fitted = list(islice(baselines(made), count))
        found = [evaluation(options, name, one, about, self.provenance) for name, _, one in fitted]
        path = self.folder / f"learn/{task}/{split}/baselines.json"
        products.write_json(path, {"evaluations": found})
        self.baselines.append(path)
        return self

    def results(self) -> list[dict]:
        """Join everything by the stage ``results``; return its rows."""
        if not self.baselines:
            self.baselines.append(self.folder / "baselines.json")
            products.write_json(self.baselines[0], {"evaluations": []})
        inputs = ["--evaluations", *map(str, self.evaluations), "--baselines", *map(str, self.baselines)]
        learn = self.folder / "learn"
        outputs = ["--table", str(learn / "results.tsv"), "--record", str(learn / "results.json")]
        assert main(["results", *inputs, *outputs]) == 0
        return json.loads((learn / "results.json").read_text())["rows"]

    def arguments(self) -> list[str]:
        """Return the command that writes the page."""
        places = [path.parent for path in self.evaluations]
        return [
            "learn_page", "--results", str(self.folder / "learn/results.json"),
            "--evaluations", *map(str, self.evaluations),
            "--curves", *(str(place / "curves.csv") for place in places),
            "--answers", *(str(place / "answers.npz") for place in places),
            "--features", *(str(record.parent) for record in self.features),
            "--splits", str(self.folder / "dataset/splits.tsv"),
            "--dataset", str(self.folder / "dataset/dataset.json"), "--page", str(self.page),
        ]  # fmt: skip

    def write(self) -> str:
        """Write the page; return its text."""
        self.results()
        assert main(self.arguments()) == 0
        return self.page.read_text(encoding="utf-8")


@contextmanager
def fast_intervals():
    """Draw few samples for an interval; a thousand for each of many evaluations take a minute."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(judging, "bootstrap", partial(bootstrap, draws=20))
        yield


def _answers(task, wrong: float, seed: int) -> Callable[[str], dict[str, np.ndarray]]:
    def of(side: str) -> dict[str, np.ndarray]:
        bodies, samples = task.sides[side], task.samples
        random = rng(task.options.model, str(seed), side)
        if task.options.task == "frequencies":
            true = samples.rows("frequencies_hz", bodies)
            return {"found_hz": true * (1 + wrong * random.normal(size=true.shape)), "true_hz": true}
        if task.options.task == "retrieval":
            # A direction for every object, and more or less noise; bodies of an object are told apart by a last number.
            places = np.unique(samples.object[bodies], return_inverse=True)[1]
            own = np.column_stack([np.eye(places.max() + 1)[places], samples.solidity[bodies] == "hollow"])
            noisy = {name: own + wrong * random.normal(size=own.shape) for name in MODALITIES}
            return {name: one[:, None] for name, one in noisy.items()} | {"material": task.materials(side)}
        hollow = samples.solidity[bodies] == "hollow"
        return {"hollow": np.where(hollow ^ (random.random(len(bodies)) < wrong), 0.9, 0.1)}

    return of


def full(folder: Path) -> Made:
    """Return results of all tasks and both splits, with two seeds, a toy, a control, baselines and held-out origins."""
    made, hold_out = Made(folder).data([*OBJECTS, *OWN]), ("files",)
    for split in ("object", "family-0"):
        worse = 0.02 if split == "object" else 0.09
        for seed in (0, 1) if split == "object" else (0,):
            made.train("frequencies", "published", split, seed, 0.05 + worse, hold_out=hold_out)
            made.train("frequencies", "physics", split, seed, worse, "tiny", hold_out)
        made.train("solidity", "published", split, wrong=0.2, hold_out=hold_out)
        made.train("solidity", "sound", split, wrong=0.3, hold_out=hold_out)
        made.compare("frequencies", split, hold_out)
    made.compare("solidity", "object", hold_out, count=1)
    made.train("retrieval", "published", wrong=0.5, hold_out=hold_out)
    made.train("retrieval", "contrast", wrong=0.2, hold_out=hold_out)
    made.train("retrieval", "no_material", wrong=0.4, hold_out=hold_out)
    made.compare("retrieval", "object", hold_out, count=3)
    return made
