"""A results folder with one object whose bodies are real, small ones: boxes, through the workflow's own stages."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

import make_page
from make_products import call, provenance
from meshes import box
from vibraverse.contract import products
from vibraverse.contract.seeds import rng
from vibraverse.files.basis import write_basis
from vibraverse.files.tets import write_tets
from vibraverse.flow.paths import Paths
from vibraverse.physics.basis import build_basis
from vibraverse.physics.materials import MATERIALS

OBJECT = "box-0000"
TITLE = "A box </script> \u202eof\u2028 wood & steel"
MODES = 24
SIZE_M = 0.2
MATERIAL_NAMES = ("steel", "glass", "wood")
#: Where the sounds of the run strike, in normalised coordinates.
POINTS = ((0.9, 0.22, 0.13), (0.31, -0.6, 0.11))
#: Sides and cells of the two bodies; the second one stands for a hollow body.
_BOXES = {"solid": ((1.8, 1.2, 0.7), (6, 4, 3)), "hollow": ((1.8, 1.2, 0.5), (6, 4, 2))}


def make(results: Path) -> Paths:
    """Write the products of the object and run the stages from ``modes`` to ``page_object``."""
    paths = Paths(results)

    def at(pattern: str, **more) -> Path:
        path = Path(paths.at(pattern, object=OBJECT, **more))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    source = {
        "object": OBJECT,
        "origin": "generated",
        "title": TITLE,
        "category": "block",
        "licence": "CC0-1.0",
    }
    products.write_json(
        at(paths.source_record), {**source, "file": f"{OBJECT}.ply", "attribution": "A. Joiner"}
    )
    clean = {"size_m": SIZE_M, "size_origin": "generated", "repairs": [], "dropped": {"volume_share": 0.0}}
    products.write_json(at(paths.clean_record), {**clean, "deviation": {"invented": 0.0}})
    products.write_json(at(paths.hollow_record), {"t": 0.5})
    views = at(paths.images_record)
    for number in range(6):
        Image.new("RGB", (64, 64), (40 * number, 120, 120)).save(views.parent / f"clay-{number:02d}.png")
    products.write_json(views, {"views": [{}] * 6, "looks": ["clay"]})
    for solidity, (sides, cells) in _BOXES.items():
        _body(at, paths, solidity, *box(sides, cells))

    def of_bodies(pattern: str) -> list[Path]:
        return [at(pattern, solidity=solidity) for solidity in _BOXES]

    call(
        "page_object", "--object", OBJECT,
        "--source-record", at(paths.source_record), "--clean-record", at(paths.clean_record),
        "--views", at(paths.views), "--hollow-record", at(paths.hollow_record),
        "--tets-record", *of_bodies(paths.tets_record), "--modes", *of_bodies(paths.modes),
        "--sounds", *of_bodies(paths.sounds), "--basis", *of_bodies(paths.basis),
        "--page-body-record", *of_bodies(paths.page_body_record),
        "--script", at(paths.page_object), "--turn", at(paths.page_turn),
        "--thumbnail", at(paths.page_thumbnail), "--record", at(paths.page_object_record),
    )  # fmt: skip
    return paths


def _body(at, paths: Paths, solidity: str, points, cells) -> None:
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    write_tets(at(paths.tets, solidity=solidity), points, cells)
    record = {"tetrahedra": len(cells), "warnings": [], "quality": {"wanted": 100}}
    products.write_json(at(paths.tets_record, solidity=solidity), record)
    with products.hdf5(at(paths.basis, solidity=solidity)) as h5:
        write_basis(h5, build_basis(points, cells, rng=rng("page", solidity), modes=MODES))
        products.write_provenance(h5, provenance("basis", OBJECT, solidity))
    about = ("--object", OBJECT, "--solidity", solidity)
    basis, modes = (
        ("--basis", at(paths.basis, solidity=solidity)),
        ("--modes", at(paths.modes, solidity=solidity)),
    )
    options = {"materials": {name: MATERIALS[name] for name in MATERIAL_NAMES}, "modes": MODES}
    tets, clean = ("--tets", at(paths.tets, solidity=solidity)), ("--clean-record", at(paths.clean_record))
    call("modes", *about, *basis, *tets, *clean, *modes, "--options", json.dumps(options))
    sounds = ("--sounds", at(paths.sounds, solidity=solidity))
    call("audio", *about, *basis, *modes, *sounds, "--options", json.dumps({"points": POINTS, "max_s": 1.0}))
    outputs = ("--script", at(paths.page_body, solidity=solidity))
    outputs += ("--record", at(paths.page_body_record, solidity=solidity))
    call("page_body", *about, *basis, *modes, *outputs)


def page(paths: Paths) -> Path:
    """Write a page of 300 invented objects beside the data of the object, and return it."""
    return make_page.write(Path(paths.page_object).parents[2], make_page.invented(300))


def data(paths: Paths) -> dict:
    """Return the content of the object's script."""
    return _content(Path(paths.at(paths.page_object, object=OBJECT)))


def body(paths: Paths, solidity: str) -> dict:
    """Return the content of a body's script."""
    return _content(Path(paths.at(paths.page_body, object=OBJECT, solidity=solidity)))


def _content(script: Path) -> dict:
    text = script.read_text(encoding="ascii")
    return json.loads(text[text.index("{") : text.rindex("}") + 1])
