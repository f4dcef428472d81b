"""The page of one struck mesh: one HTML file with the view of an object, for ``vibraverse strike --open``."""

from __future__ import annotations

import importlib
import os
import webbrowser
from pathlib import Path
from urllib.parse import urlencode

from vibraverse.commands.one_mesh import OneMesh, run_quietly
from vibraverse.contract import products
from vibraverse.contract.stage import Job, run
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import BY_NAME
from vibraverse.upkeep.lineage import Made

#: Variables of a session that can show a browser.
_SCREENS = ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")


def page(mesh: OneMesh, folder: Path, settings: dict[str, str]) -> str:
    """Return the page of a mesh whose stages up to ``audio`` were run in ``folder``; it opens with ``settings``."""
    from vibraverse.report import single

    body = Made(Paths(folder), BY_NAME["page_body"], mesh.object, mesh.solidity)
    for _ in mesh.run([body]):
        pass
    scripts = [_object(mesh, folder, body), body.place("script").read_text(encoding="ascii")]
    return single.html(mesh.object, mesh.path.stem, scripts, f"#/object?{urlencode(settings)}")


def _object(mesh: OneMesh, folder: Path, body: Made) -> str:
    """Run the stage ``page_object``, without pictures; return its script."""
    step, paths = BY_NAME["page_object"], Paths(folder)
    products.write_json(paths.at(paths.images_record, object=mesh.object), {"views": [], "looks": []})
    one = {name: mesh.at(folder, name) for name in ("source_record", "clean_record")}
    one["views"] = mesh.at(folder, "images_record")
    if mesh.solidity == "hollow":
        one["hollow_record"] = mesh.at(folder, "hollow_record")
    several = {name: [mesh.at(folder, name)] for name in ("tets_record", "modes", "basis")}
    several |= {"sounds": [mesh.at(folder, "audio_record")], "page_body_record": [body.record]}
    final = {name: mesh.at(folder, output.pattern) for name, output in step.outputs.items()}
    work = importlib.import_module(f"vibraverse.stages.{step.name}").run
    run_quietly(
        run, Job(step, mesh.object, "", {**one, **several}, final, None), work, ["vibraverse", step.name]
    )
    return final["script"].read_text(encoding="ascii")


def show(path: Path) -> bool:
    """Open a file in the browser of this session; return whether there is one."""
    return any(map(os.environ.get, _SCREENS)) and webbrowser.open(path.absolute().as_uri())
