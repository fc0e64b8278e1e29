"""The map from above, with robots, path, goal, frontiers, places and marks. Operators set goals on it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from robbie_mp.messages import (
    CancelNavigation,
    Costmap,
    Frontiers,
    LaserScan,
    MapAnnotations,
    MappingState,
    NoGoArea,
    OccupancyGrid,
    Path,
    PointOfInterest,
    PoseStamped,
)
from robbie_mp.messages.stock.nav2_msgs import Cost
from robbie_mp.scene import RigidTransform
from robbie_mp.station.driving.motion import heading_deg
from robbie_mp.station.live import SCRIPTS
from robbie_mp.station.map.card import MapCard
from robbie_mp.station.map.drawing import NO_GO, PLACE, MapDrawing, area_marks
from robbie_mp.station.map.goal_menu import GoalMenu
from robbie_mp.station.map.goals import (
    GOAL,
    INITIAL_POSE,
    MAX_GOALS,
    NEXT_GOAL,
    GoalList,
    Placement,
    checked,
    goal_now,
    place,
)
from robbie_mp.station.map.marks import CellMarks, MapMark
from robbie_mp.station.map.trail import Trail
from robbie_mp.station.map.way import way_points
from robbie_mp.station.page.menus import popup
from robbie_mp.station.page.page import Page
from robbie_mp.station.page.tool_button import tool_button
from robbie_mp.station.panel import Panel
from robbie_mp.station.scene_view.picture_pose import MAP, pose_for_picture
from robbie_mp.station.scene_view.point_sources import PointSources
from robbie_mp.station.scene_view.points import packed
from robbie_mp.station.scene_view.surroundings import other_robots

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.watch.latest import Latest

TEXT_PERIOD_S = 0.2
GOALS_PERIOD_S = 0.3
GROUP = "marks"
"""Group of live parts with the marks on the map."""
MAX_PATH_POINTS = 500
MODES = {"": "Move", GOAL: "Set goal", NEXT_GOAL: "Add goal", INITIAL_POSE: "Set pose"}
"""The effect of a press on the map."""
HINTS = {
    GOAL: "Set goal: press the place; drag for the heading",
    NEXT_GOAL: "Add goals: press one place after another",
    INITIAL_POSE: "Set pose: press where the robot is, and drag to where it looks",
    NO_GO: "Draw a no-go area: drag a rectangle, or press corner after corner and the first one again",
    PLACE: "Name a place: press it; drag for the heading",
}
"""What a press does now, and how."""
STAY, FOLLOW = "stay", "follow"
FOLLOWS = {STAY: "Stay", FOLLOW: "Follow", "heading": "Heading up"}
LAYERS = {
    "scan": "Laser",
    "trail": "Trail",
    "doubt": "Uncertainty",
    "path": "Path",
    "frontiers": "Frontiers",
    "no_go": "No-go areas",
    "others": "Other robots",
    "marks": "Places",
    "names": "Names",
    "legend": "Legend",
}
"""The layers that a visitor can hide."""
COSTS = (
    ("Costmap: avoided", "#ffab0040", 1, Cost.AVOIDED),
    ("Costmap: too near", "#ff3d0060", Cost.TOO_NEAR, Cost.TOO_NEAR),
    ("Costmap: obstacles", "#6a1b9a", Cost.OBSTACLE, Cost.OBSTACLE),
)
"""Layers of what navigation plans on: each with its colour, and its least and greatest cost."""
SHOWN_S = 2.0
"""Cells of a hidden layer are sent for this time after a page has said that it shows the layer."""
DOUBT_DEVIATIONS = 2.45
"""Standard deviations of an ellipse that holds 95 % of all positions."""
PLACE_COLOUR = "#3949ab"


class MapView(Element, component="map_view.js", esm=SCRIPTS):
    """Draws the map and the marks on it."""

    def set(self, **properties: object) -> None:
        """Change properties of the page's script, if they differ."""
        if any(self._props.get(name) != value for name, value in properties.items()):
            self._props.update(properties)
            self.update()


class PressMode:
    """What a press on the map of one page does. Over the map stands what, unless it moves the map.

    Args:
        page: the page. Observers can only move the map.
    """

    def __init__(self, page: Page):
        self._toggle = ui.toggle(MODES, value="").props("id=map-mode")
        self._toggle.set_visibility(page.can_command)
        self._toggle.on_value_change(lambda event: self._show(str(event.value or "")))

    def build_hint(self, view: MapView) -> None:
        """Build what says the mode over the map."""
        self._view = view
        with ui.element("div").classes("map-mode-shown").props("id=map-mode-shown role=status") as self._hint:
            self._text = ui.label("")
            ui.button("End", on_click=self.end).props("id=map-mode-end unelevated dense")
        self._hint.set_visibility(False)

    def draw(self, what: str) -> None:
        """Begin a drawing, for which the toggle has no place."""
        self._toggle.set_value(None)
        self._show(what)

    def end(self) -> None:
        """Let a press move the map again."""
        self._toggle.set_value("")
        self._show("")

    def _show(self, placing: str) -> None:
        self._view.set(placing=placing)
        self._text.set_text(HINTS.get(placing, ""))
        self._hint.set_visibility(bool(placing))


class PageMap:
    """What the card does on the map of one page.

    Args:
        view: the map.
        go: sets a goal.
    """

    def __init__(self, view: MapView, go: Callable[[Placement], None]):
        self._view, self._go = view, go

    def draft(self, drawing: NoGoArea | PointOfInterest | None) -> None:
        """Draw what has no name yet."""
        match drawing:
            case NoGoArea():
                self._view.set(draft={"corners": [[one.x, one.y] for one in drawing.corners]})
            case PointOfInterest():
                position = drawing.pose.position
                self._view.set(draft={"x": position.x, "y": position.y})
            case _:
                self._view.set(draft=None)

    def show(self, x_m: float, y_m: float) -> None:
        """Bring a place into the middle."""
        self._view.run_method("show", x_m, y_m)

    def go(self, placement: Placement) -> None:
        """Set a goal."""
        self._go(placement)


class MapPanel(Panel):
    """The map of the robot, on which operators set goals."""

    name = "map"
    title = "Map"
    icon = "map"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._run_id, self._clock = station.run.known.run_id, station.clock
        self._scene, self._live = station.robot.scene, station.live
        self._births = station.robot.births
        self._marks, self._places = station.map.marks, station.map.places
        messages = station.messages
        self._grid = messages.newest(OccupancyGrid, station.settings.map_topic)
        self._pose = messages.newest(PoseStamped, "map_pose")
        self._mapping = messages.newest(MappingState, station.settings.map_topic)
        self._goal = messages.newest(PoseStamped, "goal")
        self._path = messages.newest(Path, "path")
        self._frontiers = messages.newest(Frontiers)
        self._annotations = messages.newest(MapAnnotations)
        self._others: list[dict[str, Any]] = []
        self._way: tuple[int, bytes] = (0, b"[]")
        self._trail = Trail(messages)
        self._cells: dict[str, tuple[int, float, bytes]] = {}
        self._shown_s: dict[str, float] = {}
        costmap = messages.newest(Costmap, "costmap")
        for title, colour, least, greatest in COSTS:
            source = partial(cost_cells, costmap, least, greatest)
            self._marks.add_cells(title, colour, source, is_hidden=True)
        self._way_come: tuple[int, bytes] = (0, b"[]")
        self._scans = PointSources(messages, station.run.figures, (LaserScan,))

    def build(self, page: Page) -> None:
        """Build the map and its tools."""
        with ui.row().classes("items-center map-tools"):
            mode = PressMode(page)
            undo = tool_button("undo", "map-undo", "Undo: take back the last goal")
            cancel = tool_button("wrong_location", "map-cancel", "Cancel goal")
            cancel.set_text("Cancel goal")
            for tool in (undo, cancel):
                tool.set_visibility(page.can_command)
            drawing_tools = ui.row().classes("items-center")
            follows = ui.toggle(FOLLOWS, value=FOLLOW).props("id=map-follow")

        goals = GoalList(
            lambda goal: place(page, self._clock, goal, self._pose.message), newest=lambda: page.goal
        )
        with ui.element("div").classes("map-stage shows-age fills"):
            view = MapView().props("id=map-view")
            edges = PageMap(view, goals.start)
            view.style("width: 100%; height: 100%; touch-action: none; display: block")
            with ui.element("div").classes("map-view-tools"):
                shown = self._build_view_tools(view, follows)
            mode.build_hint(view)
            card = MapCard(page, self._annotations, edges, self._marks.area_warnings)
        view.on("dragged", lambda _event: follows.set_value(STAY))
        view.on("pressed", lambda event: card.press(event.args))
        follows.on_value_change(lambda event: view.set(follows=str(event.value)))
        text = ui.label("").props("id=map-text")
        if page.can_command:
            undo.on_click(goals.undo)
            cancel.on_click(lambda: self._cancel_all(page, goals))
            view.on("placed", lambda event: self._placed(page, goals, mode, event))
            with drawing_tools:
                page.every(TEXT_PERIOD_S, self.name, GoalMenu(goals).tick)
                self._build_drawing(page, view, mode, card)
            page.always(GOALS_PERIOD_S, goals.tick)

        def update() -> None:
            text.set_text(self.describe())
            now_s = time.monotonic()
            self._shown_s.update(dict.fromkeys(shown, now_s))
            view.set(waiting=[[goal.x_m, goal.y_m] for goal in goals.waiting])

        page.every(TEXT_PERIOD_S, self.name, update)

    def _placed(self, page: Page, goals: GoalList, mode: PressMode, event: GenericEventArguments) -> None:
        """Set the goal or the pose that an operator has pressed."""
        placement = checked(event.args)
        if placement is None:
            return
        moves = placement.kind != INITIAL_POSE
        if not (page.may_move("the goal") if moves else page.may("the place")):
            return
        if placement.kind == NEXT_GOAL:
            if not goals.add(placement):
                ui.notify(f"{MAX_GOALS} goals wait already", type="negative")
            return
        if placement.kind == GOAL:
            goals.start(placement)
        else:
            place(page, self._clock, placement, self._pose.message)
        mode.end()

    def _build_drawing(self, page: Page, view: MapView, mode: PressMode, card: MapCard) -> None:
        """Build the tools with which an operator draws on the map."""
        drawing = MapDrawing(page, self._annotations, mode.draw, card)

        async def drawn(event: GenericEventArguments, keep: Callable[[Any], Awaitable[None]]) -> None:
            mode.end()
            await keep(event.args)

        view.on("outlined", lambda event: drawn(event, drawing.outlined))
        view.on("pointed", lambda event: drawn(event, drawing.pointed))
        page.every(TEXT_PERIOD_S, self.name, drawing.tick)

    def _build_view_tools(self, view: MapView, follows: ui.toggle) -> set[str]:
        """Build what changes only how this page shows the map. Return the layers of cells that it shows."""
        shown: set[str] = set()
        for name, icon, label in (
            ("in", "zoom_in", "Zoom in"),
            ("out", "zoom_out", "Zoom out"),
            ("fit", "fit_screen", "Show all that is known"),
            ("measure", "straighten", "Measure a distance"),
            ("save", "save", "Save as picture"),
            ("layers", "layers", "Layers"),
        ):
            button = tool_button(icon, f"map-{name}", label)
            match name:
                case "in":
                    button.on_click(lambda: view.run_method("zoom", 1.5))
                case "out":
                    button.on_click(lambda: view.run_method("zoom", 1 / 1.5))
                case "fit":
                    button.on_click(lambda: follows.set_value(STAY))
                    button.on_click(lambda: view.run_method("fit"))
                case "measure":
                    button.on_click(lambda: view.run_method("measure"))
                case "save":
                    button.on_click(lambda: view.run_method("save", f"map-{self._run_id}.png"))
                case _:
                    with button, popup("Layers"):
                        self._build_layers(view, shown)
        return shown

    def _build_layers(self, view: MapView, shown: set[str]) -> None:
        """Build the list of layers; keep `shown` as the page shows them."""
        layers = self._marks.layers
        of_panels = {layer.title: layer.title for layer in layers}
        names = {**LAYERS, **of_panels}
        shown.update(names.keys() - {layer.title for layer in layers if layer.is_hidden})
        view.set(hidden=sorted(names.keys() - shown))

        def show(name: str, *, is_shown: bool) -> None:
            (shown.add if is_shown else shown.discard)(name)
            view.set(hidden=sorted(names.keys() - shown))

        for name, title in names.items():
            box = (
                ui.checkbox(title, value=name in shown)
                .props(f"id=map-layer-{name.replace(' ', '-')}")
                .classes("q-pr-md")
            )
            box.on_value_change(lambda event, name=name: show(name, is_shown=bool(event.value)))

    def tick(self) -> None:
        """Update the marks, if any page shows them."""
        if self._live.is_wanted(GROUP):
            found = other_robots(self._scene, MAP)
            self._others = [robot_mark(name, pose) for name, pose in found.items()]
            parts = {name: json.dumps(mark).encode() for name, mark in self.marks().items()}
            parts |= self._encoded_cells()
            parts |= {"path": self._encoded_path(), "trail": self._encoded_trail()}
            parts["born"] = json.dumps(self._births.of(self._pose)).encode()
            self._live.put(GROUP, parts | self._scans.look(self._pose_at, MAP))

    def _pose_at(self, frame: str, time_ns: int) -> RigidTransform | None:
        return pose_for_picture(self._scene, MAP, frame, time_ns)

    def _encoded_cells(self) -> dict[str, bytes]:
        """Return the cells of each layer, packed as points are."""
        for layer in self._marks.layers:
            if layer.is_hidden and time.monotonic() - self._shown_s.get(layer.title, -math.inf) > SHOWN_S:
                self._cells.pop(layer.title, None)
                continue
            marked = layer.source()
            if layer.title not in self._cells or self._cells[layer.title][0] != marked.revision:
                self._cells[layer.title] = (marked.revision, marked.edge_m, packed(marked.thinned()))
        return {f"cells/{title}": data for title, (_, _, data) in self._cells.items()}

    def _encoded_path(self) -> bytes:
        if self._way[0] != self._path.count:
            points = way_points(self._path.message, MAX_PATH_POINTS)
            self._way = (self._path.count, json.dumps(points).encode())
        return self._way[1]

    def _encoded_trail(self) -> bytes:
        if self._way_come[0] != self._trail.count:
            points = [[round(x_m, 2), round(y_m, 2)] for x_m, y_m in self._trail.points]
            self._way_come = (self._trail.count, json.dumps(points).encode())
        return self._way_come[1]

    def marks(self) -> dict[str, Any]:
        """Return the marks on the map, without the path; m and rad, map frame."""
        return {
            "cell_colours": {layer.title: layer.colour for layer in self._marks.layers},
            "cell_edges": {title: edge_m for title, (_, edge_m, _) in self._cells.items()},
            "robot": planar(self._pose.message),
            "doubt": doubt_mark(self._mapping.message),
            "goal": planar(goal_now(self._goal.message)),
            "frontiers": frontier_marks(self._frontiers.message),
            "marked": [disc_of(mark) for marks in self._marks.now().values() for mark in marks],
            "places": [
                *(place_mark(one) for one in self._places.places),
                *(place_mark(one, PLACE) for one in self._named()),
            ],
            "no_go": area_marks(self._annotations.message),
            "others": self._others,
        }

    def _named(self) -> list[PointOfInterest]:
        """Return the places that operators have drawn."""
        return self._annotations.message.places if self._annotations.message else []

    def describe(self) -> str:
        """Return a line that describes the map."""
        grid, path = self._grid.message, self._path.message
        info = grid.info if grid else None
        parts = [f"{info.width} x {info.height} cells of {info.resolution:.3g} m" if info else "no map yet"]
        for name, pose in (("robot", self._pose.message), ("goal", goal_now(self._goal.message))):
            if (place := planar(pose)) is not None:
                x_m, y_m, yaw_rad = place
                parts.append(f"{name} at {x_m:.2f} m, {y_m:.2f} m, {heading_deg(yaw_rad)}°")
        parts += doubts(self._mapping.message)
        if path:
            parts.append(f"path of {len(path.poses)} points")
        if self._frontiers.message:
            parts.append(f"{len(self._frontiers.message.middles)} frontiers")
        parts += [f"{one['name']} at {one['x']:.2f} m, {one['y']:.2f} m" for one in self._others]
        parts += [f"{len(marks)} {title}" for title, marks in self._marks.now().items() if marks]
        if self._annotations.message and self._annotations.message.no_go:
            parts.append(f"{len(self._annotations.message.no_go)} no-go areas")
        names = [place.name for place in (*self._places.places, *self._named())]
        return "; ".join([*parts, *names])

    def _cancel_all(self, page: Page, goals: GoalList) -> None:
        """End the goal that the robot drives to, whichever module or operator has set it."""
        goals.clear()
        page.ask(CancelNavigation(reason="an operator cancelled it"), "the cancel", "the robot has no goal")


def cost_cells(newest: Latest[Costmap], least: int, greatest: int) -> CellMarks:
    """Return the cells of the newest costmap whose cost lies between two values."""
    costmap = newest.message
    if costmap is None:
        return CellMarks(newest.count, np.zeros((0, 2)))
    info = costmap.metadata
    if info.size_x * info.size_y != len(costmap.data):
        return CellMarks(newest.count, np.zeros((0, 2)))
    rows, columns = np.divmod(
        np.flatnonzero((costmap.data >= least) & (costmap.data <= greatest)), max(1, info.size_x)
    )
    corner, yaw = info.origin.position, info.origin.orientation.yaw
    along, up = (columns + 0.5) * info.resolution, (rows + 0.5) * info.resolution
    x_m = corner.x + math.cos(yaw) * along - math.sin(yaw) * up
    y_m = corner.y + math.sin(yaw) * along + math.cos(yaw) * up
    return CellMarks(newest.count, np.column_stack([x_m, y_m]), info.resolution)


def frontier_marks(frontiers: Frontiers | None) -> list[list[float]]:
    """Return x, y and length (m) of the longest frontiers."""
    if frontiers is None:
        return []
    marks = zip(frontiers.middles, frontiers.lengths_m.tolist(), strict=False)
    return [[middle.x, middle.y, length_m] for middle, length_m in marks][: Frontiers.MAX_PIECES]


def doubt_mark(state: MappingState | None) -> list[float] | None:
    """Return the ellipse in which the robot is with 95 %: half axes (m), direction of the first (rad)."""
    if state is None:
        return None
    values, vectors = np.linalg.eigh(state.covariance.reshape(3, 3)[:2, :2])
    half_axes = DOUBT_DEVIATIONS * np.sqrt(np.maximum(values[::-1], 0.0))
    direction = math.atan2(vectors[1, 1], vectors[0, 1])
    return [round(number, 3) for number in (*half_axes.tolist(), direction)]


def doubts(state: MappingState | None) -> list[str]:
    """Return in words how well the robot knows where it is, and what of the map is in doubt."""
    if state is None:
        return []
    degrees = math.degrees(state.spread_rad)
    texts = [f"position ± {state.spread_m:.2f} m, heading ± {degrees:.1f}°"]
    if not state.certain:
        texts.append("LOST: what the laser sees does not fit the map")
    if state.gaps_open:
        gaps = "1 gap is open" if state.gaps_open == 1 else f"{state.gaps_open} gaps are open"
        texts.append(f"{gaps}: only odometry joins {state.share_beyond_gaps:.0%} of the map to its beginning")
    return texts


def disc_of(mark: MapMark) -> dict[str, Any]:
    """Return the drawing data of a panel's mark."""
    return {"x": mark.x, "y": mark.y, "name": mark.name, "colour": mark.colour, "shape": mark.shape}


def place_mark(place: PointOfInterest, kind: str = "mark") -> dict[str, Any]:
    """Return the drawing data of a point of interest."""
    position = place.pose.position
    return {"x": position.x, "y": position.y, "name": place.name, "colour": PLACE_COLOUR, "kind": kind}


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
