"""Run a family's stages on tiny inputs, with the image's own content only: ``check.py FAMILY``.

Stages, inputs and products come from ``flow/steps.py``; products of other families' stages are written by hand. An
image holds only its family's packages, so this script needs no others: it calls the library directly where a stage
would need more.

A build runs it twice: while the image is writable, so that every compiled loop is stored in it, and afterwards as the
image's test. It needs no network and writes only to a temporary folder.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import re
import sys
import tempfile
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vibraverse.contract.step import Step

HOME = Path("/opt/vibraverse")
OBJECT = "bar-0000"
#: The cheapest body of the validation.
KNOWN = "block"
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


def box(cells: int = 1) -> tuple:
    """Return points (N, 3) and tetrahedra (6 cells³, 4) of a box with this many cells along each side."""
    import numpy as np

    across = cells + 1
    steps = np.arange(across) / cells * 2 - 1
    points = np.array([(0.9 * x, 0.3 * y, 0.2 * z) for x in steps for y in steps for z in steps])
    corner = np.array([x * across**2 + y * across + z for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    rings = [(1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)]
    one = corner[[(0, 7, b, a) for a, b in rings]]
    at = [x * across**2 + y * across + z for x in range(cells) for y in range(cells) for z in range(cells)]
    return points, np.concatenate([one + first for first in at])


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
                    "features": {"points": 512},
                    "frequencies": {"models": ["ritz", "subspace"], "training": {"steps": 3}},
                    "solidity": {"models": ["informed"], "training": {"steps": 3}},
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
        return list(dict.fromkeys(self.at(name, body=KNOWN, **wildcards) for wildcards in named))

    def jobs(self, step: Step) -> list[dict[str, str]]:
        """Return the wildcards of every job that a stage has."""
        from vibraverse.contract import step as per

        objects = [{"object": name} for name in self.plan.objects]
        solidities = self.plan.config.solidities
        return {
            per.OBJECT: objects,
            per.BODY: [{**one, "solidity": solidity} for one in objects for solidity in solidities],
            per.SHARD: [{"shard": shard} for shard in self.plan.shards],
            per.KNOWN_BODY: [{"body": KNOWN}],
            per.TRAINING: self.plan.trainings(),
            per.COMPARISON: [{"task": task, "split": "object"} for task in self.plan.config.learn.tasks],
        }.get(step.per, [{}])

    def run(self, step: Step, wildcards: dict[str, str]) -> None:
        """Run one job of a stage, and check that all its products exist."""
        from vibraverse.cli import main
        from vibraverse.contract.refusal import read_refusal
        from vibraverse.contract.step import SHARD, option

        if step.per == SHARD:
            refuse_missing(self, **wildcards)
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
            paths = self.all_of(input_.pattern) if input_.many else [self.at(input_.pattern, **wildcards)]
            for path in paths:
                if not path.exists():
                    BY_HAND[input_.pattern](self, path)
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

    def options(self, step: Step, wildcards: dict[str, str]) -> str:
        """Return the options of a job as the rules give them."""
        if "task" in wildcards:
            make = self.plan.training if "model" in wildcards else self.plan.comparison
            return make(SimpleNamespace(**wildcards))
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

    if family == LEARN:
        open_for_training(check)
    families = {step.family for step in STEPS} - {LEARN} if family == WORKSTATION else {family}
    for step in in_order([step for step in STEPS if step.family in families]):
        for wildcards in check.jobs(step):
            check.run(step, wildcards)
        if step.name == "features":
            bodies(check)


# Products of other families' stages


def tets(check: Check, path: Path) -> None:
    """Write a box of tetrahedra."""
    from vibraverse.files.tets import write_tets

    write_tets(path, *box())


def clean_record(check: Check, path: Path) -> None:
    """Write the size of an object."""
    path.write_text(json.dumps({"size_m": 0.2, "size_origin": "generated"}))


def surface(check: Check, path: Path) -> None:
    """Write the surface of a box."""
    from vibraverse.files.meshes import write_ply

    points, cells = box()
    seen: dict[frozenset, tuple] = {}
    for a, b, c, d in cells.tolist():
        for face in ((b, c, d), (a, d, c), (a, b, d), (a, c, b)):
            seen[frozenset(face)] = () if frozenset(face) in seen else face
    write_ply(path, points, [face for face in seen.values() if face])


def known_meshes(check: Check, path: Path) -> None:
    """Write two meshes of a box."""
    import h5py

    with h5py.File(path, "w") as h5:
        h5.attrs["scale_m"] = 0.01
        for number, cells in enumerate((3, 4)):
            h5[f"{number}/points"], h5[f"{number}/cells"] = box(cells)


def comparison(check: Check, path: Path) -> None:
    """Write the comparison of two meshes of a body with one reference."""
    reference = {"mode": "1", "equal": 1, "poisson": 0.3, "reference_hz": 1000.0, "tolerance": 0.1}
    about = {"order": 2, "corrected": "no", "verdict": "met", "published": False, "source": "made up"}
    rows = [
        {"body": KNOWN, **reference, "computed_hz": 1000 * (1 + error), "relative_error": error, **about, "tetrahedra": unknowns // 3, "unknowns": unknowns}
        for unknowns, error in ((300, 0.01), (3000, 0.001))
    ]  # fmt: skip
    path.write_text(json.dumps({"body": KNOWN, "rows": rows}))


def configuration(check: Check, path: Path) -> None:
    """Write the configuration with every default filled in, as JSON, which is YAML; images have no YAML library."""
    path.write_text(json.dumps(check.plan.config.model_dump(mode="json")), encoding="utf-8")


def refuse_missing(check: Check, shard: str) -> None:
    """Write a refusal in place of every missing product of a shard's objects."""
    from vibraverse.contract import products
    from vibraverse.contract.refusal import Refusal
    from vibraverse.flow import targets

    refusal = Refusal(OBJECT, "clean", "empty", "nothing to see", "add triangles").to_text()
    for product in map(Path, targets.shard_products(check.plan, shard)):
        if not product.exists():
            products.write_text(product, refusal)
    for object_ in check.plan.shards[shard]:
        record = check.at("source_record", object=object_)
        if record.read_text(encoding="utf-8") == refusal:
            source = {"object": object_, "origin": "files", "format": "off", "file": f"{object_}.off"}
            products.write_json(record, {**source, "provenance": {}})


def packed(check: Check, path: Path) -> None:
    """Write a shard of refused objects with the library."""
    import h5py

    from vibraverse.config.dataset import ShardOptions
    from vibraverse.contract import products
    from vibraverse.dataset.write.pack import finish, pack_object

    refuse_missing(check, path.stem)
    options = ShardOptions.model_validate_json(check.plan.options("dataset", shard=path.stem))
    with h5py.File(path, "w") as h5:
        groups = h5.create_group("objects")
        rows = [pack_object(groups, check.plan.paths, name, options, path.name) for name in options.objects]
        finish(h5, rows)
        products.write_provenance(h5, {"stage": "dataset", "libraries": {}})


def indexed(check: Check, path: Path) -> None:
    """Write the index, the refusals and the record of a dataset with the library."""
    from vibraverse.contract import products
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.summary import summary

    shards = check.all_of("shard")
    for shard in shards:
        if not shard.exists():
            packed(check, shard)
    with Reader(shards) as reader:
        write_index(check.at("index_columns"), reader.index)
        products.write_json(check.at("dataset_record"), {**summary(reader, {}), "shards": {}})


#: Functions that write the products of other families' stages, by pattern.
BY_HAND = {
    "tets": tets,
    "clean_record": clean_record,
    "surface": surface,
    "validation_meshes": known_meshes,
    "validation_comparison": comparison,
    "config": configuration,
    "shard": packed,
    "index_columns": indexed,
    "dataset_record": indexed,
}


def open_for_training(check: Check) -> None:
    """Open a dataset with the reader for PyTorch."""
    import torch

    import vibraverse.dataset

    (shard,) = check.all_of("shard")
    packed(check, shard)
    assert isinstance(vibraverse.dataset.torch_dataset(shard), torch.utils.data.Dataset)


def bodies(check: Check) -> None:
    """Write features of twelve objects, both bodies, in place of the shard's, and their splits."""
    import numpy as np

    from vibraverse.learn import features, inside

    random, (folder,) = np.random.default_rng(0), check.all_of("features")
    objects = [f"bar-{number:04d}" for number in range(12)]
    count, modes = 2 * len(objects), 8
    steel, mesh = {"density_kg_m3": 7850.0, "young_pa": 2e11, "poisson": 0.25}, inside.describe(*box(2))
    features.write_meshes(folder, [mesh] * count)
    spectra = np.sort(random.normal(size=(count, 3, modes)), axis=-1).astype(np.float32)
    arrays = {
        "points": random.uniform(-0.9, 0.9, (count, 512, 6)).astype(np.float32),
        "invariants": random.uniform(1, 2, (count, 5)).astype(np.float32),
        "log_omega": spectra,
        "ritz": spectra[:, :, None] + np.array([0.3, 0.2, 0.1], np.float32)[:, None],
        "frequencies_hz": 1000 * np.exp(spectra[:, :1]).astype(float),
        "scales": np.tile(mesh["scales"], (count, 1)),
        **dict.fromkeys(("volume_m3", "size_m"), np.full(count, 0.1)),
        "thickness": np.tile([np.nan, 0.5], len(objects)),
        "object_row": np.repeat(np.arange(len(objects)), 2),
        "views": random.integers(0, 256, (len(objects), 2, 64, 64, 3), dtype=np.uint8),
    }
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    both = {"object": np.repeat(objects, 2).tolist(), "solidity": ["solid", "hollow"] * len(objects)}
    both |= {"origin": ["generated"] * count, "family": ["bar"] * count}
    named = {"objects": objects, "materials": {"steel": steel}, "poisson": [0.1, 0.25, 0.4]}
    (folder / "features.json").write_text(json.dumps({"bodies": both, "ritz_degrees": [4, 6, 8], **named}))
    lines = "".join(map("{}\t{}\t\n".format, objects, ["train"] * 8 + ["validation"] * 2 + ["test"] * 2))
    check.at("splits").write_text(f"object\tsplit\tcopy_of\n{lines}")


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
