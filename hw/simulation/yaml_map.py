"""Reads YAML maps. Its errors name the file and the line."""

import math
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import Loader, read_file, read_text

Name = TypeVar("Name", bound=str)


class ArenaError(ValueError):
    """An invalid arena file. The text names the file, the line, and what was expected."""


class YamlMap:
    """A map of a YAML file, with one method for each type of value.

    Args:
        path: path of the file, for errors.
        node: the map.
        what: what the map describes, for errors, such as "an arena".
        keys: allowed keys.

    Raises:
        ArenaError: the node is not a map, or has an unknown key or a key twice. All methods raise it if a
            value has the wrong type.
    """

    def __init__(self, path: Path, node: yaml.Node | None, what: str, keys: Collection[str]) -> None:
        self._path = path
        self._line = node.start_mark.line + 1 if node else 1
        self._nodes: dict[str, yaml.Node] = {}
        if not isinstance(node, yaml.MappingNode):
            raise ArenaError(f"{path}:{self._line}: {what} is a map with the keys {', '.join(keys)}")
        for key, value in node.value:
            if key.value not in keys:
                self.fail(key, f"unknown key {key.value!r}; {what} has {', '.join(keys)}")
            if key.value in self._nodes:
                self.fail(key, f"the key {key.value!r} appears twice")
            self._nodes[key.value] = value

    def __contains__(self, key: str) -> bool:
        return key in self._nodes

    def node(self, key: str) -> yaml.Node:
        """Return the value of a required key."""
        if key not in self._nodes:
            raise ArenaError(f"{self._path}:{self._line}: the key {key!r} is missing")
        return self._nodes[key]

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number. Without a default, the key is required."""
        if default is not None and key not in self:
            return default
        return self._number(self.node(key))

    def positive(self, key: str, default: float | None = None) -> float:
        """Return a number greater than 0."""
        number = self.number(key, default)
        if number <= 0:
            self.fail(self.node(key), f"{key} must be greater than 0, not {number:g}")
        return number

    def name(self, key: str, names: Iterable[Name], default: Name) -> Name:
        """Return one of several allowed names."""
        if key not in self:
            return default
        node = self.node(key)
        for name in names:
            if isinstance(node, yaml.ScalarNode) and node.value == name:
                return name
        self.fail(node, f"{key} must be one of {', '.join(names)}")

    def text(self, key: str) -> str:
        """Return a text, or a number as it is written."""
        node = self.node(key)
        if not isinstance(node, yaml.ScalarNode):
            self.fail(node, f"{key} must be a text")
        return str(node.value)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        if key not in self:
            return default
        node = self.node(key)
        if node.tag != "tag:yaml.org,2002:bool":
            self.fail(node, f"{key} must be true or false")
        return str(node.value).lower() == "true"

    def one_map(self, key: str, what: str, keys: Collection[str]) -> "YamlMap":
        """Return a map."""
        return YamlMap(self._path, self.node(key), what, keys)

    def block(self, key: str) -> tuple[list[str], int]:
        """Return the lines of a literal block, and the number of the first one in the file."""
        node = self.node(key)
        if not isinstance(node, yaml.ScalarNode) or node.style != "|":
            self.fail(node, f"{key} must be a block of lines: `{key}: |` and the lines indented below it")
        return node.value.splitlines(), node.start_mark.line + 2

    def row(self, key: str, width: int) -> tuple[float, ...]:
        """Return a list of the given number of numbers."""
        return self._row(self.node(key), f"{key} must be", width)

    def rows(self, key: str, width: int) -> tuple[NDArray[np.float64], list[yaml.Node]]:
        """Return a list of lists of `width` numbers, (N, width), and the node of each row."""
        nodes = self._items(key, f"a list of lists of {width} numbers")
        rows = [self._row(node, f"each of {key} must be", width) for node in nodes]
        return np.array(rows, dtype=np.float64).reshape(-1, width), nodes

    def maps(self, key: str, what: str, keys: Collection[str]) -> list["YamlMap"]:
        """Return a list of maps."""
        return [YamlMap(self._path, node, what, keys) for node in self._items(key, "a list of maps")]

    def fail(self, node: yaml.Node | None, what: str) -> NoReturn:
        """Raise an error about a value, or about the whole map."""
        self.fail_at(node.start_mark.line + 1 if node else self._line, what)

    def fail_at(self, line: int, what: str) -> NoReturn:
        """Raise an error about a line of the file."""
        raise ArenaError(f"{self._path}:{line}: {what}")

    def _items(self, key: str, what: str) -> list[yaml.Node]:
        node = self._nodes.get(key)
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            self.fail(node, f"{key} must be {what}")
        return list(node.value)

    def _row(self, node: yaml.Node, must_be: str, width: int) -> tuple[float, ...]:
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != width:
            self.fail(node, f"{must_be} a list of {width} numbers")
        return tuple(self._number(item) for item in node.value)

    def _number(self, node: yaml.Node) -> float:
        if node.tag not in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float"):
            self.fail(node, "expected a number")
        number = read_text(node.value, self._path).plain()
        assert isinstance(number, int | float)  # by its tag
        if not math.isfinite(number):
            self.fail(node, f"expected a finite number, not {node.value}")
        return float(number)


def read_yaml_map(path: Path, what: str, keys: Collection[str]) -> YamlMap:
    """Read a YAML file that is one map.

    Raises:
        ArenaError: the file cannot be read, is not valid YAML, or not a map with these keys.
    """
    try:
        read_file(path)  # refuses all that PyYAML's nodes would let through
        root = yaml.compose(path.read_text(encoding="utf-8"), Loader=Loader)
    except ProfileError as error:
        raise ArenaError(str(error)) from error
    return YamlMap(path, root, what, keys)
