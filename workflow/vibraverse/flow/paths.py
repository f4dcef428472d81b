"""Every path pattern of the workflow, in one place.

Patterns carry Snakemake's wildcards, mostly ``{object}`` and ``{solidity}``; :meth:`Paths.at` fills them in. The
patterns of products come from ``flow/steps.py``. Rules, targets, the dataset and the report take paths from here and
never build them by hand.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from vibraverse.flow.steps import STEPS

SOLIDITIES = ("solid", "hollow")


class Paths:
    """The path patterns below one results folder: the products of all stages, by name, and a few others."""

    def __init__(self, results: str | Path = "results"):
        # Path() drops a trailing slash and a leading "./", so that all paths compare as strings.
        self.results = str(Path(results))
        for step in STEPS:
            for output in step.outputs.values():
                setattr(self, output.pattern, f"{self.results}/{output.path}")

        self.object = f"{self.results}/objects/{{object}}"
        self.view = f"{self.views}/{{look}}-{{view}}.png"
        self.images_record = f"{self.views}/images.json"
        self.sound = f"{self.sounds}/{{material}}.wav"
        self.audio_record = f"{self.sounds}/audio.json"

        self.dataset = f"{self.results}/dataset"
        self.config = f"{self.results}/config.yaml"
        self.journal = f"{self.results}/journal"
        self.verdict = f"{self.results}/verdict.json"
        self.validation_verdict = f"{self.results}/validation/verdict.json"

    @staticmethod
    def at(pattern: str, **wildcards: str) -> str:
        """Return a pattern with its wildcards filled in."""
        return pattern.format(**wildcards)

    def named(self, name: str, **wildcards: str) -> str:
        """Return the pattern of this name with its wildcards filled in."""
        pattern = getattr(self, name)
        return self.at(pattern(SimpleNamespace(**wildcards)) if callable(pattern) else pattern, **wildcards)

    def boundary(self, wildcards) -> str:
        """Return the pattern of the surface that bounds a body: the object's own, or the one with the cavity."""
        return self.surface if wildcards.solidity == "solid" else self.hollow_surface

    def log(self, stage: str, *wildcards: str) -> str:
        """Return the log pattern of a stage, e.g. ``log("tets", "object", "solidity")``."""
        name = ".".join([stage, *(f"{{{w}}}" for w in wildcards[1:])])
        middle = f"{{{wildcards[0]}}}/" if wildcards else ""
        return f"{self.results}/logs/{middle}{name}.log"
