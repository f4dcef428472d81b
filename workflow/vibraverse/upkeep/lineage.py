"""The lineage of products: which stage made which file of an object from which others.

It derives from the steps. It traces a product back to its source, and finds products that changed after later ones were
made from them.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from vibraverse.contract import products
from vibraverse.contract.step import Step, option
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.flow.steps import CHAIN


@dataclass(frozen=True)
class Made:
    """One job of the chain: a step and an object, and for stages of bodies a solidity.

    ``stated`` is the text of its record if that comes from elsewhere, such as a shard.
    """

    paths: Paths
    step: Step
    object: str
    solidity: str = ""
    stated: str = ""

    def __str__(self) -> str:
        return f"{self.step.name} of {self.object}{f' ({self.solidity})' if self.solidity else ''}"

    def input(self, name: str) -> Path:
        """Return the path of an input."""
        return self._at(self.step.inputs[name].pattern)

    def place(self, name: str) -> Path:
        """Return the path of an output, a file or a folder."""
        return self._at(self.step.outputs[name].pattern)

    def output(self, name: str) -> list[Path]:
        """Return the files of an output: itself, or for a folder those that its record lists, else those in it."""
        place = self.place(name)
        if place != self.record.parent:
            return [place]
        stated = self.provenance.get("output_sha256", {}).get(name)
        there = (path.name for path in place.glob("*") if not path.name.startswith("."))
        return [place / each for each in dict.fromkeys([*(stated or sorted(there)), self.record.name])]

    @property
    def outputs(self) -> list[Path]:
        """The files of all outputs."""
        return [path for name in self.step.outputs for path in self.output(name)]

    @property
    def places(self) -> list[Path]:
        """The paths of all outputs, files and folders, as Snakemake knows them."""
        return [self.place(name) for name in self.step.outputs]

    @property
    def record(self) -> Path:
        """The file that states the provenance."""
        return self.step.outputs[self.step.record].record_in(self.place(self.step.record))

    def _at(self, pattern: str) -> Path:
        return Path(self.paths.named(pattern, object=self.object, solidity=self.solidity))

    @cached_property
    def content(self) -> dict:
        """Content of the record, or of ``stated``; empty if the record is missing, refused or broken."""
        try:
            if self.stated:
                return json.loads(self.stated)
            is_json = self.record.suffix == ".json"
            return (
                products.read_json(self.record)
                if is_json
                else {"provenance": products.read_provenance(self.record)}
            )
        except (OSError, ValueError, LookupError):
            return {}

    @property
    def provenance(self) -> dict:
        """Provenance in :attr:`content`."""
        return self.content.get("provenance", {})

    def command(self) -> str:
        """Return the command that remakes the outputs, with the options that the record states."""
        words = ["vibraverse", self.step.name, "--object", self.object]
        words += ["--solidity", self.solidity] if self.solidity else []
        words += [f"--file={file}" for file in self._file()]
        stated = self.provenance.get("input_sha256", self.step.chained)
        for name in self.step.chained:
            words += [option(name), str(self.input(name))] if name in stated else []
        for name in self.step.outputs:
            words += [option(name), str(self.place(name))]
        if self.step.options:
            words += ["--options", json.dumps(self.provenance.get("options") or {}, ensure_ascii=False)]
        return shlex.join(words)

    def _file(self) -> list[str]:
        """Return the mesh file of the source from the job's log, because records hold no paths."""
        if "file" not in self.provenance.get("input_sha256", {}):
            return []
        log = self.paths.at(self.paths.log("sources", "object"), object=self.object)
        return logged(log, "--file=") or [self.content.get("file") or "FILE"]


def logged(log: str | Path, option: str) -> list[str]:
    """Return the values of ``option`` in the command at the beginning of a job's log; [] without a log."""
    log = Path(log)
    words = shlex.split(log.read_text(encoding="utf-8").split("\n")[0]) if log.is_file() else []
    return [word.removeprefix(option) for word in words if word.startswith(option)]


def jobs(paths: Paths, object_id: str) -> list[Made]:
    """Return every job of an object, in the order of the chain."""
    return [Made(paths, step, object_id, solidity) for step in CHAIN for solidity in step.bodies(SOLIDITIES)]


def packed_jobs(paths: Paths, object_id: str, group, making: dict) -> list[Made]:
    """Return the jobs whose products are in an object's group of a shard, with the records stored there.

    For stages without a record in the group, ``making`` of the shard states all but the checksums.
    """
    found = []
    for made in jobs(paths, object_id):
        body = made.solidity or made.step.only
        if body and (body not in group or "refusal_reason" in group[body].attrs):
            continue
        place = made.step.packed.format(solidity=made.solidity)
        if place and place in group:
            stated = group[place].asstr()[()]
        elif made.step.name in making:
            stated = json.dumps({"provenance": {"stage": made.step.name, **making[made.step.name]}})
        else:
            continue
        found.append(Made(paths, made.step, object_id, made.solidity, stated))
    return found


def makers(all_jobs: list[Made]) -> dict[Path, Made]:
    """Return the job that makes each path."""
    return {path: made for made in all_jobs for path in made.outputs}


def chain(last: list[Made]) -> list[Made]:
    """Return jobs and all jobs that they depend on, each once, in the order of the chain."""
    wanted: list[Made] = []
    for object_id in dict.fromkeys(made.object for made in last):
        known = jobs(last[0].paths, object_id)
        made_by = makers(known)
        waiting = [made for made in last if made.object == object_id]
        needed = set()
        while waiting:
            made = waiting.pop()
            needed.add(made)
            inputs = (made_by.get(made.input(name)) for name in made.step.chained)
            waiting += [before for before in inputs if before is not None and before not in needed]
        wanted += [made for made in known if made in needed]
    return wanted


def needed(paths: Paths, object_id: str, solidity: str, last: str) -> list[Made]:
    """Return the stage ``last`` of one body and all jobs that it needs, in the order of the chain."""
    return chain(
        [made for made in jobs(paths, object_id) if (made.step.name, made.solidity) == (last, solidity)]
    )


def after(first: Made) -> list[Made]:
    """Return a job and all jobs of its object that depend on it."""
    touched, files = [first], set(first.outputs)
    for made in jobs(first.paths, first.object):
        if made != first and files & {made.input(name) for name in made.step.chained}:
            touched.append(made)
            files |= set(made.outputs)
    return touched
