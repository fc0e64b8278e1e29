"""`robbie new DIR`: make a workspace that runs."""

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
"""Hides the template's files from linters and importers; each file's name without it is the name it gets."""


class FolderInUse(RobbieError, FileExistsError):
    """The folder for a new workspace has something in it already."""


class NoRobotName(RobbieError, ValueError):
    """No name for the robot's messages can be made of the folder's name."""


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `new` to the commands."""
    parser = add_command(
        subparsers,
        "new",
        "make the folder of a new robot, which runs as made",
        "Make a workspace: a module, a device, a worker, a message, a profile, a test and a README. "
        "The folder must be empty, or not be there yet.",
        ["robbie new my-robot", "cd my-robot; python3 -m unittest; robbie run robot"],
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the folder; its name is the robot's name")
    parser.set_defaults(command=new)


def new(arguments: argparse.Namespace) -> int:
    """Make a workspace and say what to do next."""
    made = make_workspace(arguments.folder)
    print(f"made {arguments.folder} with {len(made)} files; what next:")
    print(f"    cd {arguments.folder}")
    print("    python3 -m unittest")
    print("    robbie run robot")
    return 0


def make_workspace(folder: Path) -> list[Path]:
    """Write the template's files into a folder and return their paths.

    Raises:
        FolderInUse: the folder has something in it, or is a file.
        NoRobotName: its name has no letter.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FolderInUse(f"{folder} is not empty; give a folder that is, or one that is not there yet")
    title = folder.absolute().name
    package = "_".join(re.findall(r"[a-z0-9]+", title.lower())).lstrip("0123456789_")
    if not package:
        raise NoRobotName(f"the folder's name {title!r} names the robot, so it needs a Latin letter in it")
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
