"""The interfaces of ROS 2's packages: files .msg, .srv and .action in folders, and definitions in logs."""

import os
from collections.abc import Iterator
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages.python_source import Interface, PythonSource
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.schema import own_definition
from robbie_mp.messages.schema_parser import MAX_TEXT_BYTES, NAME_LINE, SEPARATOR_LINE
from robbie_mp.messages.stock.registry import stock_registry

KINDS = ("msg", "srv", "action")
PREFIXES = "AMENT_PREFIX_PATH"
MAX_FILES = 2000


class NoInterfaces(RobbieError, LookupError):
    """There are no interfaces of ROS 2 where they were looked for.

    Example scenarios:
      - no package has this name, or `setup.bash` was not sourced
      - the folder has no folder msg, srv or action
      - the log has no definitions
    """


def python_source(source: str) -> tuple[str, PythonSource]:
    """Return the text of a Python file with the classes of a package or a log, and how it was made.

    Args:
        source: a folder of a package, a log, or the name of a package of the ROS that is installed.

    Raises:
        NoInterfaces: there are none.
        RobbieError: the log cannot be read.
    """
    path = Path(source)
    if path.is_dir():
        return _of_package(path.resolve())
    if path.is_file():
        return _of_log(path)
    prefixes = [Path(one) for one in os.environ.get(PREFIXES, "").split(os.pathsep) if one]
    for prefix in prefixes:
        if (prefix / "share" / source / "package.xml").exists():
            return _of_package(prefix / "share" / source)
    if not prefixes:
        raise NoInterfaces(
            f"{source} is no folder or log, and {PREFIXES} is not set: `source /opt/ros/…/setup.bash` first"
        )
    known = [one.parent.name for prefix in prefixes for one in prefix.glob("share/*/package.xml")]
    raise NoInterfaces(f"no package of ROS is called {source!r:.80}{did_you_mean(source, known)}")


def _of_package(folder: Path) -> tuple[str, PythonSource]:
    package = folder.name
    interfaces = list(_interfaces(folder))
    if not interfaces:
        raise NoInterfaces(f"{folder} has no files msg/*.msg, srv/*.srv or action/*.action")
    made = PythonSource(stock_registry(), _Definitions(folder))
    for one in interfaces:
        made.add(one)
    return made.text(f"Messages of ROS 2's package {package}, written by `robbie type import`."), made


def _interfaces(folder: Path) -> Iterator[Interface]:
    """Yield the interfaces of a package, messages first."""
    for kind in KINDS:
        for file in _files(folder, kind):
            yield Interface(folder.name, kind, file.stem, _text(file))


def _files(folder: Path, kind: str) -> list[Path]:
    """Return the regular files of a kind; opening a named pipe would block forever."""
    return [one for one in sorted((folder / kind).glob(f"*.{kind}"))[:MAX_FILES] if one.is_file()]


def _text(file: Path) -> str:
    with file.open("rb") as opened:
        return opened.read(MAX_TEXT_BYTES + 1).decode("utf-8", "replace")


class _Definitions(dict[str, str]):
    """Definitions of message types, by `package/Name`; read when they are needed.

    Args:
        folder: of a package; other packages are beside it, or in the ROS that is installed.
    """

    def __init__(self, folder: Path):
        super().__init__({f"{folder.name}/{one.stem}": _text(one) for one in _files(folder, "msg")})
        prefixes = os.environ.get(PREFIXES, "").split(os.pathsep)
        self._places = [folder.parent, *(Path(one) / "share" for one in prefixes if one)]

    def get(self, key: str, default: str | None = None) -> str | None:  # type: ignore[override]
        """Return a definition."""
        if key not in self and key.count("/") == 1:
            package, name = key.split("/")
            places = self._places if package.isidentifier() and name.isidentifier() else []
            files = [place / package / "msg" / f"{name}.msg" for place in places]
            found = next((file for file in files if file.is_file()), None)
            if found is not None:
                self[key] = _text(found)
            elif (stock := _stock_text(stock_registry(), f"{package}/msg/{name}")) is not None:
                self[key] = stock
        return super().get(key, default)


def _stock_text(registry: TypeRegistry, type_name: str) -> str | None:
    """Return the definition of a stock type, for packages whose folder stands alone."""
    return own_definition(registry.get(type_name)) if type_name in registry else None


def _of_log(path: Path) -> tuple[str, PythonSource]:
    with open_log(path) as log:
        schemas = {one.type_name: one.schema for one in log.channels if one.type_name and one.schema}
    definitions: dict[str, str] = {}
    for text in schemas.values():
        for part in SEPARATOR_LINE.split(text)[1:]:
            if named := NAME_LINE.match(part):
                definitions[named[1].replace("/msg/", "/")] = part[named.end() :]
    made = PythonSource(stock_registry(), definitions)
    for type_name, text in sorted(schemas.items()):
        package, _, name = type_name.partition("/msg/")
        if name and type_name not in made.registry:
            made.add(Interface(package, "msg", name, SEPARATOR_LINE.split(text)[0]))
    if not made.made:
        raise NoInterfaces(f"{path} has no definitions of message types that Robbie-MP does not have")
    return made.text(f"Messages of the log {path.name}, written by `robbie type import`."), made
