"""Reads the fields of a map in a scene file with their types, and notes every problem."""

import math

from robbie_mp.base.problem import SourcePlace
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.base.yaml_reader import YamlNode as Yaml
from robbie_mp.scene.described import Description


class Fields:
    """A map of a scene file.

    Args:
        description: collects the problems.
        path: the path of the map for error texts, such as "nodes.laser".
        node: the value; null counts as an empty map.
        known: the allowed keys.
    """

    def __init__(self, description: Description, path: str, node: Yaml, known: tuple[str, ...]):
        self._description = description
        self._path = path
        self.place = node.place
        self._is_map = node.value is None or isinstance(node.value, dict)
        if not self._is_map:
            description.wrong(f"{path}: expected a map with keys such as {known[0]!r}", node.place)
        self.values = node.value if isinstance(node.value, dict) else {}
        for key, value in self.values.items():
            if key not in known:
                hint = did_you_mean(key, known) or f"; it may have {', '.join(known)}"
                description.wrong(f"{self.path_of(key)}: unknown key{hint}", value.place)

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def path_of(self, key: str) -> str:
        """Return the path of a value."""
        return f"{self._path}.{key}" if self._path else key

    def place_of(self, key: str) -> SourcePlace:
        """Return the place of a value, or of the map if the value is missing."""
        return self.values[key].place if key in self.values else self.place

    def text(self, key: str) -> str | None:
        """Return a str; None if it is missing."""
        value = self.values[key].value if key in self.values else None
        if value is None or (isinstance(value, str) and value):
            return value
        self._wrong(key, "a text", value)
        return None

    def required_text(self, key: str) -> str:
        """Return a required str; if it is missing, note the problem and return ''."""
        if key not in self.values and self._is_map:
            self._description.wrong(f"{self.path_of(key)}: missing; expected a text", self.place)
        return self.text(key) or ""

    def number(self, key: str, default: float) -> float:
        """Return a finite number."""
        if key not in self.values:
            return default
        value = _number(self.values[key])
        if value is None:
            self._wrong(key, "a finite number", self.values[key].plain())
        return default if value is None else value

    def numbers(self, key: str, count: int) -> tuple[float, ...] | None:
        """Return a list of `count` finite numbers; None if it is missing."""
        if key not in self.values:
            return None
        value = self.values[key].value
        items = [_number(item) for item in value] if isinstance(value, list) else []
        numbers = tuple(item for item in items if item is not None)
        if len(numbers) != count or len(items) != count:
            self._wrong(key, f"a list of {count} finite numbers", self.values[key].plain())
            return None
        return numbers

    def _wrong(self, key: str, expected: str, got: object) -> None:
        text = f"{self.path_of(key)}: expected {expected}; got {got!r:.60}"
        self._description.wrong(text, self.values[key].place)


def _number(node: Yaml) -> float | None:
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
