"""Finds a robot's workspace, the folder that contains profiles/, and profiles: its own and Robbie-MP's."""

import os
import re
from dataclasses import dataclass
from pathlib import Path, PurePath

from robbie_mp.base.problem import SourcePlace, refuse
from robbie_mp.base.stock_robots import ROBOTS, STOCK
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import YamlNode, read_file

FOLDER = "profiles"
SUFFIX = ".yaml"
NAME = re.compile(r"\w[\w.-]*(/\w[\w.-]*)*")
CLASS_PATH = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")
"""The class of a module, `package.module:Class`."""
STOCK_FOLDERS = (Path(__file__).with_name("stock"), ROBOTS / FOLDER)
"""The profiles that come with Robbie-MP: parents such as `robbie:playback`, and the stock robots."""


@dataclass(frozen=True)
class Workspace:
    """A folder with profiles/; its other folders contain the robot's code."""

    root: Path

    @property
    def folder(self) -> Path:
        """The folder with the profiles."""
        return self.root / FOLDER

    def names(self) -> list[str]:
        """Return the names of all profiles, such as `demo` or `sim/arena`, sorted."""
        return _names_in(self.folder)

    def file_of(self, name: str) -> Path:
        """Return the path of a profile's file, which need not exist."""
        if not name.startswith(STOCK):
            return self.folder / (name + SUFFIX)
        files = [folder / (name.removeprefix(STOCK) + SUFFIX) for folder in STOCK_FOLDERS]
        return next((file for file in files if file.is_file()), files[0])

    def read(self, name: str, place: SourcePlace | None = None) -> YamlNode:
        """Read a profile; an empty file is an empty map.

        Args:
            name: Such as `demo`, `sim/arena` or `robbie:playback`.
            place: Where another profile names it, if one does.

        Raises:
            ProfileError: there is no such profile, or it is not a YAML map.
        """
        file = self.file_of(name)
        if not NAME.fullmatch(name.removeprefix(STOCK)) or not file.is_file():
            own, stock = self.names(), stock_names()
            known = f"; profiles in {self.folder}: {', '.join(own) or 'none'}"
            known += f"; in Robbie-MP: {', '.join(stock)}"
            raise refuse(f"there is no profile {name!r}{_near(name, [*own, *stock]) or known}", place)
        content = read_file(file)
        if content.value is None:
            return YamlNode({}, content.place)
        if not isinstance(content.value, dict):
            raise refuse("expected a map with the keys of a profile (modules, variables, …)", content.place)
        return content


def stock_names() -> list[str]:
    """Return the names of all profiles that come with Robbie-MP, sorted."""
    return sorted(STOCK + name for folder in STOCK_FOLDERS for name in _names_in(folder))


def _near(name: str, known: list[str]) -> str:
    """Suggest a profile with the same name in another place, or else those with similar names."""
    elsewhere = (STOCK + name, PurePath(name).name.removesuffix(".yml"))
    same = next((one for one in elsewhere if one in known), None)
    return f"; did you mean {same!r}?" if same else did_you_mean(name, known)


def _names_in(folder: Path) -> list[str]:
    files = folder.rglob("*" + SUFFIX)
    return sorted(file.relative_to(folder).with_suffix("").as_posix() for file in files if file.is_file())


def enclosing_workspace(start: Path) -> Path | None:
    """Return the nearest folder with profiles/, from an absolute path upwards; None: there is none."""
    return next((one for one in (start, *start.parents) if (one / FOLDER).is_dir()), None)


def find_workspace(start: Path, wanted: str = "") -> Workspace:
    """Return the workspace of a folder: this folder, or the nearest one above it, that contains profiles/.

    Args:
        start: The folder.
        wanted: Name of the profile that is looked for, to suggest one that comes with Robbie-MP.

    Raises:
        ProfileError: there is none.
    """
    start = start.absolute()
    if folder := enclosing_workspace(start):
        return Workspace(folder)
    near = _near(wanted, stock_names()) if wanted else ""
    raise refuse(f"no folder {FOLDER}/ in {start} or above it; go to your robot's folder{near}")


def is_class(name: str) -> bool:
    """Whether this names the class of a module, which runs alone, and not a profile."""
    return not name.startswith(STOCK) and CLASS_PATH.fullmatch(name) is not None


def _refuse_other_file(name: str, start: Path) -> None:
    """Say how to run what is in a file that is no profile.

    Raises:
        ProfileError: there is such a file, and no profile of this name.
    """
    file = Path(os.path.abspath(start / name))
    root = enclosing_workspace(start)
    if not (file.suffix and file.is_file()) or (root and Workspace(root).file_of(name).is_file()):
        return
    if file.suffix != ".py":
        raise refuse(f"{name} is no profile, which is a file {FOLDER}/NAME{SUFFIX}; write `robbie run NAME`")
    root = root or start
    inside = file.relative_to(root) if file.is_relative_to(root) else Path(file.name)
    found = re.search(r"^class (\w+)\(.*Module\b", file.read_text(errors="replace"), re.MULTILINE)
    path = f"{'.'.join(inside.with_suffix('').parts)}:{found[1] if found else 'CLASS'}"
    raise refuse(f"{name} is code, no profile; write `robbie run {path}` to run a module of it alone")


def locate(name_or_file: str, start: Path) -> tuple[Workspace, str]:
    """Return the workspace and name of a profile that is given by name, or by a path that ends with .yaml.

    A profile that comes with Robbie-MP needs no workspace, and neither does a class that runs alone.

    Raises:
        ProfileError: there is no workspace, or the file is not in one.
    """
    if name_or_file.startswith(STOCK) or is_class(name_or_file):
        return Workspace(enclosing_workspace(start.absolute()) or start), name_or_file
    if not name_or_file.endswith(SUFFIX):
        _refuse_other_file(name_or_file, start.absolute())
        return find_workspace(start, name_or_file), name_or_file
    file = Path(os.path.abspath(start / name_or_file))
    for folder in file.parents:
        if folder.name == FOLDER:
            return Workspace(folder.parent), file.relative_to(folder).with_suffix("").as_posix()
    root = enclosing_workspace(start.absolute())
    if root and not file.exists() and Workspace(root).file_of(file.stem).is_file():
        raise refuse(f"there is no file {name_or_file}; did you mean `robbie run {file.stem}`?")
    raise refuse(f"{file} is not in a folder {FOLDER}/, so it belongs to no robot")
