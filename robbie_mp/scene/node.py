"""The parts of a scene graph: nodes, and the joints that move them."""

import math
from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.messages.frames import without_slash
from robbie_mp.scene.errors import BadJoint
from robbie_mp.scene.rigid_transform import IDENTITY, RigidTransform


class JointType(StrEnum):
    """How a node may move in its parent, with the terms of URDF."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    """Turns about an axis, between limits; rad."""
    CONTINUOUS = "continuous"
    """Turns about an axis without limits; rad."""
    PRISMATIC = "prismatic"
    """Slides along an axis; m."""
    FLOATING = "floating"
    """Moves freely: whole poses are set, such as from odometry."""


JOINT_TYPES = tuple(kind.value for kind in JointType)


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: its position is `multiplier` * the other's + `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            BadJoint: one is not finite.
        """
        if not (math.isfinite(self.multiplier) and math.isfinite(self.offset)):
            raise BadJoint(
                f"a joint follows {self.joint!r} with multiplier {self.multiplier:g} and offset "
                f"{self.offset:g}; they must be finite"
            )

    def after(self, leader: "Mimic | None") -> "Mimic":
        """Return how this joint follows the joint that its own leader follows.

        Raises:
            BadJoint: the product is not finite.
        """
        if leader is None:
            return self
        offset = self.multiplier * leader.offset + self.offset
        return Mimic(leader.joint, self.multiplier * leader.multiplier, offset)


@dataclass(frozen=True)
class Joint:
    """How a node moves.

    Attributes:
        type: any but FIXED.
        name: its name in joint states; '' for a floating joint, which has the name of its node.
        axis: (3,) in the node's frame; it is normalized.
        limits: least and greatest position, rad or m; None if there are none.
        mimic: the joint that it follows; None if it has its own position. In a `SceneGraph`, that joint
            follows no other.
        max_speed: its greatest speed, rad/s or m/s; None if it is not known.
    """

    type: JointType
    name: str = ""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limits: tuple[float, float] | None = None
    mimic: Mimic | None = None
    max_speed: float | None = None

    def __post_init__(self) -> None:
        """Check what does not depend on other nodes.

        Raises:
            BadJoint: the description is invalid.
        """
        if self.type is JointType.FIXED:
            raise BadJoint("a node that is fixed has no joint; leave it out")
        if (self.type is JointType.FLOATING) != (not self.name):
            raise BadJoint("every joint needs a name, except floating joints, which have none")
        length = math.hypot(*self.axis)
        if not (math.isfinite(length) and length > 1e-9):
            raise BadJoint(f"the axis of joint {self.name!r} must have a direction; got {self.axis}")
        x, y, z = self.axis
        object.__setattr__(self, "axis", (x / length, y / length, z / length))
        if self.limits is not None and not self.limits[0] <= self.limits[1]:
            raise BadJoint(f"limits of joint {self.name!r} must be [lower, upper]; got {list(self.limits)}")
        if self.max_speed is not None and not self.max_speed > 0:
            raise BadJoint(f"the speed of joint {self.name!r} must be greater than 0; got {self.max_speed:g}")
        if self.mimic is not None and self.type is JointType.FLOATING:
            raise BadJoint("a floating joint cannot follow another joint")

    def allows(self, position: float) -> bool:
        """Return whether a position is within the limits."""
        return self.limits is None or self.limits[0] <= position <= self.limits[1]


@dataclass(frozen=True)
class Node:
    """A frame: its parent, its pose in the parent, and how it may move there.

    Attributes:
        name: unique in its graph; without the slash that ROS 1 puts before it.
        parent: the name of its parent, likewise; None for a root.
        origin: X_PN, its pose in the parent, with the joint (if any) at position 0.
        joint: None if it is fixed.
    """

    name: str
    parent: str | None = None
    origin: RigidTransform = IDENTITY
    joint: Joint | None = None

    def __post_init__(self) -> None:
        """Check what does not depend on other nodes.

        Raises:
            BadJoint: the description is invalid.
        """
        object.__setattr__(self, "name", without_slash(self.name))
        if self.parent is not None:
            object.__setattr__(self, "parent", without_slash(self.parent))
        if not self.name:
            raise BadJoint("a node needs a name")
        if self.parent is None and (self.joint is not None or self.origin != IDENTITY):
            raise BadJoint(f"node {self.name!r} has no parent, so it can have neither a pose nor a joint")
        if self.joint and self.joint.type is JointType.FLOATING and self.origin != IDENTITY:
            raise BadJoint(f"node {self.name!r} is floating, so messages set its pose; leave its pose out")

    @property
    def joint_type(self) -> JointType:
        """The type of its joint; FIXED if it has none."""
        return self.joint.type if self.joint else JointType.FIXED
