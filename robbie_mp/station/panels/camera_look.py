"""Where the camera looks, and the operator's turning of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui.element import Element

from robbie_mp.scene import SceneGraphError
from robbie_mp.station.context import header_of_now
from robbie_mp.station.driving.held_control import HeldControl

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.scene import SceneGraph
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.joints import JointId, JointsWatch

BASE = "base_link"
PAN, TILT = "pan", "tilt"
AHEAD_RAD = 0.3
"""A held key turns the camera towards a goal that is this far away, and so as fast as it can."""
VIEW_RAD = 1.0
"""A drag over the whole width of the picture turns the camera by this angle, about what a camera sees."""


class LookKeys(Element, component="camera_look.js"):
    """Listens to keys, the gamepad and the picture of the page."""


class LookWish(NamedTuple):
    """What the page of an operator has sent."""

    held: bool
    begins: bool
    sent_s: float
    turn: tuple[float, float] | None = None
    """To the left and down, from -1 to 1."""
    drag: tuple[float, float] | None = None
    """To the left and down since the drag began, in widths of the picture."""


class CameraLook:
    """Turns the joints `pan` and `tilt` for the page of an operator, if a module offers them.

    A wish without turn and drag centres the camera.

    Args:
        station: has the joints, and knows who drives.
        page: publishes the commands.
    """

    def __init__(self, station: StationContext, page: Page):
        self._joints, self._clock, self._page = station.robot.joints, station.clock, page
        self._control = HeldControl(station.operators, page, "turning the camera")
        self._begin: dict[JointId, float] = {}
        LookKeys().props("id=camera-look").on("look", self._on_look)

    def _on_look(self, event: GenericEventArguments) -> None:
        wish, joints = checked(event.args), head(self._joints)
        if wish is None or not joints:
            return
        header = header_of_now(self._clock)  # first: the age counts from then
        age_s = self._control.age_s(held=wish.held, begins=wish.begins, sent_s=wish.sent_s)
        if not wish.held or age_s is None:
            return
        at = {joint: self._joints.position_rad(joint) for joint in joints}
        if wish.begins:
            self._begin = {joint: position for joint, position in at.items() if position is not None}
        goals = {
            joint.key: goal
            for joint in joints
            if (goal := goal_of(wish, joint.name == TILT, at[joint], self._begin.get(joint))) is not None
        }
        for topic, command in self._joints.commands(goals, age_s, header).items():
            self._page.publish(command, "the command", topic)


def head(joints: JointsWatch) -> list[JointId]:
    """Return the joints that turn the camera: `pan` and `tilt` of one module; none if nobody offers them."""
    found = [joint for joint in joints.limits if joint.name in (PAN, TILT)]
    return [joint for joint in found if joint.topic == found[0].topic]


def goal_of(wish: LookWish, is_tilt: bool, at_rad: float | None, begin_rad: float | None) -> float | None:
    """Return where a joint shall go, rad; None: it stays, or nobody knows where it is."""
    if wish.turn is None and wish.drag is None:
        return 0.0
    if wish.drag is not None:
        return None if begin_rad is None else begin_rad + VIEW_RAD * wish.drag[is_tilt]
    share = wish.turn[is_tilt] if wish.turn else 0.0
    return None if at_rad is None or not share else at_rad + AHEAD_RAD * share


def checked(sent: Any) -> LookWish | None:
    """Return what the page sent; None if it is malformed."""
    try:
        pairs = {name: None if sent.get(name) is None else _pair(sent[name]) for name in ("turn", "drag")}
        sent_s = float(sent["sent_s"])
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        return None
    if not math.isfinite(sent_s):
        return None
    return LookWish(bool(sent.get("held")), bool(sent.get("begins")), sent_s, **pairs)


def _pair(sent: Any) -> tuple[float, float]:
    """Return two numbers from -1 to 1.

    Raises:
        ValueError: there are not two, or one is not finite.
    """
    left, down = (float(part) for part in sent)
    if not (math.isfinite(left) and math.isfinite(down)):
        raise ValueError(sent)
    return max(-1.0, min(1.0, left)), max(-1.0, min(1.0, down))


def direction_of(graph: SceneGraph, frame: str) -> tuple[float, float] | None:
    """Return where a camera looks: to the left of the robot's front, and down, rad; None if unknown.

    Args:
        graph: the scene graph.
        frame: the frame of the camera's images, whose z axis is the direction of its view.
    """
    try:
        pose = graph.pose(BASE, frame)
    except SceneGraphError:
        return None
    x, y, z = (pose.apply([[0.0, 0.0, 1.0]]) - pose.apply([[0.0, 0.0, 0.0]]))[0].tolist()
    return math.atan2(y, x), -math.asin(max(-1.0, min(1.0, z)))
