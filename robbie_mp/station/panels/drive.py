"""Manual driving: the pad and the maximum speeds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

from robbie_mp.station.page.slider import Slider
from robbie_mp.station.panel import Panel

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.page.page import Drives, Page

STYLE = Path(__file__).parent / "drive.css"


class DrivePad(Element, component="drive_pad.js"):
    """The pad that the operator holds to drive."""


class DrivePanel(Panel):
    """Shows the pad and speed limits."""

    name = "drive"
    title = "Drive"
    icon = "sports_esports"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._settings = station.settings
        self._motion = station.robot.motion

    def build(self, page: Page) -> None:
        """Build the controls for operators, and the velocity for all visitors."""
        ui.add_css(STYLE)
        with ui.element("div").classes("drive-area"):
            if page.driver is not None:
                DrivePad().props("id=drive-pad")
            with ui.element("div").classes("drive-side"):
                shown = ui.label("").classes("drive-speed").props("id=velocity")
                if page.driver is not None:
                    self._build_controls(page, page.driver)

        def update() -> None:
            now = self._motion.now
            if now.linear_m_per_s is not None and now.angular_rad_per_s is not None:
                age = f" ({now.silent} ago; the odometry is silent)" if now.silent else ""
                shown.set_text(f"{now.linear_m_per_s:.2f} m/s, {now.angular_rad_per_s:.2f} rad/s{age}")
                shown.classes(
                    add="text-orange" if now.silent else "", remove="" if now.silent else "text-orange"
                )

        page.every(0.2, self.name, update)

    def _build_controls(self, page: Page, driver: Drives) -> None:
        linear_text = ui.label("")
        linear = Slider(min=0.05, max=self._settings.max_linear_m_per_s, step=0.05)
        linear.props('id=linear-limit dense aria-label="Fastest ahead in m/s"')
        angular_text = ui.label("")
        angular = Slider(min=0.1, max=self._settings.max_angular_rad_per_s, step=0.1)
        angular.props('id=angular-limit dense aria-label="Fastest turn in rad/s"')
        without_guard = ui.switch("without guard, until you let go").props("id=without-guard dense")
        ui.label(
            "Hold and move; or W A S D, arrows; or a gamepad with its right shoulder button held. "
            "Shift: without the guard against collisions"
        ).classes("drive-hint text-xs")

        def limit_linear(value: float) -> None:
            driver.linear_m_per_s = value

        def limit_angular(value: float) -> None:
            driver.angular_rad_per_s = value

        def change_guard(value: bool) -> None:
            driver.without_guard = value

        without_guard.on_value_change(lambda event: change_guard(bool(event.value)))
        linear.on_value_change(lambda event: limit_linear(float(event.value)))
        angular.on_value_change(lambda event: limit_angular(float(event.value)))

        def update() -> None:
            linear.set_value(driver.linear_m_per_s)
            angular.set_value(driver.angular_rad_per_s)
            linear_text.set_text(f"fastest ahead {driver.linear_m_per_s:.2f} m/s")
            angular_text.set_text(f"fastest turn {driver.angular_rad_per_s:.2f} rad/s")
            without_guard.set_value(driver.without_guard)

        update()
        page.every(0.25, self.name, update)
