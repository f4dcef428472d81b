"""Each stage finds in its own environment whatever its code can import.

Read from the source, without running it: a conda or container user has one family's packages only, whereas the
developer who forgets to list one has them all.
"""

from __future__ import annotations

import ast
import importlib.metadata
import re
import sys
from functools import cache
from pathlib import Path

import pytest

WORKFLOW = Path(__file__).resolve().parent.parent / "workflow"
ENVS = WORKFLOW.parent / "envs"

#: Modules a stage's code mentions without its job reaching them: the command's own reading of YAML, the PyTorch
#: reader, the validator, the warm process, which imports what there is.
NOT_ENTERED = (
    "vibraverse.config",
    "vibraverse.dataset.read.pytorch",
    "vibraverse.dataset.check.validator",
    "vibraverse.machine.warm_process",
)


def source(module: str) -> Path | None:
    path = WORKFLOW.joinpath(*module.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


@cache
def imports(module: str) -> frozenset[str]:
    """Return what a module imports anywhere in it; of ours also names that may be submodules."""
    found = set()
    for node in ast.walk(ast.parse(source(module).read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} uses a relative import"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def third_party(start: str) -> dict[str, str]:
    """Return the outside packages that ``start`` can import, each with a module of ours that does."""
    waiting, seen, outside = [start], set(), {}
    while waiting:
        module = waiting.pop()
        if module in seen or source(module) is None or (module != start and module.startswith(NOT_ENTERED)):
            continue
        seen.add(module)
        for name in imports(module):
            if name.startswith("vibraverse"):
                waiting.append(name)
            else:
                outside.setdefault(name.split(".")[0], module)
    return {name: who for name, who in outside.items() if name not in sys.stdlib_module_names}


def jobs() -> list[tuple[str, str]]:
    """Return (module, environment) for each rule that runs a stage, and for learning."""
    found = [("vibraverse.dataset.read.pytorch", "learn")]
    for path in sorted((WORKFLOW / "rules").glob("*.smk")):
        for rule in re.split(r"^ *rule ", path.read_text(), flags=re.MULTILINE)[1:]:
            stage, environment = (
                re.search(r'"vibraverse (\w+)', rule),
                re.search(r"envs/(\w+)\.yaml", rule),
            )
            if stage and environment and source(f"vibraverse.stages.{stage[1]}"):
                found.append((f"vibraverse.stages.{stage[1]}", environment[1]))
    return found


def test_every_stage_is_looked_at():
    stages = {path.stem for path in (WORKFLOW / "vibraverse/stages").glob("*.py")} - {"__init__"}
    assert {module.rpartition(".")[2] for module, _ in jobs()} >= stages
    assert {"numpy", "gmsh", "meshio"} <= set(third_party("vibraverse.stages.tets"))


@pytest.mark.parametrize(("module", "environment"), jobs())
def test_an_environment_holds_what_its_stages_import(module, environment):
    locked = set(
        re.findall(r"^([a-z0-9-]+)==", (ENVS / f"{environment}.txt").read_text(), flags=re.MULTILINE)
    )
    # What only the environment of learning holds is not installed here to be asked.
    distributions = {
        "sklearn": ["scikit-learn"],
        "skimage": ["scikit-image"],
        **importlib.metadata.packages_distributions(),
    }
    for package, importer in third_party(module).items():
        names = {name.lower().replace("_", "-") for name in distributions.get(package, [package])}
        assert names & locked, f"{importer} imports {package}, which envs/{environment}.txt does not hold"
