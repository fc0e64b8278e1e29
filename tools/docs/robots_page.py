"""Writes docs/robots.md from the profiles: which module is in which robot, and each robot's own code.

    python -m tools.docs.robots_page

A robot's code is the files of its modules' classes, and everything of `modules/`, `workers/` and `hw/` that
these import, directly or not. Lines are those of its files that are not blank.
"""

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from robbie_mp.run.profile.load import load_profile

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs" / "robots.md"
PACKAGE = "robbie_robots."
CANDIDATES = ("rescue", "home", "arm", "parcours", "numbers", "spoken", "objects", "demo")
"""The robots, in the order of the page; those without a profile are left out."""
TEXT = """\
# The same modules, different robots

A profile makes a robot of modules. `python -m tools.docs.robots_page` writes this page from the profiles: do
not edit it.

## Modules

{modules}

`robbie run robbie:NAME` starts a robot, and `robbie profile show robbie:NAME` prints its profile with all
settings. Variants, such as `rescue-fast`, are left out.

## Code

A robot's code is the files of its modules, and what they import of `modules/`, `workers/` and `hw/`. The
framework, `robbie_mp`, is the same for all, and does not count. A robot's own code is what no other robot of
this page uses. Lines are those that are not blank.

{code}

## Own files

{files}
"""


@dataclass(frozen=True)
class StockRobot:
    """One robot.

    Attributes:
        name: that of its profile.
        classes: the classes of its modules, as `package.module:Class`.
        files: its code, as paths relative to the repository.
    """

    name: str
    classes: frozenset[str]
    files: frozenset[str]


def robots() -> list[StockRobot]:
    """Read the profiles of all robots."""
    found = []
    for name in CANDIDATES:
        if not (REPOSITORY / "profiles" / f"{name}.yaml").exists():
            continue
        classes = frozenset(spec.class_path for spec in load_profile(name, REPOSITORY).modules)
        files: set[str] = set()
        for path in classes:
            files |= _closure(path.partition(":")[0])
        found.append(StockRobot(name, classes, frozenset(files)))
    return found


def own_files(robot: StockRobot, others: list[StockRobot]) -> list[str]:
    """Return the files that no other robot uses."""
    shared = frozenset[str]().union(*(other.files for other in others if other is not robot))
    return sorted(robot.files - shared)


def lines(files: Iterator[str] | list[str] | frozenset[str]) -> int:
    """Return the number of lines of files that are not blank."""
    return sum(
        sum(bool(line.strip()) for line in (REPOSITORY / name).read_text().splitlines()) for name in files
    )


def page() -> str:
    """Return the text of the page."""
    found = robots()
    names = [robot.name for robot in found]
    rows = [
        [f"`{path}`", *("●" if path in robot.classes else "" for robot in found)] for path in _sorted(found)
    ]
    code = []
    for robot in found:
        own = own_files(robot, found)
        total, new = lines(robot.files), lines(own)
        code.append([f"`{robot.name}`", len(robot.classes), total, total - new, new, f"{new / total:.0%}"])
    head = ["robot", "modules", "lines", "of them shared", "its own", "share"]
    own_text = [
        f"- `{robot.name}`: {', '.join(_short(own_files(robot, found))) or 'none'}" for robot in found
    ]
    return TEXT.format(
        modules=_table(["class of the module", *(f"`{name}`" for name in names)], rows),
        code=_table(head, code),
        files="\n".join(own_text),
    )


def _sorted(found: list[StockRobot]) -> list[str]:
    """Return all classes, those that most robots use first."""
    classes = frozenset[str]().union(*(robot.classes for robot in found))
    return sorted(classes, key=lambda path: (-sum(path in robot.classes for robot in found), path))


def _short(files: list[str]) -> Iterator[str]:
    """Name the files of a folder together."""
    folders: dict[str, list[str]] = {}
    for name in files:
        folder, _, file = name.rpartition("/")
        if file != "__init__.py":
            folders.setdefault(folder, []).append(file)
    for folder, inside in folders.items():
        listed = inside[0] if len(inside) == 1 else "{" + ", ".join(inside) + "}"
        yield f"`{folder}/{listed}`"


def _table(head: list[str], rows: list[list[object]] | list[list[str]]) -> str:
    under = ["---", *["---:" if rows and isinstance(rows[0][-2], int) else ":-:"] * (len(head) - 1)]
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in [head, under, *rows])


def _closure(module: str) -> set[str]:
    """Return the files of a module, and of all that it imports."""
    todo, files = [module], set[str]()
    while todo:
        file = _file(todo.pop())
        if file is not None and file not in files:
            files.add(file)
            todo += _imports(file)
    return files


def _file(module: str) -> str | None:
    """Return the file of a module of the stock robots; None for others."""
    if not module.startswith(PACKAGE):
        return None
    path = module.removeprefix(PACKAGE).replace(".", "/")
    for name in (f"{path}.py", f"{path}/__init__.py"):
        if (REPOSITORY / name).exists():
            return name
    return None


@cache
def _imports(file: str) -> tuple[str, ...]:
    """Return the modules that a file names in its imports, also those that are packages."""
    found: list[str] = []
    for node in ast.walk(ast.parse((REPOSITORY / file).read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(found)


def figures(text: str) -> Mapping[str, list[int]]:
    """Return the figures of the page's table of code by robot: modules, lines, shared, own."""
    rows = [line.split("|")[1:-1] for line in text.partition("## Code")[2].splitlines() if line[:3] == "| `"]
    return {cells[0].strip(" `"): [int(cell) for cell in cells[1:5]] for cells in rows}


if __name__ == "__main__":
    argparse.ArgumentParser(prog="python -m tools.docs.robots_page", description=__doc__).parse_args()
    PAGE.write_text(page())
    sys.stdout.write(f"wrote {PAGE}\n")
