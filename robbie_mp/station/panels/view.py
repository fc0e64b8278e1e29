"""Shows the robot, its map and its sensor data in three dimensions."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING

from nicegui import app, ui
from nicegui.events import GenericEventArguments

from robbie_mp.messages import PoseStamped
from robbie_mp.station.driving.motion import heading_deg
from robbie_mp.station.map.goals import GOAL, checked, place
from robbie_mp.station.page.menus import popup
from robbie_mp.station.page.page import Page
from robbie_mp.station.page.tool_button import tool_button
from robbie_mp.station.panel import Panel
from robbie_mp.station.scene_view.drawing import Moving, SceneDrawing
from robbie_mp.station.scene_view.surroundings import SceneContents, Surveyor

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

GROUP = "view"
"""Group of live parts that move."""
PERIOD_S = 0.2
"""Time between updates of the objects and of the line of text."""
LOAD = """window.first_picture.then(() => import("nicegui-scene")).then(() => true)"""
"""Loads the library of the scene, which is large, after the first picture of the camera to drive by."""
LOAD_LIMIT_S = 60.0
COLOURS = {"plain": "one colour", "height": "by height", "intensity": "by intensity"}
BEHIND_AND_ABOVE_M = (-3.0, 0.0, 3.0)
"""Initial position of the camera relative to the robot."""


class ViewPanel(Panel):
    """The 3-D view."""

    name = "view"
    title = "3-D view"
    icon = "view_in_ar"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._surveyor = Surveyor(station)
        self._live, self._clock = station.live, station.clock
        self._births = station.robot.births
        self._size_m, model = station.settings.robot_size_m, station.settings.robot_model
        self._pose = station.messages.newest(PoseStamped, "map_pose")
        self.surroundings: SceneContents | None = None
        self._model_url = ""
        if model is not None:
            url = f"/robot-model{model.suffix.lower()}"
            self._model_url = app.add_static_file(local_file=model, url_path=url)

    def tick(self) -> None:
        """Update the surroundings, if any page shows them."""
        if self._live.is_wanted(GROUP):
            self.surroundings = self._surveyor.look()
            born = json.dumps(self._births.of(self._pose)).encode()
            self._live.put(GROUP, {**self.surroundings.parts(), "born": born})

    def build(self, page: Page) -> None:
        """Build the scene."""
        with ui.row().classes("items-center view-tools"):
            follows = ui.switch("follow", value=True).props('id=view-follow title="Follow the robot"')
            presets = {
                name: tool_button(icon, f"view-{name}", title)
                for name, icon, title in (
                    ("behind", "smart_toy", "Look from behind the robot"),
                    ("above", "vertical_align_bottom", "Look from above"),
                )
            }
            sets_goal = ui.switch("set goal").props("id=view-goal")
            sets_goal.set_visibility(page.can_command)
            with (
                tool_button("layers", "view-layers", "What is drawn"),
                popup("What is drawn"),
                ui.column().classes("q-pa-sm gap-0"),
            ):
                colours = ui.select(COLOURS, value="plain", label="points").classes("w-full")
                colours.props("id=view-colours dense")
                walls = ui.checkbox("walls", value=True).props("id=view-walls")
                names = ui.checkbox("frame names").props("id=view-names")
        stage = ui.element("div").classes("w-full fills scene-stage")
        shown = ui.label("nothing is known yet").props("id=view-figures")
        wishes: dict[str, object] = {}
        made: list[tuple[Moving, SceneDrawing]] = []

        def wish(**properties: object) -> None:
            wishes.update(properties)
            for moving, _ in made:
                moving.set(**properties)

        follows.on_value_change(lambda event: wish(follows=bool(event.value)))
        walls.on_value_change(lambda event: wish(walls=bool(event.value)))
        colours.on_value_change(lambda event: wish(colours=str(event.value)))
        sets_goal.on_value_change(lambda event: wish(placing=GOAL if event.value else ""))
        for name, button in presets.items():
            button.on_click(lambda name=name: [one.run_method("preset", name) for one, _ in made])

        def placed(event: GenericEventArguments) -> None:
            placement = checked(event.args)
            if placement is not None and placement.kind == GOAL and page.may_move("the goal"):
                place(page, self._clock, placement, self._pose.message)
            sets_goal.set_value(False)

        async def update() -> None:
            if not made:
                # Otherwise all other changes of the page would wait for it, seconds on a slow network.
                with suppress(TimeoutError):
                    await ui.run_javascript(LOAD, timeout=LOAD_LIMIT_S)
                with stage:
                    made.append(self._make_scene())
                made[0][0].set(**wishes)
                if page.can_command:
                    made[0][0].on("placed", placed)
            if self.surroundings is not None:
                shown.set_text(in_words(self.surroundings))
                made[0][1].show(self.surroundings, names=bool(names.value))

        page.every(PERIOD_S, self.name, update)

    def _make_scene(self) -> tuple[Moving, SceneDrawing]:
        """Make the scene."""
        with Moving().classes("w-full").props("id=view-moving") as moving:
            scene = ui.scene(grid=False, background_color="#1d232a", click_events=[])
            scene.style("width: 100%; height: 65vh").props("id=view-scene")
        scene.move_camera(*BEHIND_AND_ABOVE_M, 0.0, 0.0, 0.0, duration=0)
        moving.move_in(scene)
        return moving, SceneDrawing(scene, self._size_m, self._model_url)


def in_words(now: SceneContents) -> str:
    """Return a line with the robot's position and the number of other objects."""
    if now.robot is None:
        where = "nobody has said where the robot is"
    else:
        x, y, _ = now.robot.translation
        where = f"robot at {x:.2f} m, {y:.2f} m, {heading_deg(now.robot.yaw)}°"
    others = "".join(
        f"; {name} at {pose.translation[0]:.2f} m, {pose.translation[1]:.2f} m"
        for name, pose in now.others.items()
    )
    marked = "".join(f"{len(marks)} {title}, " for title, marks in now.marks.items() if marks)
    return f"{where}{others}; {now.count} points, {marked}{len(now.places)} points of interest"
