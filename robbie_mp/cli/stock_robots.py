"""The stock robots that `robbie new --example` copies, and the files that each of them needs.

They lie in the folders profiles/, modules/, workers/ and hw/ of a checkout. `setup.py` packs these into the
wheel, beside this file.
"""

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.profile.workspace import STOCK, Workspace

CODE = ("modules", "workers", "hw")
PACKED = Path(__file__).with_name("packed_robots")
CHECKOUT = Path(__file__).parents[2]


class NoStockRobots(RobbieError, FileNotFoundError):
    """This Robbie-MP was installed without the stock robots."""


@dataclass(frozen=True)
class StockRobot:
    """One of the stock robots.

    Attributes:
        profiles: The first one runs the robot.
        extras: Those of Robbie-MP whose packages it needs.
    """

    profiles: Sequence[str]
    extras: Sequence[str]


STOCK_ROBOTS = {
    "demo": StockRobot(("demo", "demo-recorded", "demo-playback"), ("robot",)),
    "rescue": StockRobot(
        ("rescue", "rescue-small", "rescue-fast", "virtual-playback"), ("robot", "vision", "gui")
    ),
}


def stock_folder() -> Path:
    """Return the folder with the stock robots: as packed into the wheel, or the checkout.

    Raises:
        NoStockRobots: there is none.
    """
    for folder in (PACKED, CHECKOUT):
        if Workspace(folder).file_of("demo").is_file():
            return folder
    raise NoStockRobots(f"there are no stock robots in {PACKED}; install Robbie-MP again with pip")


def needed_files(root: Path, profiles: Sequence[str]) -> list[Path]:
    """Return the files that profiles need: those that they name, those that these name or import, and so on.

    A text that names an existing file, in a profile or in code, counts as use of this file.

    Args:
        root: A workspace.
        profiles: Names of profiles.

    Returns:
        Paths relative to the root, sorted.
    """
    found: dict[Path, None] = {}
    waiting = [Workspace(root).file_of(profile) for profile in profiles]
    while waiting:
        file = waiting.pop()
        if file in found:
            continue
        found[file] = None
        if file.suffix == ".py":
            waiting += _named_by_code(root, file)
        elif file.suffix == ".yaml":
            waiting += _named_by_yaml(root, file)
    return sorted(file.relative_to(root) for file in found)


def _named_by_yaml(root: Path, file: Path) -> Iterator[Path]:
    for text in _texts(yaml.safe_load(file.read_text())):
        yield from _named_files(text, (root, file.parent))
        yield from _module_files(root, text.partition(":")[0])
        if not text.startswith(STOCK):
            yield from _named_files(text + ".yaml", (Workspace(root).folder,))


def _texts(value: object) -> Iterator[str]:
    """Yield all texts among nested values."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        for element in value:
            yield from _texts(element)
    elif isinstance(value, dict):
        for element in value.values():
            yield from _texts(element)


def _named_by_code(root: Path, file: Path) -> Iterator[Path]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _module_files(root, alias.name)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                yield from _module_files(root, f"{node.module}.{alias.name}")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from _named_files(node.value, (root, file.parent))


def _named_files(text: str, folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the files in these folders that a text names."""
    if not text or len(text) > 200 or "\0" in text or Path(text).is_absolute() or ".." in text:
        return
    yield from (folder / text for folder in folders if (folder / text).is_file())


def _module_files(root: Path, name: str) -> Iterator[Path]:
    """Yield the file of a Python module in the workspace, and those of the packages around it."""
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts) or parts[0] not in CODE:
        return
    for count in range(1, len(parts) + 1):
        place = root.joinpath(*parts[:count])
        yield from (file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file())
