"""Which stage made which file from which: the chain of one object, as a table over the patterns of ``paths.py``.

Rules state the same for Snakemake (a test holds both together); here it serves what looks at finished products: tracing
one back to its source, and finding those that are not what later ones were made of.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace

from vibraverse.contract import products
from vibraverse.flow.paths import SOLIDITIES, Paths


@dataclass(frozen=True, eq=False)
class Step:
    """A stage of an object's chain: its arguments and the patterns that they mean (names in :class:`Paths`).

    ``states`` is what states the provenance: an output, or a file in one that is a folder. ``of_body`` tells whether
    there is one job per body.
    """

    stage: str
    inputs: dict[str, str]
    outputs: dict[str, str]
    states: str
    of_body: bool = False
    solidities: tuple[str, ...] = ("",)


def _body(stage: str, inputs: dict, outputs: dict, states: str) -> Step:
    return Step(stage, inputs, outputs, states, True, SOLIDITIES)


#: The stages of an object, in the order of the chain.
STEPS = (
    Step("sources", {}, {"mesh": "source_mesh", "record": "source_record"}, "source_record"),
    Step(
        "clean",
        {"mesh": "source_mesh", "source_record": "source_record"},
        {"surface": "surface", "record": "clean_record"},
        "clean_record",
    ),
    Step("grids", {"surface": "surface"}, {"grids": "grids", "coarse": "coarse"}, "grids"),
    Step("images", {"surface": "surface"}, {"views": "views"}, "images_record"),
    Step(
        "hollow",
        {"surface": "surface", "grids": "grids"},
        {"hollow_surface": "hollow_surface", "record": "hollow_record"},
        "hollow_record",
    ),
    _body("tets", {"surface": "boundary"}, {"tets": "tets", "record": "tets_record"}, "tets_record"),
    _body("basis", {"tets": "tets"}, {"basis": "basis"}, "basis"),
    _body("modes", {"basis": "basis", "tets": "tets", "clean_record": "clean_record"}, {"modes": "modes"}, "modes"),
    _body("audio", {"basis": "basis", "modes": "modes"}, {"sounds": "sounds"}, "audio_record"),
)  # fmt: skip


#: Where a shard holds the records of stages, in an object's group.
_PACKED = {
    "sources": "source",
    "clean": "clean",
    "hollow": "hollow/cavity",
    "tets": "{solidity}/tets/record",
    "audio": "{solidity}/audio",
}


@dataclass(frozen=True)
class Made:
    """One job of the chain: a step, for an object and, where there is one per body, a solidity.

    ``stated`` is the text of its record, where that is known from elsewhere.
    """

    paths: Paths
    step: Step
    object: str
    solidity: str = ""
    stated: str = ""

    def __str__(self) -> str:
        return f"{self.step.stage} of {self.object}{f' ({self.solidity})' if self.solidity else ''}"

    def input(self, name: str) -> Path:
        """Return the path of an input."""
        pattern = getattr(self.paths, self.step.inputs[name])
        if callable(pattern):
            pattern = pattern(SimpleNamespace(solidity=self.solidity))
        return Path(self.paths.at(pattern, object=self.object, solidity=self.solidity))

    def place(self, name: str) -> Path:
        """Return the path of an output, a file or a folder."""
        return self._at(self.step.outputs[name])

    def output(self, name: str) -> list[Path]:
        """Return the files of an output: itself, or those of a folder, as its record says or as they lie there."""
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
        return self._at(self.step.states)

    def _at(self, name: str) -> Path:
        return Path(self.paths.at(getattr(self.paths, name), object=self.object, solidity=self.solidity))

    @cached_property
    def content(self) -> dict:
        """What the record says, or what is ``stated`` of it; empty where it is missing, refused or broken."""
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
        """The provenance in :attr:`content`."""
        return self.content.get("provenance", {})

    def command(self) -> str:
        """Return the command that makes the outputs again, from the options that the record states."""
        words = ["vibraverse", self.step.stage, "--object", self.object]
        words += ["--solidity", self.solidity] if self.step.of_body else []
        words += [f"--file={file}" for file in self._file()]
        stated = self.provenance.get("input_sha256", self.step.inputs)
        for name in self.step.inputs:
            words += [_option(name), str(self.input(name))] if name in stated else []
        for name in self.step.outputs:
            words += [_option(name), str(self.place(name))]
        options = self.provenance.get("options") or {}
        return shlex.join([*words, "--options", json.dumps(options, ensure_ascii=False)])

    def _file(self) -> list[str]:
        """Return the mesh that the source came from, as the job's log says: records do not hold paths."""
        if "file" not in self.provenance.get("input_sha256", {}):
            return []
        log = self.paths.at(self.paths.log("sources", "object"), object=self.object)
        return logged(log, "--file=") or [self.content.get("file") or "FILE"]


def logged(log: str | Path, option: str) -> list[str]:
    """Return what follows ``option`` in the words of the command that a job's log begins with; [] without a log."""
    log = Path(log)
    words = shlex.split(log.read_text(encoding="utf-8").split("\n")[0]) if log.is_file() else []
    return [word.removeprefix(option) for word in words if word.startswith(option)]


def jobs(paths: Paths, object_id: str) -> list[Made]:
    """Return every job of an object, in the order of the chain."""
    return [Made(paths, step, object_id, solidity) for step in STEPS for solidity in step.solidities]


def packed_jobs(paths: Paths, object_id: str, group, making: dict) -> list[Made]:
    """Return the jobs whose products an object's group of a shard holds, as the shard states them.

    What the group holds no record of is stated by ``making``, the shard's own, but for its checksums.
    """
    found = []
    for made in jobs(paths, object_id):
        body = made.solidity or ("hollow" if made.step.stage == "hollow" else "")
        if body and (body not in group or "refusal_reason" in group[body].attrs):
            continue
        place = _PACKED.get(made.step.stage, "").format(solidity=made.solidity)
        if place in group:
            stated = group[place].asstr()[()]
        elif made.step.stage in making:
            stated = json.dumps({"provenance": {"stage": made.step.stage, **making[made.step.stage]}})
        else:
            continue
        found.append(Made(paths, made.step, object_id, made.solidity, stated))
    return found


def makers(all_jobs: list[Made]) -> dict[Path, Made]:
    """Return which job makes each path."""
    return {path: made for made in all_jobs for path in made.outputs}


def chain(last: list[Made]) -> list[Made]:
    """Return jobs and all that came before them, each once, first things first."""
    wanted: list[Made] = []
    for object_id in dict.fromkeys(made.object for made in last):
        known = jobs(last[0].paths, object_id)
        made_by = makers(known)
        waiting = [made for made in last if made.object == object_id]
        needed = set()
        while waiting:
            made = waiting.pop()
            needed.add(made)
            inputs = (made_by.get(made.input(name)) for name in made.step.inputs)
            waiting += [before for before in inputs if before is not None and before not in needed]
        wanted += [made for made in known if made in needed]
    return wanted


def after(first: Made) -> list[Made]:
    """Return a job and all that come after it in the chain of its object."""
    touched, files = [first], set(first.outputs)
    for made in jobs(first.paths, first.object):
        if made != first and files & {made.input(name) for name in made.step.inputs}:
            touched.append(made)
            files |= set(made.outputs)
    return touched


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
