"""`robbie new DIR`: create a workspace for a robot, ready to run."""

import argparse
import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING

from robbie_mp.cli.parser import add_command
from robbie_mp.errors import RobbieError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

TEMPLATE = "workspace_template"
SUFFIX = ".template"
"""Hides the template's files from linters and importers; it is removed from the names of the copies."""


class FolderInUse(RobbieError, FileExistsError):
    """The folder for a new workspace is not empty."""


class NoRobotName(RobbieError, ValueError):
    """The folder's name cannot name the robot's messages."""


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `new` to the commands."""
    parser = add_command(
        subparsers,
        "new",
        "create a workspace for a new robot, ready to run",
        "Create a workspace with a module, a device, a worker, a message, a profile, a test and a README. "
        "The folder must be empty or not exist.",
        ["robbie new my-robot", "cd my-robot; python3 -m unittest; robbie run robot"],
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder; its name becomes the robot's name")
    parser.set_defaults(command=new)


def new(arguments: argparse.Namespace) -> int:
    """Create a workspace, and print what to do next."""
    made = make_workspace(arguments.folder)
    print(f"made {arguments.folder} with {len(made)} files. Next:")
    print(f"    cd {arguments.folder}")
    print("    python3 -m unittest")
    print("    robbie run robot")
    return 0


def make_workspace(folder: Path) -> list[Path]:
    """Write the template's files into a folder and return their paths.

    Raises:
        FolderInUse: the folder is not empty, or is a file.
        NoRobotName: its name has no Latin letter.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FolderInUse(f"{folder} is not empty; name an empty folder or one that does not exist")
    title = folder.absolute().name
    package = "_".join(re.findall(r"[a-z0-9]+", title.lower())).lstrip("0123456789_")
    if not package:
        raise NoRobotName(f"the folder's name {title!r} names the robot, so it must contain a Latin letter")
    return _copy(files("robbie_mp.cli") / TEMPLATE, folder, {"title": title, "package": package})


def _copy(source: Traversable, target: Path, words: dict[str, str]) -> list[Path]:
    made = []
    target.mkdir(parents=True, exist_ok=True)
    for entry in sorted(source.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            made += _copy(entry, target / entry.name, words)
        elif entry.name.endswith(SUFFIX):
            name = entry.name.removesuffix(SUFFIX)
            file = target / (f".{name}" if name == "gitignore" else name)
            text = entry.read_text()
            for key, word in words.items():
                text = text.replace("{{" + key + "}}", word)
            file.write_text(text)
            made.append(file)
    return made
