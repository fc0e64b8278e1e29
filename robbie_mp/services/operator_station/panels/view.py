"""The robot, its map and what its sensors see, in three dimensions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.services.operator_station.panel import Page, Panel
from robbie_mp.services.operator_station.scene_view.drawing import Drawing
from robbie_mp.services.operator_station.scene_view.surroundings import Surroundings, Surveyor

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.station import OperatorStation

PERIOD_S = 0.2
BROWSER_LIMIT_S = 5.0


class ViewPanel(Panel):
    """The 3-D view."""

    name = "view"
    title = "3-D view"
    icon = "view_in_ar"

    def __init__(self, station: OperatorStation):
        super().__init__(station)
        self._surveyor = Surveyor(station)
        self.surroundings: Surroundings | None = None

    def tick(self) -> None:
        """Look around, if anybody wants to see it."""
        if self.is_looked_at:
            self.surroundings = self._surveyor.look()

    def build(self, page: Page) -> None:
        """Make the scene."""
        with ui.row().classes("items-center gap-6"):
            follows = ui.switch("follow the robot", value=True).props("id=view-follow")
            names = ui.switch("frame names").props("id=view-names")
            shown = ui.label("nothing is known yet").props("id=view-figures")
        scene = ui.scene(grid=False, background_color="#1d232a", fps=15, click_events=[])
        scene.style("width: 100%; height: 65vh").props("id=view-scene")
        drawing = Drawing(scene, self.station.robot_size_m)
        last: Surroundings | None = None

        async def update() -> None:
            nonlocal last
            now = self.surroundings
            if now is None or now is last:
                return
            before, last = last, now
            shown.set_text(in_words(now))
            drawing.show(now, names=bool(names.value))
            # Its answer says that the browser has come so far: a slow one gets fewer pictures, not a queue.
            try:
                camera = await scene.run_method("get_camera", timeout=BROWSER_LIMIT_S)
            except TimeoutError:
                return
            if follows.value and camera is not None:
                drawing.follow(camera["position"], before, now)

        page.every(PERIOD_S, self.name, update)


def in_words(now: Surroundings) -> str:
    """Say where the robot is, and how much else there is to be seen."""
    if now.robot is None:
        where = "nobody has said where the robot is"
    else:
        x, y, _ = now.robot.translation
        where = f"robot at {x:.2f} m, {y:.2f} m, {math.degrees(now.robot.yaw):.0f}°"
    return f"{where}; {now.count} points, {len(now.victims)} victims"
