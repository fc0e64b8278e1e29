"""Manual control of the robot's joints and lights: arms, grippers, pan-tilt units, lamps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import ui
from nicegui.element import Element

from robbie_mp.station.context import header_of_now
from robbie_mp.station.driving.held_control import HeldControl
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.light_controls import LightSliders
from robbie_mp.station.watch.joints import MAX_JOINTS

if TYPE_CHECKING:
    from nicegui.events import GenericEventArguments

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Page

STYLE = Path(__file__).parent / "joints.css"
GRIPPERS = ("gripper", "finger", "hand")
"""A joint with one of these in its name can be opened and closed: its greatest position is open."""


class Goals(NamedTuple):
    """Goals that a page has sent."""

    held: bool
    begins: bool
    positions: dict[str, float]
    """By the keys of the joints, rad."""
    sent_s: float


class JointControls(Element, component="joint_controls.js"):
    """The sliders and buttons."""

    def set(self, **properties: object) -> None:
        """Change properties of the page's script, if they differ."""
        if any(self._props.get(name) != value for name, value in properties.items()):
            self._props.update(properties)
            self.update()


class JointsPanel(Panel):
    """Sliders for all joints that modules offer with `JointLimits`, poses of the profile, and all lights.

    A joint moves only while the operator holds its slider or button: each `JointCommand` expires, as commands
    of the drive do. The robot then holds, until it is ordered to go on.
    """

    name = "joints"
    title = "Joints and lights"
    icon = "precision_manufacturing"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._clock = station.clock
        self._poses, self._lights = station.settings.poses, station.robot.lights
        self._operators = station.operators
        self._joints = station.robot.joints

    def shown(self) -> list[dict[str, Any]]:
        """Return the data of each joint for the page's script; `at` is None while it is not known."""
        rows = []
        for joint, (lower, upper) in self._joints.limits.items():
            position = self._joints.position_rad(joint)
            rows.append(
                {
                    "key": joint.key,
                    "name": joint.name,
                    "lower": lower,
                    "upper": upper,
                    "at": None if position is None else round(position, 4),
                    "is_gripper": any(word in joint.name.lower() for word in GRIPPERS),
                }
            )
        return rows

    def poses(self) -> list[dict[str, Any]]:
        """Return the poses of the profile whose joints are all there."""
        by_name = {joint.name: joint.key for joint in self._joints.limits}
        return [
            {"name": name, "goals": [[by_name[joint], position] for joint, position in pose.items()]}
            for name, pose in self._poses.items()
            if pose and set(pose) <= set(by_name)
        ]

    def build(self, page: Page) -> None:
        """Build the sliders."""
        ui.add_css(STYLE)
        hint = ui.label("no module offers joints or lights").classes("text-grey").props("id=joints-hint")
        seat = ui.label("").classes("text-orange").props("id=joints-seat role=status")
        controls = JointControls().props("id=joints-controls")
        lights = LightSliders(page, self._lights)
        control = HeldControl(self._operators, page, "moving a joint")

        def move(event: GenericEventArguments) -> None:
            goals = checked(event.args)
            if goals is None:
                return
            header = header_of_now(self._clock)
            age_s = control.age_s(held=goals.held, begins=goals.begins, sent_s=goals.sent_s)
            if goals.held and age_s is not None:
                for topic, command in self._joints.commands(goals.positions, age_s, header).items():
                    page.publish(command, "the command", topic)

        if page.can_command:
            controls.on("move", move)

        def update() -> None:
            rows = self.shown()
            hint.set_visibility(not lights.update() and not rows)
            is_other = control.is_other_driving
            delay = page.driver.delay if page.driver is not None else ""
            seat.set_text("somebody else drives; take over in Drive to move joints" if is_other else delay)
            can_move = page.can_command and not is_other
            controls.set(joints=rows, poses=self.poses(), can_move=can_move)

        page.every(0.2, self.name, update)


def checked(sent: Any) -> Goals | None:
    """Return the goals that a page's script has sent, or None if they are malformed."""
    try:
        positions = {str(key): float(position) for key, position in sent["goals"][:MAX_JOINTS]}
        sent_s = float(sent["sent_s"])
    except (KeyError, TypeError, ValueError):
        return None
    if not all(map(math.isfinite, (sent_s, *positions.values()))):
        return None
    return Goals(bool(sent.get("held")), bool(sent.get("begins")), positions, sent_s)
