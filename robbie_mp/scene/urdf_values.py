"""Reads the elements and attributes of a URDF, and notes every problem and everything unknown."""

import math
import re
from collections.abc import Sequence

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.described import Description
from robbie_mp.scene.xml_elements import Element

# Python's float() reads more, such as 1_000, which no other reader of URDF does.
_NUMBER = re.compile(
    r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|inf(?:inity)?|nan)", re.ASCII | re.IGNORECASE
)
MAX_NAME = 1000
"""Most characters of a name or type."""
KNOWN_VERSIONS = ((1, 0), (1, 1), (1, 2))


class UrdfValues:
    """Reads values of a URDF.

    Args:
        description: collects the problems.
        robot: the root element.

    Attributes:
        version: of the specification; (1, 0) if the file does not say.
    """

    def __init__(self, description: Description, robot: Element) -> None:
        self.description = description
        self.version = self._version(robot)

    def _version(self, robot: Element) -> tuple[int, int]:
        text = robot.attributes.get("version", "1.0")
        match = re.fullmatch(r"(\d{1,4})\.(\d{1,4})", text, re.ASCII)
        version = (int(match[1]), int(match[2])) if match else None
        if version in KNOWN_VERSIONS:
            return version
        newest = KNOWN_VERSIONS[-1]
        self.doubt(robot, f"version {text!r:.20} of URDF is not known; read as {newest[0]}.{newest[1]}")
        return newest

    def wrong(self, element: Element, text: str) -> None:
        """Note a problem, once."""
        problems = self.description.problems
        if not any((text, element.place) == (each.text, each.place) for each in problems):
            self.description.wrong(text, element.place)

    def doubt(self, element: Element, text: str) -> None:
        """Note that something is left out or read in another way, which changes the robot."""
        self.description.leave_out(text, element.place, is_warning=True)

    def leave_out(self, element: Element, text: str) -> None:
        """Note that something is left out that a scene graph does not need."""
        self.description.leave_out(text, element.place)

    def attribute(self, element: Element, key: str) -> str:
        """Return a required attribute; if it is missing or empty, note the problem and return ''."""
        text = element.attributes.get(key, "")
        if not text:
            self.wrong(element, f"<{element.tag}> has no {key}")
        if len(text) > MAX_NAME:
            self.wrong(element, f"<{element.tag}> {key}: longer than {MAX_NAME} characters")
        return text[:MAX_NAME]

    def check_attributes(self, element: Element, known: Sequence[str]) -> None:
        """Note attributes that are not in the specification."""
        for key in element.attributes:
            if key not in known and ":" not in key and not key.startswith("xmlns"):
                hint = did_you_mean(key, known)
                self.doubt(element, f"<{element.tag}> has no attribute {key!r:.40} in URDF{hint}")

    def numbers(self, element: Element, key: str, default: str) -> tuple[float, ...]:
        """Return finite numbers, as many as `default` has."""
        text = element.attributes.get(key, default)
        numbers = tuple(map(_number, text.split()))
        count = len(default.split())
        if len(numbers) == count and all(map(math.isfinite, numbers)):
            return numbers
        expected = {1: "a number", 3: "three numbers", 4: "four numbers"}[count]
        hint = "; decimals have a point, and spaces are between numbers" if "," in text else ""
        self.wrong(element, f"<{element.tag}> {key}: expected {expected}; got {text!r:.60}{hint}")
        return tuple(map(float, default.split()))

    def number(self, element: Element, key: str, default: float) -> float:
        """Return a finite number."""
        return self.numbers(element, key, f"{default}")[0]

    def limit(self, element: Element, key: str) -> float:
        """Return a number that may be infinite or NaN; 0 if the attribute is missing."""
        text = element.attributes.get(key, "0").strip()
        return _number(text) if _NUMBER.fullmatch(text) else self.number(element, key, 0.0)


def _number(word: str) -> float:
    return float(word) if _NUMBER.fullmatch(word) else math.nan
