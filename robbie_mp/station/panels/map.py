"""The map from above, with robots, path, goal, frontiers, places and marks. Operators set goals on it."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from robbie_mp.messages import (
    CancelNavigation,
    Frontiers,
    NavigateTo,
    OccupancyGrid,
    Path,
    Point,
    PointOfInterest,
    Pose,
    PoseStamped,
    Quaternion,
)
from robbie_mp.scene_graph import RigidTransform
from robbie_mp.station.access import Role
from robbie_mp.station.context import Page, header_of_now
from robbie_mp.station.live import SCRIPTS
from robbie_mp.station.map_marks import MapMark
from robbie_mp.station.panel import Panel
from robbie_mp.station.scene_view.surroundings import other_robots

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

TEXT_PERIOD_S = 0.2
GROUP = "marks"
"""Group of live parts with the marks on the map."""
MAX_PATH_POINTS = 500
"""Maximum number of points. Longer paths are drawn with every second, third … point."""
MODES = {"": "Move map", "goal": "Set goal", "initial_pose": "Set pose"}
"""The effect of a press on the map: it sends a goal, or publishes on this topic."""
PLACE_COLOUR = "#3949ab"


class MapView(Element, component="map_view.js", esm=SCRIPTS):
    """Draws the map and the marks on it."""


class MapPanel(Panel):
    """The map of the robot, on which operators set goals."""

    name = "map"
    title = "Map"
    icon = "map"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._grid = station.newest(OccupancyGrid)
        self._pose = station.newest(PoseStamped, "map_pose")
        self._goal = station.newest(PoseStamped, "goal")
        self._path = station.newest(Path, "path")
        self._frontiers = station.newest(Frontiers)
        self._others: list[dict[str, Any]] = []
        self._way: tuple[int, bytes] = (0, b"[]")

    def build(self, page: Page) -> None:
        """Build the map and its tools."""
        with ui.row().classes("items-center"):
            mode = ui.toggle(MODES, value="").props("id=map-mode")
            mode.set_visibility(page.role is Role.OPERATOR)
            tools = {
                name: ui.button(icon=icon).props(f'id=map-{name} aria-label="{label}" title="{label}"')
                for name, icon, label in (
                    ("in", "zoom_in", "Zoom in"),
                    ("out", "zoom_out", "Zoom out"),
                    ("fit", "fit_screen", "Show the whole map"),
                    ("save", "save", "Save as picture"),
                )
            }
            cancel = ui.button("Cancel goal", icon="wrong_location").props("id=map-cancel")
            cancel.set_visibility(page.role is Role.OPERATOR)
            cancel.on_click(lambda: self._cancel(page))
        view = MapView().props("id=map-view")
        view.style("width: 100%; height: 60vh; touch-action: none; display: block")
        text = ui.label("").props("id=map-text")
        tools["in"].on_click(lambda: view.run_method("zoom", 1.5))
        tools["out"].on_click(lambda: view.run_method("zoom", 1 / 1.5))
        tools["fit"].on_click(lambda: view.run_method("fit"))
        tools["save"].on_click(lambda: view.run_method("save", f"map-{self.station.run_id}.png"))

        def set_mode(topic: str) -> None:
            view._props["placing"] = topic
            view.update()

        def placed(event: GenericEventArguments) -> None:
            if (place := checked(event.args)) is not None:
                self._publish(page, *place)
            mode.set_value("")

        if page.role is Role.OPERATOR:
            mode.on_value_change(lambda event: set_mode(str(event.value or "")))
            view.on("placed", placed)

        def update() -> None:
            text.set_text(self.describe())

        page.every(TEXT_PERIOD_S, self.name, update)

    def tick(self) -> None:
        """Update the marks, if any page shows them."""
        if self.station.live.is_wanted(GROUP):
            found = other_robots(self.station.scene, "map")
            self._others = [robot_mark(name, pose) for name, pose in found.items()]
            parts = {name: json.dumps(mark).encode() for name, mark in self.marks().items()}
            self.station.live.put(GROUP, parts | {"path": self._encoded_path()})

    def _encoded_path(self) -> bytes:
        if self._way[0] != self._path.count:
            self._way = (self._path.count, json.dumps(way_points(self._path.message)).encode())
        return self._way[1]

    def marks(self) -> dict[str, Any]:
        """Return the marks on the map, without the path; m and rad, map frame."""
        return {
            "robot": planar(self._pose.message),
            "goal": planar(self._goal.message),
            "frontiers": frontier_marks(self._frontiers.message),
            "marked": [disc_of(mark) for marks in self.station.map_marks.now().values() for mark in marks],
            "places": [place_mark(place) for place in self.station.places_watch.places],
            "others": self._others,
        }

    def describe(self) -> str:
        """Return a line that describes the map."""
        grid, path = self._grid.message, self._path.message
        info = grid.info if grid else None
        parts = [f"{info.width} x {info.height} cells of {info.resolution:.3g} m" if info else "no map yet"]
        for name, pose in (("robot", self._pose.message), ("goal", self._goal.message)):
            if (place := planar(pose)) is not None:
                x_m, y_m, yaw_rad = place
                parts.append(f"{name} at {x_m:.2f} m, {y_m:.2f} m, {math.degrees(yaw_rad):.0f}°")
        if path:
            parts.append(f"path of {len(path.poses)} points")
        if self._frontiers.message:
            parts.append(f"{len(self._frontiers.message.middles)} frontiers")
        parts += [f"{one['name']} at {one['x']:.2f} m, {one['y']:.2f} m" for one in self._others]
        parts += [f"{len(marks)} {title}" for title, marks in self.station.map_marks.now().items()]
        return "; ".join([*parts, *(place.name for place in self.station.places_watch.places)])

    def _publish(self, page: Page, topic: str, x_m: float, y_m: float, yaw_rad: float | None) -> None:
        if yaw_rad is None:  # without a heading: the direction from the robot to the goal
            robot = planar(self._pose.message) or [x_m, y_m, 0.0]
            yaw_rad = math.atan2(y_m - robot[1], x_m - robot[0])
        pose = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))
        message = PoseStamped(header=header_of_now(self.station, "map"), pose=pose)
        if topic == "goal":
            page.ask(NavigateTo(pose=message), "the goal", "the robot is at the goal")
        else:
            page.publish(message, "the pose", topic)

    def _cancel(self, page: Page) -> None:
        """End the goal that the robot drives to, whichever module or operator has set it."""
        page.ask(CancelNavigation(reason="an operator cancelled it"), "the cancel", "the robot has no goal")


def way_points(path: Path | None) -> list[list[float]]:
    """Return x and y (m) of the points of a path. Long paths are thinned."""
    poses = path.poses if path else []
    every = math.ceil(len(poses) / MAX_PATH_POINTS) or 1
    positions = [one.pose.position for one in (*poses[:-1:every], *poses[-1:])]
    return [[round(one.x, 3), round(one.y, 3)] for one in positions]


def frontier_marks(frontiers: Frontiers | None) -> list[list[float]]:
    """Return x, y and length (m) of the longest frontiers."""
    if frontiers is None:
        return []
    marks = zip(frontiers.middles, frontiers.lengths_m.tolist(), strict=False)
    return [[middle.x, middle.y, length_m] for middle, length_m in marks][: Frontiers.MAX_PIECES]


def disc_of(mark: MapMark) -> dict[str, Any]:
    """Return the drawing data of a panel's mark."""
    return {"x": mark.x, "y": mark.y, "name": mark.name, "colour": mark.colour}


def place_mark(place: PointOfInterest) -> dict[str, Any]:
    """Return the drawing data of a point of interest."""
    position = place.pose.position
    return {"x": position.x, "y": position.y, "name": place.name, "colour": PLACE_COLOUR}


def robot_mark(name: str, pose: RigidTransform) -> dict[str, Any]:
    """Return the drawing data of another robot."""
    x_m, y_m, _ = map(float, pose.translation)
    return {"name": name, "x": round(x_m, 3), "y": round(y_m, 3), "yaw": round(pose.yaw, 3)}


def planar(message: PoseStamped | None) -> list[float] | None:
    """Return x (m), y (m) and heading (rad) of a pose."""
    if message is None:
        return None
    pose = message.pose
    return [round(number, 4) for number in (pose.position.x, pose.position.y, pose.orientation.yaw)]


def checked(sent: Any) -> tuple[str, float, float, float | None] | None:
    """Return a placement on the map: topic, x, y (m), heading (rad), or None if it is malformed."""
    try:
        topic, yaw_rad = str(sent["what"]), sent["yaw_rad"]
        numbers = [float(sent["x_m"]), float(sent["y_m"]), 0.0 if yaw_rad is None else float(yaw_rad)]
    except (KeyError, TypeError, ValueError):
        return None
    if not topic or topic not in MODES or not all(map(math.isfinite, numbers)):
        return None
    return topic, numbers[0], numbers[1], None if yaw_rad is None else numbers[2]
