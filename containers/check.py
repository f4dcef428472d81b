"""Run a family's stages on tiny inputs, with the image's own content only: ``check.py FAMILY``.

Stages, inputs and products come from ``flow/steps.py``; products of other families' stages are written by hand
(``by_hand.py``). An image holds only its family's packages, so these scripts need no others: they call the library
directly where a stage would need more.

A build runs it twice: while the image is writable, so that every compiled loop is stored in it, and afterwards as the
image's test. It needs no network and writes only to a temporary folder.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import re
import sys
import tempfile
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import by_hand

if TYPE_CHECKING:
    from vibraverse.contract.step import Input, Step

HOME = Path("/opt/vibraverse")
#: The family that includes all others, and the one with PyTorch.
WORKSTATION, LEARN = "workstation", "learn"

#: Two boxes that intersect, to exercise the exact intersection tests of the cleaning.
_CROSSED = """OFF
16 24 0
{vertices}
{faces}
"""


def crossed() -> str:
    """Return two intersecting boxes as an OFF file."""
    corners = [(x, y, z) for x in (0, 4) for y in (0, 1) for z in (0, 1)]
    moved = [(y + 1.3, x - 1.2, z + 0.3) for x, y, z in corners]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(s[0], s[k], s[k + 1]) for s in sides for k in (1, 2)]
    turned = [tuple(v + 8 for v in reversed(f)) for f in faces]
    return _CROSSED.format(
        vertices="\n".join("{} {} {}".format(*p) for p in corners + moved),
        faces="\n".join("3 {} {} {}".format(*f) for f in faces + turned),
    )


class Check:
    """A results folder with a tiny plan; stages run in it as the rules call them."""

    def __init__(self, results: Path):
        from vibraverse.flow.plan import Plan

        (results / "crossed.off").write_text(crossed())
        self.plan = Plan(
            {
                "results": str(results),
                "sources": {
                    "generated": {"count": 1, "families": ["bar"]},
                    "bundled": [],
                    "files": [{"path": str(results / "crossed.off")}],
                },
                "materials": {"steel": None},
                "tets": {"target_elements": 1000},
                "basis": {"order": 1, "modes": 8},
                "audio": {"max_s": 0.2},
                "images": {"views": 1, "looks": ["clay"], "size_px": 64},
                "dataset": {"shards": 1},
                "learn": {
                    "preset": "tiny",
                    "seeds": [0],
                    "splits": ["object"],
                    # Retrieval imports nothing else, and wants several materials and a larger side to test.
                    "tasks": ["frequencies", "solidity", "reconstruction", "cavity"],
                    "features": {"points": 512},
                    "frequencies": {"models": ["ritz", "subspace"], "training": {"steps": 3}},
                    "solidity": {"models": ["informed"], "training": {"steps": 3}},
                    "reconstruction": {"models": ["truncated"], "training": {"steps": 3, "warmup_steps": 0}},
                    "diffsound": {"bodies": 1, "cells": 8, "iterations": 2},
                    "cavity": {"models": ["sound"], "training": {"steps": 3}},
                },
            }
        )
        self.ran: list[str] = []

    def at(self, name: str, **wildcards: str) -> Path:
        """Return the path of a pattern of ``Paths``; make its folder."""
        path = Path(self.plan.paths.named(name, **wildcards))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def all_of(self, name: str) -> list[Path]:
        """Return the paths of a pattern for every shard and training, or for the known body."""
        named = [
            {"shard": shard, **one} for shard in sorted(self.plan.shards) for one in self.plan.trainings()
        ]
        return list(dict.fromkeys(self.at(name, body=by_hand.KNOWN, **wildcards) for wildcards in named))

    def jobs(self, step: Step) -> list[dict[str, str]]:
        """Return the wildcards of every job that a stage has."""
        from vibraverse.contract import step as per

        objects = [{"object": name} for name in self.plan.objects]
        bodies = [
            {**one, "solidity": solidity} for one in objects for solidity in self.plan.config.solidities
        ]
        return {
            per.OBJECT: objects,
            per.BODY: bodies,
            per.SHOWN_OBJECT: objects,
            per.SHOWN_BODY: bodies,
            per.SHARD: [{"shard": shard} for shard in self.plan.shards],
            per.KNOWN_BODY: [{"body": by_hand.KNOWN}],
            per.TRAINING: self.plan.trainings(),
            per.COMPARISON: [{"task": task, "split": "object"} for task in self.plan.config.learn.tasks],
            per.PART: [{"split": "object", "part": "0"}],
        }.get(step.per, [{}])

    def run(self, step: Step, wildcards: dict[str, str]) -> None:
        """Run one job of a stage, and check that all its products exist."""
        from vibraverse.cli import main
        from vibraverse.contract.refusal import read_refusal
        from vibraverse.contract.step import SHARD, option

        if step.per == SHARD:
            by_hand.refuse_missing(self, **wildcards)
        command: list = [step.name]
        if object_ := wildcards.get("object", wildcards.get("body")):
            command += ["--object", object_]
        if "solidity" in wildcards:
            command += ["--solidity", wildcards["solidity"]]
        if step.options:
            command += ["--options", self.options(step, wildcards)]
        for name, input_ in step.inputs.items():
            if not input_.pattern:
                command += self.own_file(name, **wildcards)
                continue
            if input_.optional and input_.pattern not in by_hand.BY_HAND:
                continue
            paths = self.read(step, input_, wildcards)
            for path in paths:
                if not path.exists():
                    by_hand.BY_HAND[input_.pattern](self, path)
            command += [option(name), *paths]
        places = {name: self.at(output.pattern, **wildcards) for name, output in step.outputs.items()}
        for name, place in places.items():
            command += [option(name), place]
        assert main([str(word) for word in command]) == 0, f"{step.name} failed"
        for place in places.values():
            for path in sorted(place.iterdir()) if place.is_dir() else [place]:
                assert path.stat().st_size, f"{step.name}: {path} is empty"
                assert not step.passes_refusals or read_refusal(path) is None, path.read_text()
        self.ran.append(step.name)

    def read(self, step: Step, input_: Input, wildcards: dict[str, str]) -> list[Path]:
        """Return the paths of an input of a job."""
        from vibraverse.contract.step import SHOWN_OBJECT

        if not input_.many:
            return [self.at(input_.pattern, **wildcards)]
        if step.per != SHOWN_OBJECT:
            return self.all_of(input_.pattern)
        bodies = self.plan.config.solidities
        return [self.at(input_.pattern, **wildcards, solidity=solidity) for solidity in bodies]

    def options(self, step: Step, wildcards: dict[str, str]) -> str:
        """Return the options of a job as the rules give them."""
        if "task" in wildcards:
            make = self.plan.training if "model" in wildcards else self.plan.comparison
            return make(SimpleNamespace(**wildcards))
        if "part" in wildcards:
            return self.plan.descent(SimpleNamespace(**wildcards))
        known = {"object_": wildcards.get("object", ""), "shard": wildcards.get("shard", "")}
        return self.plan.options(step.name, **known)

    def own_file(self, name: str, object: str = "", **_: str) -> list:
        """Return the argument for a user's file, if the job has one."""
        entry = self.plan.objects.get(object)
        return ["--file", entry.input] if name == "file" and entry and entry.input else []


def in_order(steps: list[Step]) -> list[Step]:
    """Return steps sorted so that each comes after those whose products it reads."""
    waiting, ordered = list(steps), []
    while waiting:
        for step in waiting:
            read = {input_.pattern for input_ in step.inputs.values()}
            later = {out.pattern for other in waiting if other is not step for out in other.outputs.values()}
            if not read & later:
                break
        waiting.remove(step)
        ordered.append(step)
    return ordered


def stages(check: Check, family: str) -> None:
    """Run every stage of a family, or of all but learning for the workstation."""
    from vibraverse.flow.steps import STEPS

    families = {step.family for step in STEPS} - {LEARN} if family == WORKSTATION else {family}
    for step in in_order([step for step in STEPS if step.family in families]):
        for wildcards in check.jobs(step):
            check.run(step, wildcards)
        if step.name == "features":
            open_for_training(check)
            by_hand.bodies(check)


def open_for_training(check: Check) -> None:
    """Open a dataset with the reader for PyTorch."""
    import torch

    import vibraverse.dataset

    (shard,) = check.all_of("shard")
    assert isinstance(vibraverse.dataset.torch_dataset(shard), torch.utils.data.Dataset)


def packages(family: str) -> None:
    """Import every package that the family requires by name."""
    extras = tomllib.loads((HOME / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = {re.split(r"[^A-Za-z0-9-]", requirement)[0] for requirement in extras.get(family, [])}
    for module, distributions in importlib.metadata.packages_distributions().items():
        if wanted & set(distributions) and module.isidentifier() and not module.startswith("_"):
            importlib.import_module(module)


def from_elsewhere() -> list[str]:
    """Return the loaded modules that are neither the image's Python nor its environment."""
    own = (str(HOME), f"{sys.base_prefix}/lib/")
    files = {name: getattr(module, "__file__", None) or "" for name, module in sys.modules.items()}
    # A module from a file has an absolute path; torch makes modules with relative ones.
    return [f"{name}: {file}" for name, file in files.items() if file[:1] == "/" and not file.startswith(own)]


def main(family: str) -> None:
    """Check one family; raise an exception if anything is wrong."""
    from vibraverse.machine.compiled import use_compiled_loops

    use_compiled_loops()
    packages(family)
    with tempfile.TemporaryDirectory(prefix="vibraverse-check-") as folder:
        check = Check(Path(folder))
        stages(check, family)
    strangers = [found for found in from_elsewhere() if str(Path(__file__)) not in found]
    assert not strangers, f"not from the image: {strangers}"
    print(f"{family}: its stages run from the image alone")


if __name__ == "__main__":
    main(sys.argv[1])
