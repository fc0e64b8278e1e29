"""Objects on tables that a simulated gripper grasps, carries, puts down, drops or knocks over."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.simulation.solid import Placed, Solid, moved, pose_at

Floats = NDArray[np.float64]

STEP_M = 0.005
"""Distance of the points of an object's surface."""
ARM_STEP_M = 0.01
"""Distance of the points of the arm's surface."""
DEEP_M = 0.003
"""A touch begins at this depth: what is less lies within the errors of shapes and points."""
SHIFT_M = 0.008
"""A pad pushes an object aside by at most this much between two looks; beyond, it knocks it over."""
SLIP_M = 0.015
"""What is held badly slips when the hand has moved this far."""
FALL_M = 0.03
"""An object that falls deeper than this falls over."""
LEAN_RAD = 0.35
"""An object that leans more than this when it is let go falls over."""
SKEW_RAD = 0.3
"""A face that is turned more than this against the pads is held badly."""


@dataclass(frozen=True)
class Pads:
    """The inner faces of the two fingers, in the frame of the grasp point (x out of the hand, y to the left).

    Attributes:
        length_m: extent in x.
        height_m: extent in z.
        thick_m: thickness of a finger.
    """

    length_m: float = 0.06
    height_m: float = 0.024
    thick_m: float = 0.012


@dataclass(frozen=True)
class TableObject:
    """An object that stands on a table.

    Attributes:
        name: its name.
        solid: its shape.
        pose: X_AO, the pose of its middle in the arena at the beginning: (4, 4).
    """

    name: str
    solid: Solid
    pose: Floats


@dataclass
class _State:
    pose: Floats
    lies: bool = False
    is_taken: bool = False


@dataclass(frozen=True)
class _Grip:
    """How an object is held: X_GO, half of its width between the pads, and whether it will slip."""

    name: str
    pose: Floats
    half_m: float
    is_firm: bool


class Tabletop:
    """Owns the true poses of all objects.

    It knows no forces. Pads push an object along until both touch it, and then hold it, unless its faces are
    askew: then it slips as soon as the hand moves. What is let go falls straight down, and stands if it was
    upright and near to what is below; or a person takes it. What an arm touches otherwise falls over.

    Args:
        objects: the objects.
        tables: boxes on which objects can stand, arena frame.
        state: what `memory` returned, to go on from there.
    """

    def __init__(
        self,
        objects: Sequence[TableObject],
        tables: Sequence[Placed],
        state: dict[str, Any] | None = None,
    ) -> None:
        self.objects = tuple(objects)
        self._tables = tuple(tables)
        self._pads = Pads()
        self._points = {one.name: one.solid.surface(STEP_M) for one in objects}
        self._arm_points: dict[Solid, Floats] = {}
        self._solids = {one.name: one.solid for one in objects}
        self._states = {one.name: _State(one.pose) for one in objects}
        self._grip: _Grip | None = None
        self._gripped_at: Floats | None = None
        self._last_half_m = 0.0
        self.knocked: list[str] = []
        """Objects that fell over, in order."""
        self.slips = 0
        """How often an object slipped out of the hand."""
        self.contacts = 0
        """How often the arm, or what it holds, began to touch a table or the floor."""
        self._is_touching = False
        if state is not None:
            self._remember(state)

    @property
    def held(self) -> str | None:
        """Return the name of the object in the hand."""
        return None if self._grip is None else self._grip.name

    def pose(self, name: str) -> Floats:
        """Return X_AO of an object: (4, 4)."""
        return self._states[name].pose

    def is_taken(self, name: str) -> bool:
        """Return whether somebody has taken an object; it is not in the room any more."""
        return self._states[name].is_taken

    def lies(self, name: str) -> bool:
        """Return whether an object has fallen over."""
        return self._states[name].lies

    def placed(self) -> list[Placed]:
        """Return all objects that nobody has taken as solids in the arena."""
        return [
            Placed(self._solids[name], state.pose)
            for name, state in self._states.items()
            if not state.is_taken
        ]

    def step(
        self, hand: Floats, half_opening_m: float, arm: Sequence[Placed], somebody_takes: bool = False
    ) -> float:
        """Apply a small movement of the arm.

        Args:
            hand: X_AG, the pose of the grasp point: (4, 4).
            half_opening_m: distance of each pad from the middle.
            arm: the shapes of the arm, hand and fingers.
            somebody_takes: whether a person takes what the gripper lets go.

        Returns:
            The least half opening that what is between the pads allows; 0 if nothing is.
        """
        if self._grip is not None:
            self._carry(self._grip, hand, half_opening_m, somebody_takes)
        if self._grip is None:
            self._close_around(hand, half_opening_m)
        self._last_half_m = half_opening_m
        self._touch(arm)
        return self._grip.half_m if self._grip is not None else 0.0

    # -- the hand ---------------------------------------------------------------------------------------

    def _carry(self, grip: _Grip, hand: Floats, half_opening_m: float, somebody_takes: bool) -> None:
        """Move what is held with the hand, or let it go."""
        assert self._gripped_at is not None
        is_open = half_opening_m > grip.half_m + 0.001
        has_moved = math.dist(hand[:3, 3], self._gripped_at[:3, 3]) > SLIP_M
        if is_open or (has_moved and not grip.is_firm):
            self.slips += not is_open
            self._grip = self._gripped_at = None
            if is_open and somebody_takes:
                self._states[grip.name].is_taken = True
            else:
                self._drop(grip.name)
        else:
            self._states[grip.name].pose = hand @ grip.pose

    def _close_around(self, hand: Floats, half_opening_m: float) -> None:
        """Push what is between the pads, and hold it if both touch it."""
        to_hand = np.linalg.inv(hand)
        for name, state in self._states.items():
            if state.is_taken:
                continue
            pose = to_hand @ state.pose
            least, most = self._between_pads(moved(pose, self._points[name]))
            if not abs(least + most) / 2 < half_opening_m:
                continue  # nothing of it is between the pads
            half_m = (most - least) / 2
            shift_m = max(0.0, -half_opening_m - least) - max(0.0, most - half_opening_m)
            if half_opening_m <= half_m + 0.0005:
                shift_m = -(least + most) / 2
            # Between two looks, pads may close farther than the object allows.
            was_around = self._last_half_m >= half_m
            if abs(shift_m) > SHIFT_M or (half_m > half_opening_m + DEEP_M and not was_around):
                continue  # that is no push: `_touch` sees it
            if shift_m:
                state.pose = state.pose.copy()
                state.pose[:3, 3] += hand[:3, 1] * shift_m
            if half_opening_m <= half_m + 0.0005:
                held = to_hand @ state.pose
                self._grip = _Grip(name, held, half_m, self._is_firm(self._solids[name], held))
                self._gripped_at = hand.copy()
                return

    def _between_pads(self, points: Floats) -> tuple[float, float]:
        """Return the extent along y of the points between the pads; NaN without any."""
        pads = self._pads
        within = (np.abs(points[:, 0]) < pads.length_m / 2) & (np.abs(points[:, 2]) < pads.height_m / 2)
        across = points[within, 1]
        return (float(across.min()), float(across.max())) if len(across) else (math.nan, math.nan)

    def _is_firm(self, solid: Solid, pose: Floats) -> bool:
        """Return whether the pads lie flat on an object with this pose at the grasp point."""
        across = np.abs(pose[1, :3])  # the direction between the pads along the object's axes
        if solid.is_round:
            lean_rad = math.asin(min(1.0, float(across[2])))
            return min(lean_rad, math.pi / 2 - lean_rad) < SKEW_RAD
        return math.acos(min(1.0, float(across.max()))) < SKEW_RAD

    # -- falling ----------------------------------------------------------------------------------------

    def _drop(self, name: str) -> None:
        """Let an object fall down."""
        state, solid = self._states[name], self._solids[name]
        x, y, _ = state.pose[:3, 3]
        lowest = float(moved(state.pose, self._points[name])[:, 2].min())
        support = self._support_m(x, y)
        lean_rad = math.acos(max(-1.0, min(1.0, float(state.pose[2, 2]))))
        if lean_rad > LEAN_RAD or lowest - support > FALL_M:
            self._knock(name)
            return
        yaw = math.atan2(state.pose[1, 0], state.pose[0, 0])
        state.pose = pose_at((x, y, support + solid.size_m[2] / 2), yaw)
        for other in self._states:
            if other != name and not self.is_taken(other) and self._overlap(name, other):
                self._knock(other)
                self._knock(name)

    def _knock(self, name: str) -> None:
        """Lay an object down."""
        state, solid = self._states[name], self._solids[name]
        if state.lies:
            return
        state.lies = True
        self.knocked.append(name)
        x, y, _ = state.pose[:3, 3]
        yaw = math.atan2(state.pose[1, 0], state.pose[0, 0])
        lying = np.eye(4)
        lying[:3, :3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]  # its z lies along x
        state.pose = pose_at((x, y, self._support_m(x, y) + solid.size_m[0] / 2), yaw) @ lying

    def _support_m(self, x: float, y: float) -> float:
        """Return the height of what is below a place."""
        tops = [0.0]
        for table in self._tables:
            place = (np.array([x, y]) - table.pose[:2, 3]) @ table.pose[:2, :2]
            if (np.abs(place) <= np.array(table.solid.size_m[:2]) / 2).all():
                tops.append(float(table.pose[2, 3]) + table.solid.size_m[2] / 2)
        return max(tops)

    def _overlap(self, name: str, other: str) -> bool:
        first = Placed(self._solids[name], self._states[name].pose)
        second = Placed(self._solids[other], self._states[other].pose)
        if not first.is_near(second):
            return False
        points = moved(second.pose, self._points[other])
        return bool(first.contains(points, DEEP_M).any())

    # -- touching ---------------------------------------------------------------------------------------

    def _touch(self, arm: Sequence[Placed]) -> None:
        """Find out what the arm touches that it should not."""
        for name, state in self._states.items():
            if name == self.held or state.lies or state.is_taken:
                continue
            there = Placed(self._solids[name], state.pose)
            near = [shape for shape in arm if shape.is_near(there)]
            points = moved(state.pose, self._points[name]) if near else np.empty((0, 3))
            is_hit = any(shape.contains(points, DEEP_M).any() for shape in near)
            if is_hit or (self.held is not None and self._overlap(self.held, name)):
                self._knock(name)
        is_touching = any(self._hits_ground(shape, DEEP_M) for shape in arm)
        if self.held is not None:
            held = Placed(self._solids[self.held], self._states[self.held].pose)
            is_touching = is_touching or self._hits_ground(held, 2 * DEEP_M)
        self.contacts += is_touching and not self._is_touching
        self._is_touching = is_touching

    def _hits_ground(self, shape: Placed, deeper_than_m: float) -> bool:
        """Return whether a shape is in a table or in the floor."""
        near = [table for table in self._tables if shape.is_near(table)]
        if not near and shape.pose[2, 3] > shape.radius_m:
            return False
        if shape.solid not in self._arm_points:
            self._arm_points[shape.solid] = shape.solid.surface(ARM_STEP_M)
        points = moved(shape.pose, self._arm_points[shape.solid])
        if (points[:, 2] < -deeper_than_m).any():
            return True
        return any(table.contains(points, deeper_than_m).any() for table in near)

    # -- restarts ---------------------------------------------------------------------------------------

    def memory(self) -> dict[str, Any]:
        """Return the state as plain data."""
        grip = self._grip
        return {
            "objects": {
                name: {"pose": state.pose.tolist(), "lies": state.lies, "is_taken": state.is_taken}
                for name, state in self._states.items()
            },
            "grip": None if grip is None else [grip.name, grip.pose.tolist(), grip.half_m, grip.is_firm],
            "gripped_at": None if self._gripped_at is None else self._gripped_at.tolist(),
            "knocked": list(self.knocked),
            "slips": self.slips,
            "contacts": self.contacts,
        }

    def _remember(self, state: dict[str, Any]) -> None:
        for name, one in state["objects"].items():
            self._states[name] = _State(np.array(one["pose"]), one["lies"], one["is_taken"])
        if state["grip"] is not None:
            name, pose, half_m, is_firm = state["grip"]
            self._grip = _Grip(name, np.array(pose), half_m, is_firm)
            self._gripped_at = np.array(state["gripped_at"])
        self.knocked = list(state["knocked"])
        self.slips, self.contacts = state["slips"], state["contacts"]
