"""The structure of the package: which room may import which, the number of floors, the length of files."""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "workflow/vibraverse"

#: What a room must not import, directly or by name in a function.
FORBIDDEN = {
    "contract": {"anything"},
    "geometry": {"files", "config", "sources", "flow", "dataset", "machine"},
    "physics": {"files", "config", "sources", "flow", "dataset", "machine"},
    "listening": {"files", "config", "sources", "flow", "dataset", "machine", "media", "geometry"},
    "media": {"files", "config", "sources", "flow", "dataset", "machine"},
    "files": {"config", "sources", "flow", "dataset", "machine"},
    "flow": {"dataset", "machine", "stages", "commands", "upkeep"},
    "dataset": {"flow.plan", "stages", "commands", "machine", "upkeep"},
    "learn": {"flow.plan", "stages", "commands", "machine", "upkeep"},
    "machine": {"commands", "stages", "dataset", "upkeep", "cli"},
    "upkeep": {"commands", "stages", "cli"},
    "commands": {"stages", "cli"},
    "stages": {"commands", "machine", "upkeep", "cli"},
}
#: Rooms import only rooms below them; so many floors there may be.
FLOORS = 10
LINES = 400


@cache
def modules() -> dict[str, Path]:
    """Return the files of the package by their dotted names."""
    return {
        ".".join(path.relative_to(ROOT / "workflow").with_suffix("").parts).removesuffix(".__init__"): path
        for path in PACKAGE.rglob("*.py")
    }


@cache
def imports(module: str) -> frozenset[str]:
    """Return this project's modules that a module imports anywhere, except for type checking only."""
    found = set()
    pending: list[ast.AST] = [ast.parse(modules()[module].read_text(encoding="utf-8"))]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        pending += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: a relative import hides where it goes"
            found |= {f"{node.module}.{name.name}" for name in node.names} | {node.module}
    ours = {name for name in found if name in modules() and name != module}
    # A package stands for itself only where something is taken from its own file.
    return frozenset(name for name in ours if not any(other.startswith(f"{name}.") for other in ours))


def room(module: str) -> str:
    """Return the room that a module is in; the root's own modules are rooms of one."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "vibraverse"


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return the names along a circle of a graph; empty without a circle."""
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> list[str]:
        if name in above:
            return [*above[above.index(name) :], name]
        if name in done:
            return []
        for other in sorted(graph[name]):
            if found := visit(other, (*above, name)):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(graph) if (found := visit(name, ()))), [])


def rooms() -> dict[str, set[str]]:
    """Return the rooms that each room imports."""
    graph: dict[str, set[str]] = {room(module): set() for module in modules()}
    for module in modules():
        graph[room(module)] |= {room(other) for other in imports(module)} - {room(module)}
    return graph


def test_the_root_holds_rooms_and_the_command_line():
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py", "__main__.py", "cli.py"}
    assert all((path / "__init__.py").is_file() for path in PACKAGE.iterdir() if any(path.glob("*.py")))


def test_no_import_leads_in_a_circle():
    assert circle({module: set(imports(module)) for module in modules()}) == []
    assert circle(rooms()) == []


def test_a_circle_would_be_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


def test_the_house_has_few_floors():
    graph = rooms()

    @cache
    def floor(name: str) -> int:
        return 1 + max(map(floor, graph[name]), default=0)

    floors = {name: floor(name) for name in graph}
    assert max(floors.values()) <= FLOORS, floors


@pytest.mark.parametrize("name", sorted(FORBIDDEN))
def test_a_room_imports_what_it_may(name):
    wrong = []
    for module in modules():
        if room(module) != name:
            continue
        for other in imports(module):
            into = room(other)
            if FORBIDDEN[name] == {"anything"}:
                allowed = into in (name, "vibraverse")
            else:
                inside = other.removeprefix("vibraverse.")
                allowed = not any(inside == each or inside.startswith(f"{each}.") for each in FORBIDDEN[name])
            wrong += [] if allowed else [f"{module} imports {other}"]
    assert wrong == []


def test_the_contract_needs_the_standard_library_alone():
    """A function may import what its stage has anyway; importing the contract costs nothing."""
    for module in modules():
        if room(module) != "contract":
            continue
        for node in ast.parse(modules()[module].read_text(encoding="utf-8")).body:
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            assert {name.split(".")[0] for name in names} <= {*sys.stdlib_module_names, "vibraverse"}


def test_no_file_is_longer_than_it_can_be_read():
    folders = ("workflow", "tests", "benchmarks", "containers", "envs")
    code = {".py", ".smk", ".js", ".css", ".html", ".sh"}
    long = {}
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in code):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        if lines > LINES:
            long[str(path.relative_to(ROOT))] = lines
    assert long == {}
