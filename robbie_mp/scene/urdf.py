"""Reads only the tree of links and joints of a URDF (https://wiki.ros.org/urdf/XML)."""

import math
from pathlib import Path
from typing import cast

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.described import Description, make_node
from robbie_mp.scene.errors import SceneFileError
from robbie_mp.scene.node import JOINT_TYPES, Joint, JointType, Mimic
from robbie_mp.scene.rigid_transform import IDENTITY, RigidTransform
from robbie_mp.scene.xml_elements import Element, read_xml

Triple = tuple[float, float, float]


def describe_urdf(file: Path) -> Description:
    """Return the nodes that a URDF describes, one for each link with the link's name, and all problems."""
    description = Description(file)
    try:
        robot = read_xml(file)
    except SceneFileError as error:
        description.problems.extend(error.problems)
        return description
    if robot.tag != "robot":
        description.wrong(f"the root element of a URDF is <robot>, not <{robot.tag}>", robot.place)
        return description
    _Robot(description, robot).describe()
    return description


class _Robot:
    def __init__(self, description: Description, robot: Element) -> None:
        self._description = description
        self._robot = robot
        self._joint_of_child: dict[str, Element] = {}

    def describe(self) -> None:
        macro = next((each for each in self._robot.children if each.tag.startswith("xacro:")), None)
        if macro is not None:
            self._wrong(macro, f"<{macro.tag}>: expand it first, as in `xacro robot.xacro > robot.urdf`")
            return
        links = {self._attribute(link, "name"): link for link in self._robot.all("link")}
        for joint in self._robot.all("joint"):
            self._note_joint(joint, links)
        for link in self._robot.all("link"):
            self._describe_link(link)
        roots = [name for name in links if name not in self._joint_of_child]
        if len(roots) != 1 and not self._description.problems:
            names = ", ".join(map(repr, roots)) or "none"
            self._wrong(
                self._robot, f"expected exactly one link that is not the child of a joint; got {names}"
            )

    def _note_joint(self, joint: Element, links: dict[str, Element]) -> None:
        for role in ("parent", "child"):
            name = self._link_of(joint, role)
            if name not in links:
                what = f"joint {self._attribute(joint, 'name')!r}: its {role} {name!r} is not a link"
                self._wrong(joint, what + did_you_mean(name, links))
        child = self._link_of(joint, "child")
        before = self._joint_of_child.setdefault(child, joint)
        if before is not joint:
            self._wrong(joint, f"link {child!r} is the child of two joints, also at {before.place}")

    def _describe_link(self, link: Element) -> None:
        name = self._attribute(link, "name")
        joint = self._joint_of_child.get(name)
        if joint is None:
            make_node(self._description, link.place, name, None, IDENTITY, None)
            return
        parent, origin = self._link_of(joint, "parent"), self._origin(joint)
        make_node(self._description, joint.place, name, parent, origin, self._joint(joint))

    def _joint(self, element: Element) -> Joint | None:
        kind, name = self._attribute(element, "type"), self._attribute(element, "name")
        if kind not in JOINT_TYPES:
            hint = did_you_mean(kind, JOINT_TYPES) or f"; known are {', '.join(JOINT_TYPES)}"
            self._wrong(element, f"joint {name!r}: type {kind!r} is not supported{hint}")
        if kind not in JOINT_TYPES or kind == JointType.FIXED:
            return None
        if kind == JointType.FLOATING:
            return Joint(JointType.FLOATING)
        axis = element.first("axis")
        direction = self._triple(axis, "xyz") if axis is not None else (1.0, 0.0, 0.0)
        limits = self._limits(element, name, JointType(kind))
        mimic, max_speed = self._mimic(element), self._max_speed(element)
        return self._description.attempt(
            element.place, lambda: Joint(JointType(kind), name, direction, limits, mimic, max_speed), None
        )

    def _limits(self, joint: Element, name: str, kind: JointType) -> tuple[float, float] | None:
        if kind is JointType.CONTINUOUS:
            return None
        limit = joint.first("limit")
        if limit is None:
            self._wrong(joint, f"joint {name!r} is {kind}, so it needs a <limit lower=… upper=…>")
            return None
        return self._number(limit, "lower", 0.0), self._number(limit, "upper", 0.0)

    def _max_speed(self, joint: Element) -> float | None:
        """Return its greatest speed; 0, which many files have, means that it is not known."""
        limit = joint.first("limit")
        return (self._number(limit, "velocity", 0.0) or None) if limit is not None else None

    def _mimic(self, joint: Element) -> Mimic | None:
        mimic = joint.first("mimic")
        if mimic is None:
            return None
        multiplier, offset = self._number(mimic, "multiplier", 1.0), self._number(mimic, "offset", 0.0)
        return Mimic(self._attribute(mimic, "joint"), multiplier, offset)

    def _origin(self, joint: Element) -> RigidTransform:
        origin = joint.first("origin")
        if origin is None:
            return IDENTITY
        return RigidTransform.from_rpy(self._triple(origin, "xyz"), self._triple(origin, "rpy"))

    def _link_of(self, joint: Element, role: str) -> str:
        element = joint.first(role)
        if element is None:
            self._wrong(joint, f"joint {joint.attributes.get('name', '')!r} has no <{role} link=…>")
            return ""
        return self._attribute(element, "link")

    def _attribute(self, element: Element, key: str) -> str:
        if not element.attributes.get(key):
            self._wrong(element, f"<{element.tag}> has no {key}")
        return element.attributes.get(key, "")

    def _triple(self, element: Element, key: str) -> Triple:
        words = element.attributes.get(key, "0 0 0").split()
        numbers = [_number(word) for word in words]
        if len(numbers) != 3 or None in numbers:
            got = element.attributes[key]
            self._wrong(element, f"<{element.tag}> {key}: expected three numbers; got {got!r:.60}")
            return (0.0, 0.0, 0.0)
        return cast(Triple, tuple(numbers))

    def _number(self, element: Element, key: str, default: float) -> float:
        if key not in element.attributes:
            return default
        number = _number(element.attributes[key])
        if number is None:
            got = element.attributes[key]
            self._wrong(element, f"<{element.tag}> {key}: expected a number; got {got!r:.60}")
        return default if number is None else number

    def _wrong(self, element: Element, text: str) -> None:
        if not any((text, element.place) == (each.text, each.place) for each in self._description.problems):
            self._description.wrong(text, element.place)


def _number(word: str) -> float | None:
    try:
        number = float(word)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
