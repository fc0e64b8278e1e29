"""`robbie new`: create a workspace for a robot, ready to run, or one with the profile of a stock robot."""

import argparse
import re
import shlex
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.extras import how_to_install, lacking
from robbie_mp.base.stock_robots import ROBOTS
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.run.profile.workspace import Workspace

HERE = Path(__file__).parent
TEMPLATE = "workspace_template"
EXAMPLE_TEMPLATE = "example_template"
SUFFIX = ".template"
"""Hides the template's files from linters and importers; it is removed from the names of the copies."""
HIDDEN = ("github", "gitignore", "pre-commit-config.yaml", "vscode")
"""Files and folders of the template whose copies have a dot before their names."""

EXTRAS = {
    "rescue": "robot,vision,gui",
    "home": "robot,gui,arm",
    "arm": "robot,gui,arm",
    "parcours": "robot",
    "numbers": "robot,digits,gui",
    "spoken": "robot,speech,sound",
    "objects": "robot,vision,gui",
    "demo": "robot",
}
"""The stock robots, and the extras of Robbie-MP whose packages each needs."""


class FolderInUse(RobbieError, FileExistsError):
    """The folder for a new workspace is not empty."""


class NoRobotName(RobbieError, ValueError):
    """The folder's name cannot name the robot's messages."""


def add_parser(subparsers: Commands) -> None:
    """Add `new` to the commands."""
    parser = add_command(
        subparsers,
        "new",
        "create a workspace for a new robot, ready to run",
        "Create a workspace with a module, a device, a worker, a message, a profile, a test and a README. "
        "Or copy the profile of a stock robot, to change it; its code stays in Robbie-MP. "
        "The folder must be empty or not exist.",
        [
            "robbie new my-robot",
            "cd my-robot; python3 -m unittest; robbie run robot",
            "robbie new --example demo",
        ],
    )
    parser.add_argument(
        "folder", type=Path, metavar="DIR", nargs="?", help="folder; its name becomes the robot's name"
    )
    parser.add_argument(
        "--example", choices=EXTRAS, help="copy its profile; without DIR, into a folder of the same name"
    )
    parser.set_defaults(command=new, usage_error=parser.error)


def new(arguments: argparse.Namespace) -> int:
    """Create a workspace, and print what to do next."""
    example: str | None = arguments.example
    if example:
        folder = arguments.folder or Path(example)
        made = copy_example(example, folder)
        extras = EXTRAS[example].split(",")
        install = [how_to_install(*extras)] if lacking(*extras) else []
        commands = [*install, go_there(folder), f"robbie run {example}"]
    elif arguments.folder:
        folder = arguments.folder
        made = make_workspace(folder)
        commands = [go_there(folder), "python3 -m unittest", "robbie run robot"]
    else:
        arguments.usage_error("name a folder for the new robot, or an --example")
    print(f"made {folder} with {len(made)} files. Next:")
    for command in commands:
        print(f"    {command}")
    return 0


def go_there(folder: Path) -> str:
    """Return the command that goes to a folder."""
    return f"cd {shlex.quote(str(folder))}"


def make_workspace(folder: Path) -> list[Path]:
    """Write the template's files into a folder and return their paths.

    Raises:
        FolderInUse: the folder is not empty, or is a file.
        NoRobotName: its name has no Latin letter.
    """
    _check_unused(folder)
    title = folder.absolute().name
    package = "_".join(re.findall(r"[a-z0-9]+", title.lower())).lstrip("0123456789_")
    if not package:
        raise NoRobotName(f"the folder's name {title!r} names the robot, so it must contain a Latin letter")
    return _copy(HERE / TEMPLATE, folder, {"title": title, "package": package})


def copy_example(name: str, folder: Path) -> list[Path]:
    """Make a workspace with the profile of a stock robot and return the paths of its files.

    Raises:
        FolderInUse: the folder is not empty, or is a file.
    """
    _check_unused(folder)
    words = {"title": folder.absolute().name, "example": name, "extras": EXTRAS[name]}
    made = _copy(HERE / EXAMPLE_TEMPLATE, folder, words)
    profile = Workspace(folder).file_of(name)
    profile.parent.mkdir()
    profile.write_text(Workspace(ROBOTS).file_of(name).read_text())
    return [*made, profile]


def _check_unused(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FolderInUse(f"{folder} is not empty; name an empty folder or one that does not exist")


def _copy(source: Path, target: Path, words: dict[str, str]) -> list[Path]:
    made = []
    target.mkdir(parents=True, exist_ok=True)
    for entry in sorted(source.iterdir()):
        name = entry.name.removesuffix(SUFFIX)
        file = target / (f".{name}" if name in HIDDEN else name)
        if entry.is_dir():
            made += _copy(entry, file, words)
        elif entry.name.endswith(SUFFIX):
            text = entry.read_text()
            for key, word in words.items():
                text = text.replace("{{" + key + "}}", word)
            file.write_text(text)
            made.append(file)
    return made
