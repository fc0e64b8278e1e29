"""Reads the collision shapes of a robot from its URDF (https://wiki.ros.org/urdf/XML/link)."""

import math
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.simulation.solid import Solid

XACRO = "http://www.ros.org/wiki/xacro"


class UrdfShapeError(ValueError):
    """A URDF cannot be read, has macros, or has a collision shape that is no box and no cylinder."""


class LinkSolid(NamedTuple):
    """A collision shape of a link, and X_LS, its pose in the link's frame: (4, 4)."""

    link: str
    solid: Solid
    pose: NDArray[np.float64]


def read_urdf_solids(file: Path) -> list[LinkSolid]:
    """Return all collision shapes of a robot.

    Raises:
        UrdfShapeError: see there.
        OSError: the file cannot be read.
    """
    try:
        robot = ElementTree.fromstring(file.read_bytes())
        if any(XACRO in element.tag for element in robot.iter()):
            raise ValueError("expand its macros first, as in `xacro robot.xacro > robot.urdf`")
        has_quaternions = robot.get("version", "1.0") != "1.0"
        return [
            LinkSolid(link.attrib["name"], _solid(shape), _pose(shape.find("origin"), has_quaternions))
            for link in robot.findall("link")
            for shape in link.findall("collision")
        ]
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise UrdfShapeError(f"{file}: cannot read the collision shapes: {error}") from error


def _solid(shape: ElementTree.Element) -> Solid:
    box, cylinder = shape.find("geometry/box"), shape.find("geometry/cylinder")
    if box is not None:
        x, y, z = _numbers(box.attrib["size"])
        return Solid((x, y, z))
    if cylinder is not None:
        diameter = 2 * float(cylinder.attrib["radius"])
        return Solid((diameter, diameter, float(cylinder.attrib["length"])), is_round=True)
    raise ValueError("a collision shape must be a box or a cylinder")


def _pose(origin: ElementTree.Element | None, has_quaternions: bool) -> NDArray[np.float64]:
    pose = np.eye(4)
    if origin is None:
        return pose
    pose[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    quaternion = origin.get("quat_xyzw") if has_quaternions else None
    pose[:3, :3] = _turn(origin.get("rpy", "0 0 0")) if quaternion is None else _quaternion_turn(quaternion)
    return pose


def _turn(rpy: str) -> NDArray[np.float64]:
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in _numbers(rpy))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _quaternion_turn(text: str) -> NDArray[np.float64]:
    x, y, z, w = map(float, text.split())
    length = math.hypot(x, y, z, w)
    if not (math.isfinite(length) and length > 0.0):
        raise ValueError(f"quat_xyzw has no direction: {text!r:.60}")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _numbers(text: str) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in text.split())
    return x, y, z
