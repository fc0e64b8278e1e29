"""Whether an arm touches its robot, tables, objects, or what it should not with what it holds.

Uses Coal (Pan et al., "FCL: A general purpose library for collision and proximity queries", ICRA 2012;
Montaut et al., "Collision detection accelerated: an optimization perspective", RSS 2022) by Pinocchio.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.manipulation.arm_model import ArmModel

Floats = NDArray[np.float64]

SELF_MARGIN_M = 0.005
"""Parts of the robot keep this far from one another."""


@dataclass(frozen=True)
class Shape:
    """A box, or an upright cylinder.

    Attributes:
        name: its name; no two obstacles have the same.
        size_m: extent in x, y, z; the x and y of a cylinder are its diameter.
        pose: the pose of its middle, (4, 4), in the base's frame; of what is held, in that of the tip.
        is_round: whether it is a cylinder about its z axis.
    """

    name: str
    size_m: tuple[float, float, float]
    pose: Floats
    is_round: bool = False


class CollisionWorld:
    """What an arm must not touch. It does not change; for other surroundings you make a new one.

    Args:
        arm: the arm.
        obstacles: what stands around the robot.
        margin_m: the arm keeps this far from obstacles.
        held: what is in the hand.
        held_margin_m: what is held keeps this far from obstacles; less than 0: it may stand on them.
        touchable: names of obstacles that the fingers may touch.
        fingers: the links of the fingers.
        palm: the link between them; it may touch what is held, as the fingers may.

    Attributes:
        checks: number of positions that were checked.
    """

    def __init__(
        self,
        arm: ArmModel,
        obstacles: Sequence[Shape] = (),
        *,
        margin_m: float = 0.01,
        held: Shape | None = None,
        held_margin_m: float = 0.01,
        touchable: Collection[str] = (),
        fingers: Collection[str] = ("left_finger", "right_finger"),
        palm: str = "hand",
    ) -> None:
        self.arm = arm
        self.checks = 0
        pin, model = arm.pin, arm.model
        self._geometry = geometry = pin.buildGeomFromUrdf(model, str(arm.file), pin.COLLISION)
        finger_frames = {arm.link(name) for name in fingers}
        hand_frames = finger_frames | {arm.link(palm)}
        own = list(range(geometry.ngeoms))
        margins = [SELF_MARGIN_M] * self._pair_own(own, hand_frames)
        moving = [one for one in own if geometry.geometryObjects[one].parentJoint > 0]
        held_place = None if held is None else self._add(held, arm.link(arm.tip), np.eye(4))
        if held_place is not None:
            for one in own:
                if geometry.geometryObjects[one].parentFrame not in hand_frames:
                    geometry.addCollisionPair(pin.CollisionPair(one, held_place))
                    margins.append(SELF_MARGIN_M)
        for shape in obstacles:
            place = self._add(shape, 0, arm.X_UB)
            for one in moving:
                is_finger = geometry.geometryObjects[one].parentFrame in finger_frames
                if not (is_finger and shape.name in touchable):
                    geometry.addCollisionPair(pin.CollisionPair(one, place))
                    margins.append(margin_m)
            if held_place is not None:
                geometry.addCollisionPair(pin.CollisionPair(held_place, place))
                margins.append(held_margin_m)
        self._data = pin.GeometryData(geometry)
        for request, margin in zip(self._data.collisionRequests, margins, strict=True):
            request.security_margin = margin
        self._model_data = model.createData()

    def _pair_own(self, own: list[int], hand_frames: set[int]) -> int:
        """Pair the parts of the robot that no joint, or more than one, lies between; return their number."""
        pin, model, geometry = self.arm.pin, self.arm.model, self._geometry
        count = 0
        for first in own:
            for second in own[first + 1 :]:
                one, other = geometry.geometryObjects[first], geometry.geometryObjects[second]
                joints = one.parentJoint, other.parentJoint
                is_joined = joints[0] == joints[1] or model.parents[max(joints)] == min(joints)
                if is_joined or {one.parentFrame, other.parentFrame} <= hand_frames:
                    continue
                geometry.addCollisionPair(pin.CollisionPair(first, second))
                count += 1
        return count

    def _add(self, shape: Shape, frame: int, to_frame: Floats) -> int:
        """Add a shape that is fixed to a frame; return its number."""
        pin, model = self.arm.pin, self.arm.model
        joint = model.frames[frame].parentJoint if frame else 0
        in_joint = model.frames[frame].placement.homogeneous if frame else np.eye(4)
        placement = pin.SE3(in_joint @ to_frame @ shape.pose)
        return int(
            self._geometry.addGeometryObject(
                pin.GeometryObject(shape.name, joint, frame, placement, _coal_shape(shape))
            )
        )

    def collides(self, positions: Floats, half_opening_m: float | None = None) -> bool:
        """Return whether the arm touches something; the gripper is open, or holds what it holds.

        Args:
            positions: (joints,) rad.
            half_opening_m: half of the gripper's opening; None: open.
        """
        self.checks += 1
        opening_m = self.arm.opening_m if half_opening_m is None else half_opening_m
        pin, q = self.arm.pin, self.arm.whole(positions, opening_m)
        return bool(
            pin.computeCollisions(self.arm.model, self._model_data, self._geometry, self._data, q, True)
        )

    def touching(self, positions: Floats) -> list[tuple[str, str]]:
        """Return the names of all pairs that are too near to each other, for errors."""
        pin, q = self.arm.pin, self.arm.whole(positions, self.arm.opening_m)
        pin.computeCollisions(self.arm.model, self._model_data, self._geometry, self._data, q, False)
        objects = self._geometry.geometryObjects
        return [
            (objects[pair.first].name, objects[pair.second].name)
            for pair, result in zip(self._geometry.collisionPairs, self._data.collisionResults, strict=True)
            if result.isCollision()
        ]

    def is_free(self, begin: Floats, end: Floats, step_rad: float) -> bool:
        """Return whether a straight way in joint space touches nothing; its beginning is not checked."""
        count = max(1, int(np.ceil(np.abs(end - begin).max() / step_rad)))
        # From both ends inwards finds most collisions early.
        shares = np.arange(1, count + 1) / count
        order = np.argsort(np.abs(shares - 0.5), kind="stable")[::-1]
        return not any(self.collides(begin + share * (end - begin)) for share in shares[order])


def _coal_shape(shape: Shape) -> Any:
    import coal  # noqa: PLC0415  # comes with Pinocchio, which is an extra

    x, y, z = shape.size_m
    return coal.Cylinder(x / 2, z) if shape.is_round else coal.Box(x, y, z)
