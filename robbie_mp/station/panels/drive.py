"""Manual driving: the robot moves only while the operator holds a control."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from robbie_mp.messages import DriveCommand, Duration, Odometry
from robbie_mp.station.access import Role
from robbie_mp.station.context import Page, header_of_now
from robbie_mp.station.dead_man import DeadManSwitch
from robbie_mp.station.latest import silence
from robbie_mp.station.panel import Panel

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

VALID_FOR = Duration.from_nanoseconds(220_000_000)
"""The base brakes when no further command arrives within this time, which is two heartbeats."""
SILENT_AFTER_S = 1.0
"""Maximum time between two odometry messages of a working base."""
MANUAL_TOPIC = "manual"
STYLE = """.drive-pad {position: relative; width: 18rem; height: 18rem; border-radius: 1rem;
  touch-action: none; background: #263238; border: 2px solid #607d8b; cursor: grab}
.drive-knob {position: absolute; left: 50%; top: 50%; width: 4rem; height: 4rem; border-radius: 50%;
  margin: -2rem; background: #90a4ae; pointer-events: none}"""


class DrivePad(Element, component="drive_pad.js"):
    """The pad that the operator holds to drive."""


class DrivePanel(Panel):
    """Shows pad, keys and gamepad, speed limits, and the page that drives."""

    name = "drive"
    title = "Drive"
    icon = "sports_esports"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._odometry = station.newest(Odometry, "odom")

    def build(self, page: Page) -> None:
        """Build the controls for operators, and the velocity for all visitors."""
        ui.add_css(STYLE)
        with ui.row().classes("gap-8 items-start"):
            if page.role is Role.OPERATOR:
                DriverControls(self.station, page)
            shown = ui.label("").classes("text-lg").props("id=velocity")

        def update() -> None:
            odometry = self._odometry.message
            if odometry is not None:
                twist = odometry.twist.twist
                silent = silence(self._odometry.age_s, SILENT_AFTER_S)
                age = f" ({silent} ago; the odometry is silent)" if silent else ""
                shown.set_text(f"{twist.linear.x:.2f} m/s, {twist.angular.z:.2f} rad/s{age}")
                shown.classes(add="text-orange" if silent else "", remove="" if silent else "text-orange")

        page.every(0.2, self.name, update)


class DriverControls:
    """The controls of one page.

    Args:
        station: holds the driving page and the speed limits.
        page: publishes the commands.
    """

    def __init__(self, station: StationContext, page: Page):
        self._station = station
        self._page = page
        self._switch = DeadManSwitch()
        with ui.column():
            pad = DrivePad().props("id=drive-pad")
            pad.on("drive", self._on_drive)
            ui.label("Hold and move; or W A S D, arrows; or a gamepad with its right shoulder button held")
            self._seat = ui.label("").props("id=drivers-seat")
            self._take_over = ui.button("Take over", on_click=self._sit_down).props("id=take-over")
        with ui.column().classes("w-64"):
            ui.label("fastest ahead, m/s")
            self._linear = ui.slider(min=0.05, max=station.max_linear_m_per_s, step=0.05)
            self._linear.set_value(station.max_linear_m_per_s / 2)
            self._linear.props('label id=linear-limit aria-label="Fastest ahead in m/s"')
            ui.label("fastest turn, rad/s")
            self._angular = ui.slider(min=0.1, max=station.max_angular_rad_per_s, step=0.1)
            self._angular.set_value(station.max_angular_rad_per_s / 2)
            self._angular.props('label id=angular-limit aria-label="Fastest turn in rad/s"')
        page.every(0.5, DrivePanel.name, self._show_seat)

    def _sit_down(self) -> None:
        if self._page.may("taking over"):
            self._station.drivers_seat.take(self._page.key, over=True)
            self._show_seat()

    def _show_seat(self) -> None:
        holder = self._station.drivers_seat.holder
        other = holder not in (None, self._page.key)
        self._take_over.set_visibility(other)
        late = f"; {self._switch.stale} commands came too late" if self._switch.stale else ""
        own = f"this page drives{late}" if holder else "nobody drives"
        self._seat.set_text("another page drives" if other else own)

    def _on_drive(self, event: GenericEventArguments) -> None:
        command = checked(event.args)
        if command is None or not self._page.may("driving"):
            return
        if not self._station.drivers_seat.take(self._page.key):
            return
        held, begins, linear, angular, sent_s = command
        if begins:
            self._switch.begin()
        if not self._switch.accept(sent_s, time.monotonic()) and held:
            return
        self._page.publish(
            DriveCommand(
                header=header_of_now(self._station, "base_link"),
                linear_m_per_s=linear * float(self._linear.value),
                angular_rad_per_s=angular * float(self._angular.value),
                valid_for=VALID_FOR,
            ),
            "the command",
            MANUAL_TOPIC,
        )


def checked(sent: Any) -> tuple[bool, bool, float, float, float] | None:
    """Return the command that the pad sent, with speeds from -1 to 1; None if it is malformed."""
    try:
        numbers = [float(sent[name]) for name in ("linear", "angular", "sent_s")]
    except (KeyError, TypeError, ValueError):
        return None
    if not all(map(math.isfinite, numbers)):
        return None
    linear, angular = (max(-1.0, min(1.0, number)) for number in numbers[:2])
    return bool(sent.get("held")), bool(sent.get("begins")), linear, angular, numbers[2]
