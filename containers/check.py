"""Run a family's stages on tiny inputs, from what the image holds and nothing else: ``check.py FAMILY``.

The build runs it twice: while the image can still be written, so that every compiled loop is kept in it, and
afterwards as the image's test. It needs no network and writes to a temporary folder alone.
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

HOME = Path("/opt/vibraverse")
OBJECT = "bar-0000"

#: Two boxes that cross: the exact tests of the cleaning have something to find.
_CROSSED = """OFF
16 24 0
{vertices}
{faces}
"""


def crossed() -> str:
    """Return two boxes that reach through each other, as an OFF file."""
    corners = [(x, y, z) for x in (0, 4) for y in (0, 1) for z in (0, 1)]
    moved = [(y + 1.3, x - 1.2, z + 0.3) for x, y, z in corners]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(s[0], s[k], s[k + 1]) for s in sides for k in (1, 2)]
    turned = [tuple(v + 8 for v in reversed(f)) for f in faces]
    return _CROSSED.format(
        vertices="\n".join("{} {} {}".format(*p) for p in corners + moved),
        faces="\n".join("3 {} {} {}".format(*f) for f in faces + turned),
    )


def box() -> tuple:
    """Return the corners (8, 3) and the six tetrahedra (6, 4) of a box."""
    import numpy as np

    points = np.array([(x, y, z) for x in (-0.9, 0.9) for y in (-0.3, 0.3) for z in (-0.2, 0.2)])
    rings = [(1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)]
    return points, np.array([(0, 7, b, a) for a, b in rings])


class Check:
    """A folder with a tiny plan, in which stages run as the rules call them."""

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
            }
        )

    def at(self, pattern: str, object_: str = OBJECT, solidity: str = "solid", **more: str) -> Path:
        """Return a product's path, its folder made."""
        path = Path(self.plan.paths.at(pattern, object=object_, solidity=solidity, **more))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def run(self, stage: str, *arguments, object_: str = OBJECT, solidity: str = "", **products) -> None:
        """Run a stage; products are named like its arguments."""
        from vibraverse.cli import main
        from vibraverse.contract.refusal import read_refusal

        command = [stage, *arguments]
        if stage not in ("dataset", "index", "report"):
            command += ["--object", object_]
        if solidity:
            command += ["--solidity", solidity]
        for name, path in products.items():
            command += [f"--{name.replace('_', '-')}", path]
        assert main([str(word) for word in command]) == 0, f"{stage} failed"
        for product in products.values():
            for path in sorted(product.iterdir()) if product.is_dir() else [product]:
                assert path.stat().st_size, f"{stage}: {path} is empty"
                assert stage in _COLLECT or read_refusal(path) is None, path.read_text()

    def options(self, stage: str, object_: str = OBJECT) -> tuple[str, str]:
        """Return a stage's options as its rule passes them."""
        return "--options", self.plan.options(stage, object_=object_, shard=self.plan.shard_of(object_))


_COLLECT = ("dataset", "index", "report")


def geometry(check: Check) -> None:
    """From a generated bar, and from two crossed boxes, to tetrahedra."""
    paths = check.plan.paths
    for object_, entry in check.plan.objects.items():

        def at(pattern: str, solidity: str = "solid", object_: str = object_) -> Path:
            return check.at(pattern, object_, solidity)

        def run(stage: str, *more, solidity: str = "", object_: str = object_, **products) -> None:
            check.run(
                stage, *check.options(stage, object_), *more, object_=object_, solidity=solidity, **products
            )

        source = {"mesh": at(paths.source_mesh), "record": at(paths.source_record)}
        run("sources", *(["--file", entry.input] if entry.input else []), **source)
        surface = at(paths.surface)
        run(
            "clean", mesh=source["mesh"], source_record=source["record"],
            surface=surface, record=at(paths.clean_record),
        )  # fmt: skip
        grids, hollowed = at(paths.grids), at(paths.hollow_surface)
        run("grids", surface=surface, grids=grids, coarse=at(paths.coarse))
        run(
            "hollow", surface=surface, grids=grids,
            hollow_surface=hollowed, record=at(paths.hollow_record),
        )  # fmt: skip
        for solidity, boundary in (("solid", surface), ("hollow", hollowed)):
            run(
                "tets", solidity=solidity, surface=boundary,
                tets=at(paths.tets, solidity), record=at(paths.tets_record, solidity),
            )  # fmt: skip


def fem(check: Check) -> None:
    """From a box of six tetrahedra to a sound."""
    from vibraverse.files.tets import write_tets

    paths = check.plan.paths
    tets, basis, modes = check.at(paths.tets), check.at(paths.basis), check.at(paths.modes)
    record = check.at(paths.clean_record)
    write_tets(tets, *box())
    record.write_text(json.dumps({"size_m": 0.2, "size_origin": "generated"}))
    check.run("basis", *check.options("basis"), solidity="solid", tets=tets, basis=basis)
    check.run(
        "modes", *check.options("modes"), solidity="solid",
        basis=basis, tets=tets, clean_record=record, modes=modes,
    )  # fmt: skip
    check.run(
        "audio", *check.options("audio"), solidity="solid", basis=basis, modes=modes, sounds=check.at(paths.sounds),
    )  # fmt: skip


def render(check: Check) -> None:
    """A view of a box."""
    from vibraverse.files.meshes import write_ply

    points, tets = box()
    surface = check.at(check.plan.paths.surface)
    write_ply(surface, points, _boundary(tets))
    views = check.at(check.plan.paths.views)
    check.run("images", *check.options("images"), surface=surface, views=views)


def _boundary(tets) -> list[tuple[int, ...]]:
    """Return the faces that belong to one tetrahedron alone."""
    seen: dict[frozenset, tuple] = {}
    for a, b, c, d in tets.tolist():
        for face in ((b, c, d), (a, d, c), (a, b, d), (a, c, b)):
            seen[frozenset(face)] = () if frozenset(face) in seen else face
    return [face for face in seen.values() if face]


def refuse_all(check: Check) -> Path:
    """Put a refusal in the place of every product; return the path of the shard they belong to."""
    from vibraverse.contract import products
    from vibraverse.contract.refusal import Refusal
    from vibraverse.flow import targets

    refusal = Refusal(OBJECT, "clean", "empty", "nothing to see", "add triangles").to_text()
    for product in targets.shard_products(check.plan, check.plan.shard_of(OBJECT)):
        products.write_text(product, refusal)
    for object_ in check.plan.objects:
        source = {"object": object_, "origin": "files", "format": "off", "file": f"{object_}.off"}
        products.write_json(check.at(check.plan.paths.source_record, object_), {**source, "provenance": {}})
    (shard,) = targets.shards(check.plan)
    return check.at(shard)


def dataset(check: Check) -> None:
    """A dataset of refused objects: all tables, no arrays."""
    shard = refuse_all(check)
    check.run("dataset", *check.options("dataset"), shard=shard)
    paths = check.plan.paths
    names = {
        "record": "dataset_record",
        "columns": "index_columns",
        "parquet": "index_parquet",
        "sums": "dataset_sums",
    }
    same = ("index", "splits", "refusals", "card", "overview", "croissant")
    found = {name: check.at(getattr(paths, names.get(name, name))) for name in (*same, *names)}
    check.run("index", *check.options("index"), shards=shard, **found)


def packed(check: Check) -> Path:
    """Return a shard of refused objects, packed by the library, as the stage needs more packages."""
    import h5py

    from vibraverse.config.dataset import ShardOptions
    from vibraverse.contract import products
    from vibraverse.dataset.write.pack import finish, pack_object

    shard = refuse_all(check)
    options = ShardOptions.model_validate_json(check.options("dataset")[1])
    with h5py.File(shard, "w") as h5:
        groups = h5.create_group("objects")
        finish(
            h5, [pack_object(groups, check.plan.paths, name, options, shard.name) for name in options.objects]
        )
        products.write_provenance(h5, {"stage": "dataset", "libraries": {}})
    return shard


def report(check: Check) -> None:
    """The page of a dataset of refused objects, indexed by the library."""
    from vibraverse.contract import products
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.summary import summary

    shard = packed(check)
    paths = check.plan.paths
    index = {"index": paths.index_columns, "record": paths.dataset_record}
    index = {name: check.at(path) for name, path in index.items()}
    with Reader([shard]) as reader:
        write_index(index["index"], reader.index)
        products.write_json(index["record"], {**summary(reader, {}), "shards": {}})
    check.run("report", *check.options("report"), shards=shard, **index, page=check.at(paths.report))


def learn(check: Check) -> None:
    """The reader for PyTorch opens a dataset, and a network learns a line, on a GPU where there is one."""
    import torch

    import vibraverse.dataset

    data = vibraverse.dataset.torch_dataset(packed(check))
    assert isinstance(data, torch.utils.data.Dataset)
    torch.manual_seed(0)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    x = torch.linspace(-1, 1, 64, device=device)[:, None]
    network = torch.nn.Linear(1, 1).to(device)
    optimiser = torch.optim.SGD(network.parameters(), 0.5)
    for _ in range(100):
        optimiser.zero_grad()
        torch.nn.functional.mse_loss(network(x), 3 * x + 1).backward()
        optimiser.step()
    assert abs(network.weight.item() - 3) + abs(network.bias.item() - 1) < 1e-3


def everything(check: Check) -> None:
    """What each family does."""
    for family in (geometry, render, fem, dataset, report):
        family(check)


STAGES = {
    "geometry": geometry,
    "fem": fem,
    "render": render,
    "dataset": dataset,
    "report": report,
    "learn": learn,
    "workstation": everything,
}


def packages(family: str) -> None:
    """Import every package the family asks for by name."""
    extras = tomllib.loads((HOME / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = {re.split(r"[^A-Za-z0-9-]", requirement)[0] for requirement in extras.get(family, [])}
    for module, distributions in importlib.metadata.packages_distributions().items():
        if wanted & set(distributions) and module.isidentifier() and not module.startswith("_"):
            importlib.import_module(module)


def from_elsewhere() -> list[str]:
    """Return the loaded modules that are neither the image's Python nor its environment."""
    own = (str(HOME), f"{sys.base_prefix}/lib/")
    files = {name: getattr(module, "__file__", None) or "" for name, module in sys.modules.items()}
    # One that came from a file has its whole path; torch makes some up, and says so by half a name.
    return [f"{name}: {file}" for name, file in files.items() if file[:1] == "/" and not file.startswith(own)]


def main(family: str) -> None:
    """Check one family; an exception says what is wrong."""
    from vibraverse.machine.compiled import use_compiled_loops

    use_compiled_loops()
    packages(family)
    with tempfile.TemporaryDirectory(prefix="vibraverse-check-") as folder:
        STAGES[family](Check(Path(folder)))
    strangers = [found for found in from_elsewhere() if str(Path(__file__)) not in found]
    assert not strangers, f"not from the image: {strangers}"
    print(f"{family}: its stages run from the image alone")


if __name__ == "__main__":
    main(sys.argv[1])
