"""Reads the joints of a URDF.

Source: https://wiki.ros.org/urdf/XML/joint; urdfdom, README, URDF Versioning, for quaternions and for limits
since version 1.2.
"""

import math
from typing import cast

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.node import JOINT_TYPES, Joint, JointType, Mimic
from robbie_mp.scene.rigid_transform import IDENTITY, UNIT_TOLERANCE, RigidTransform
from robbie_mp.scene.urdf_values import UrdfValues
from robbie_mp.scene.xml_elements import Element

PLANAR = "planar"
TYPES = (*JOINT_TYPES, PLANAR)
QUATERNION_SINCE = (1, 1)
UNUSED_LIMITS = ("effort", "acceleration", "deceleration", "jerk")
ATTRIBUTES = {
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", *UNUSED_LIMITS),
    "mimic": ("joint", "multiplier", "offset"),
}
"""The elements of a joint that are read, with their attributes."""
UNUSED = {
    "dynamics": "a scene graph has frames only",
    "safety_controller": "soft limits are not used",
    "calibration": "the joint's driver knows its reference positions",
}
Triple = tuple[float, float, float]


class JointReader:
    """Reads joints.

    Args:
        values: reads their attributes.
    """

    def __init__(self, values: UrdfValues) -> None:
        self._values = values

    def kind(self, joint: Element) -> JointType:
        """Return the type of a joint; a planar one is read as floating, which can move in the same ways."""
        text, name = self._values.attribute(joint, "type"), joint.attributes.get("name", "")
        if text == PLANAR:
            self._values.doubt(joint, "a planar joint is read as a floating one: messages set its whole pose")
            return JointType.FLOATING
        if text not in JOINT_TYPES:
            hint = did_you_mean(text, TYPES) or f"; known are {', '.join(TYPES)}"
            self._values.wrong(joint, f"joint {name!r}: type {text!r:.60} is not supported{hint}")
            return JointType.FIXED
        return JointType(text)

    def read(self, element: Element) -> tuple[RigidTransform, Joint | None]:
        """Return the pose of a joint in its parent, and how it moves; None if it is fixed."""
        self._check_parts(element)
        kind, origin = self.kind(element), self._origin(element)
        if kind in (JointType.FIXED, JointType.FLOATING):
            for mimic in element.all("mimic"):
                self._values.doubt(mimic, f"a {kind} joint cannot follow another joint")
        if kind is JointType.FIXED:
            return origin, None
        if kind is JointType.FLOATING:
            if origin != IDENTITY:
                self._values.doubt(
                    element, "the <origin> of a floating joint: messages set its whole pose in the parent"
                )
            return IDENTITY, Joint(JointType.FLOATING)
        return origin, self._moving(element, kind)

    def _moving(self, element: Element, kind: JointType) -> Joint | None:
        name = self._values.attribute(element, "name")
        axis = element.first("axis")
        direction = (1.0, 0.0, 0.0) if axis is None else self._values.numbers(axis, "xyz", "1 0 0")
        limits, max_speed = self._limits(element, name, kind), self._max_speed(element)
        mimic = self._mimic(element)
        return self._values.description.attempt(
            element.place, lambda: Joint(kind, name, cast(Triple, direction), limits, mimic, max_speed), None
        )

    def _check_parts(self, joint: Element) -> None:
        for part in joint.children:
            if part.tag in ATTRIBUTES and part is not joint.first(part.tag):
                self._values.doubt(part, f"a second <{part.tag}> of a joint; the first one is used")
            elif part.tag in ATTRIBUTES:
                self._values.check_attributes(part, ATTRIBUTES[part.tag])
            elif part.tag in UNUSED:
                self._values.leave_out(part, f"<{part.tag}>: {UNUSED[part.tag]}")
            else:
                hint = did_you_mean(part.tag, ATTRIBUTES)
                self._values.doubt(part, f"a joint has no <{part.tag:.40}> in URDF{hint}")

    def _origin(self, joint: Element) -> RigidTransform:
        origin = joint.first("origin")
        if origin is None:
            return IDENTITY
        xyz, rpy = (self._values.numbers(origin, key, "0 0 0") for key in ("xyz", "rpy"))
        if "quat_xyzw" in origin.attributes and self._values.version >= QUATERNION_SINCE:
            return self._turned(origin, xyz)
        if "quat_xyzw" in origin.attributes:
            self._values.doubt(
                origin, 'quat_xyzw without <robot version="1.1"> or later: it is left out, as in ROS'
            )
        if max(map(abs, rpy)) > math.tau:
            self._values.doubt(origin, "<origin rpy=…> is in rad, and beyond one turn; is it in degrees?")
        return RigidTransform.from_rpy(xyz, rpy)

    def _turned(self, origin: Element, xyz: tuple[float, ...]) -> RigidTransform:
        if "rpy" in origin.attributes:
            self._values.wrong(origin, "<origin> has rpy and quat_xyzw; give one of them")
        quaternion = self._values.numbers(origin, "quat_xyzw", "0 0 0 1")
        length = math.hypot(*quaternion)
        if abs(length - 1.0) > UNIT_TOLERANCE and math.isfinite(length) and length > UNIT_TOLERANCE:
            self._values.doubt(origin, "a quat_xyzw whose length is not 1; it is normalized, as ROS does")
            quaternion = tuple(part / length for part in quaternion)
        make = lambda: RigidTransform.of(xyz, quaternion)  # noqa: E731
        return self._values.description.attempt(origin.place, make, IDENTITY)

    def _limits(self, joint: Element, name: str, kind: JointType) -> tuple[float, float] | None:
        limit = joint.first("limit")
        if kind is JointType.CONTINUOUS:
            if limit is not None and {"lower", "upper"} & limit.attributes.keys():
                self._values.leave_out(limit, "lower and upper of a continuous joint, which has no ends")
            return None
        if limit is None:
            self._values.wrong(joint, f"joint {name!r} is {kind}, so it needs a <limit lower=… upper=…>")
            return None
        lower, upper = (self._values.limit(limit, key) for key in ("lower", "upper"))
        if not lower <= upper:
            self._values.doubt(limit, "lower and upper that are no range; the limits count as unknown")
        return (lower, upper) if lower <= upper and lower < math.inf and upper > -math.inf else None

    def _max_speed(self, joint: Element) -> float | None:
        """Return its greatest speed; None: unknown, or no limit."""
        limit = joint.first("limit")
        if limit is None:
            return None
        for key in UNUSED_LIMITS:
            if key in limit.attributes and not self._is_no_limit(limit, key):
                self._values.leave_out(limit, f"<limit {key}=…>: a scene graph needs no {key}")
        if "velocity" not in limit.attributes or self._is_no_limit(limit, "velocity"):
            return None
        speed = self._values.limit(limit, "velocity")
        return speed if math.isfinite(speed) else None

    def _is_no_limit(self, limit: Element, key: str) -> bool:
        """Return whether a value that must be greater than 0 is not, and note it."""
        value = self._values.limit(limit, key)
        # 0 is what exporters write for an effort that they do not know
        if value > 0 or (value == 0 and key != "velocity"):
            return False
        self._values.doubt(
            limit, f"<limit {key}=…> must be greater than 0, not {value:g}; it counts as unknown"
        )
        return True

    def _mimic(self, joint: Element) -> Mimic | None:
        mimic = joint.first("mimic")
        if mimic is None:
            return None
        multiplier, offset = (
            self._values.number(mimic, key, default)
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        return Mimic(self._values.attribute(mimic, "joint"), multiplier, offset)
