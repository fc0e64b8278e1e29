"""Imports run in one direction: from file to file without a circle, and from room to room upward."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LINKED = ("modules", "workers", "hw")
"""Folders that `robbie_robots` links to; nothing imports them by these names, or they would exist twice."""
FOLDERS = ("robbie_mp", "tools", *(f"robbie_robots/{folder}" for folder in LINKED))


def module_files() -> dict[str, Path]:
    """Return the project's files by the names with which they are imported."""
    files = {}
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


@cache
def imported(program: Path) -> list[tuple[str, list[str]]]:
    """Return each module that a program names in an import, and the names that it takes from it."""
    return list(found_in(program.read_text()))


def found_in(source: str) -> Iterator[tuple[str, list[str]]]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((name.name, []) for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module, [name.name for name in node.names]


def imports_of(path: Path, files: dict[str, Path]) -> set[str]:
    """Return the files that a file imports; of a package, those that it names in it."""
    found = set()
    for module, names in imported(path):
        inside = {f"{module}.{name}" for name in names} & files.keys()
        found |= inside or {module} & files.keys()
    return found


@pytest.mark.slow
def test_no_imports_run_in_a_circle() -> None:
    files = module_files()
    assert "robbie_mp.station.context" in files
    graph = {name: imports_of(path, files) - {name} for name, path in files.items()}
    assert {"robbie_mp.station.watch.latest", "robbie_mp.messages"} <= graph["robbie_mp.station.context"]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("these import each other: " + " <- ".join(error.args[1]))


def rooms() -> list[str]:
    """Return the rooms of `robbie_mp` in the order of the table in docs/architecture.md."""
    _, _, table = (ROOT / "docs/architecture.md").read_text().partition("| room | contents |\n")
    return re.findall(r"^\| `(\w+)` \|", table.partition("\n\n")[0], re.MULTILINE)


def test_documented_rooms_are_the_rooms_that_there_are() -> None:
    here = {path.parent.name for path in (ROOT / "robbie_mp").glob("*/__init__.py")}
    assert sorted(rooms()) == sorted(here)


def test_no_room_imports_from_one_below_it() -> None:
    files, order = module_files(), rooms()
    upward = [
        f"{name} imports {other}"
        for name, path in files.items()
        if (here := room_of(name))
        for other in imports_of(path, files)
        if (there := room_of(other)) and order.index(here) < order.index(there)
    ]
    assert not upward


def room_of(name: str) -> str:
    """Return the room of a file; none for the face of `robbie_mp` and for other packages."""
    package, _, rest = name.partition(".")
    return rest.partition(".")[0] if package == "robbie_mp" else ""


@pytest.mark.slow
def test_stock_robots_are_imported_by_one_name() -> None:
    programs = [path for folder in (*FOLDERS, "tests") for path in (ROOT / folder).rglob("*.py")]
    assert len(programs) > 1500
    bare = [path for path in programs for name, _ in imported(path) if name.split(".")[0] in LINKED]
    assert not bare, "import these from robbie_robots"
