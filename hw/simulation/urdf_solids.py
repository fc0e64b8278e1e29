"""Reads the collision shapes of a robot from its URDF (https://wiki.ros.org/urdf/XML/link)."""

import math
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.simulation.solid import Solid


class UrdfShapeError(ValueError):
    """A URDF cannot be read, or has a collision shape that is no box and no cylinder."""


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
        return [
            LinkSolid(link.attrib["name"], _solid(shape), _pose(shape.find("origin")))
            for link in robot.iter("link")
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


def _pose(origin: ElementTree.Element | None) -> NDArray[np.float64]:
    pose = np.eye(4)
    if origin is None:
        return pose
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"))
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in (roll, pitch, yaw))
    pose[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    pose[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    return pose


def _numbers(text: str) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in text.split())
    return x, y, z
