"""One camera to drive by, as a head-up display; the other cameras are small beside it."""

from __future__ import annotations

import math
import pathlib
import time
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element

from robbie_mp.messages import ControlState, Path, PoseStamped
from robbie_mp.station.driving.motion import heading_deg
from robbie_mp.station.floor.picture import FloorPicture, track_of
from robbie_mp.station.floor.touch_to_go import COLOUR, MAX_POINTS, Proposals, TouchToGo
from robbie_mp.station.map.goals import goal_now
from robbie_mp.station.map.way import way_points
from robbie_mp.station.panel import Panel
from robbie_mp.station.panels.camera_look import CameraLook, direction_of
from robbie_mp.station.panels.cameras import REFRESH_S, DetectionBoxes, NewestImage
from robbie_mp.station.panels.light_controls import LightSwitch
from robbie_mp.station.panels.teaching import Teaching

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.driving.motion import Movement
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.watch.cameras import Cameras

REVERSES_M_PER_S = 0.02
BEHIND_RAD = 2.1
"""A camera that is turned at least so far from ahead shows where a robot goes backwards."""
LOOKS_BACK_S = 1.5
MAX_SMALL = 3
"""Maximum number of small pictures beside the large one."""
EARLY = """<script>
window.early = { groups: "video", socket: window.open_live("video") };
setTimeout(() => window.early?.socket.close(), 30_000); // another layout has no camera
</script>"""
"""Open the connection of the video while the page's scripts load."""
STYLE = pathlib.Path(__file__).parent / "camera.css"


class HeadUpDisplay(Element, component="hud.js"):
    """Draws the robot's movement over a picture."""

    def __init__(self) -> None:
        super().__init__()
        self._props["now"] = {}

    def show(self, now: dict[str, Any]) -> None:
        """Show a movement, if it has changed."""
        if self._props["now"] != now:
            self._props["now"] = now
            self.update()


class CameraPanel(Panel):
    """Shows the picture to drive by."""

    name = "camera"
    title = "Camera"
    icon = "videocam"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._station, self._robot = station, station.robot
        self._looks: dict[str, tuple[float, float]] = {}
        self._scale_m_per_s = station.settings.max_linear_m_per_s
        self._width_m = station.settings.robot_size_m[1]
        words = [*station.settings.objects, *station.settings.persons]
        self._teaching = Teaching(station.messages, station.robot.cameras, words)
        messages = station.messages
        self._pose, self._control = (
            messages.newest(PoseStamped, "map_pose"),
            messages.newest(ControlState, "control"),
        )
        self._goal, self._path = messages.newest(PoseStamped, "goal"), messages.newest(Path, "path")
        self._driven: tuple[int, list[list[float]]] = (0, [])
        self._proposals = Proposals(station.operators.pages)
        station.map.marks.add("proposed goals", self._proposals.marks)
        station.map.marks.add_cells("Proposed way", COLOUR, self._proposals.cells)

    def tick(self) -> None:
        """Look where the cameras look, and which way the robot drives."""
        if not self.is_looked_at:
            return
        if self._driven[0] != self._path.count:
            self._driven = (self._path.count, way_points(self._path.message, MAX_POINTS))
        for name, camera in self._robot.cameras.found.items():
            image = camera.latest.message
            look = direction_of(self._robot.scene.graph, image.header.frame_id) if image else None
            if look is not None:
                self._looks[name] = look
            else:
                self._looks.pop(name, None)

    def build(self, page: Page) -> None:
        """Build the large picture, the small ones, the display, and an operator's tools."""
        ui.add_css(STYLE)
        touch = None
        if page.can_command:
            touch = TouchToGo(self._station, page, self._proposals, self._pose, self._control)
            page.add_key("j", "Camera: choose a place on the floor by the arrows, and Enter")
        stage = Stage(self._robot.cameras, self._looks, self._scale_m_per_s, touch)
        if page.can_command:
            self._teaching.build(page, self.name, stage.root, lambda: stage.chosen)
            LightSwitch(page, self._robot.lights, self.name)
            with stage.root:
                CameraLook(self._station, page)
            page.add_key("v", "Camera: look ahead (Shift and arrows, or drag the picture: turn it)")
        page.add_key("c", "Next camera", stage.turn)

        def update() -> None:
            now = self._robot.motion.now
            stage.update(now, page.driver.slowed if page.driver else 1.0)
            stage.draw(track_of(now, self._width_m), self._driven[1] if goal_now(self._goal.message) else [])

        update()  # so that the picture comes with the page, and not after it
        if stage.chosen and not ui.context.client.has_socket_connection:
            ui.add_head_html(EARLY)
        page.every(REFRESH_S, self.name, update)


class Stage:
    """The pictures of one page.

    Args:
        cameras: the cameras of the robot.
        looks: where each camera looks: to the left and down, rad.
        scale_m_per_s: speed at the end of the display's scale.
        touch: what an operator does with the floor; None on the page of an observer.
    """

    def __init__(
        self,
        cameras: Cameras,
        looks: Mapping[str, tuple[float, float]],
        scale_m_per_s: float,
        touch: TouchToGo | None = None,
    ):
        self._cameras, self._looks, self._touch = cameras, looks, touch
        self._scale_m_per_s = scale_m_per_s
        self._chosen = ""
        self._before = ""
        """The camera that was large before the robot went backwards; '' if it does not."""
        self._is_by_hand = False
        self._names: list[str] = []
        self._stays = False
        """An operator has chosen a camera since the robot last went ahead or stood."""
        self._reverse_s = -math.inf
        self._large: tuple[str, DetectionBoxes, FloorPicture] | None = None
        self._small: list[str] = []
        self.root = ui.element("div").classes("camera-stage drives")
        with self.root:
            self._picture = ui.element("div").classes("camera-picture")
        self._none = ui.label("no camera has sent an image yet").classes("camera-none")
        self._display = HeadUpDisplay().props("id=camera-display")
        self._beside = ui.element("div").classes("camera-small").props("id=camera-small")

    @property
    def chosen(self) -> str:
        """Name of the camera that is shown large; '' before the first image."""
        return self._chosen

    def turn(self) -> None:
        """Show the next camera large."""
        names = sorted(self._cameras.found)
        if self._chosen in names:
            self.choose(names[(names.index(self._chosen) + 1) % len(names)])

    def choose(self, name: str) -> None:
        """Show a camera large."""
        self._chosen, self._before, self._is_by_hand, self._stays = name, "", True, True

    def update(self, movement: Movement, slowed: float = 1.0) -> None:
        """Show the newest pictures and the movement, and how much slower the page drives for old ones."""
        found = self._cameras.found
        names = sorted(found)
        is_new = names != self._names and not self._is_by_hand  # a camera that turns stays where it is
        if names and not self._before and (self._chosen not in found or is_new):
            self._chosen = next((name for name in names if not self._is_rear(name)), names[0])
        self._names = names
        self._look_back(movement)
        if self._chosen in found:
            self._show_large(self._chosen)
        self._show_small([name for name in names if name != self._chosen][:MAX_SMALL])
        self._display.show(
            display_of(movement, self._chosen, self._scale_m_per_s, slowed, self._looks.get(self._chosen))
        )

    def draw(self, track: list[float] | None, driven: list[list[float]]) -> None:
        """Draw on the floor of the large picture.

        Args:
            track: of the robot, as `track_of` returns it.
            driven: the way that the robot drives.
        """
        proposal = None if self._touch is None else self._touch.shown()
        if self._large is not None:
            self._large[2].show(track=track, driven=driven, proposal=proposal)

    def _is_rear(self, name: str) -> bool:
        return name in self._looks and abs(self._looks[name][0]) > BEHIND_RAD

    def _look_back(self, movement: Movement) -> None:
        """Show the camera that looks back large while an operator drives backwards, and a moment longer."""
        linear = movement.commanded_linear if movement.is_manual else None
        if linear is not None and linear < -REVERSES_M_PER_S:
            self._reverse_s = time.monotonic()
            rear = [name for name in sorted(self._looks) if self._is_rear(name)]
            if not self._before and not self._stays and rear and self._chosen not in rear:
                self._before, self._chosen = self._chosen, rear[0]
            return
        self._stays = False
        if self._before:
            goes_ahead = linear is not None and linear > REVERSES_M_PER_S
            if goes_ahead or time.monotonic() - self._reverse_s > LOOKS_BACK_S:
                self._before, self._chosen = "", self._before

    def _show_large(self, name: str) -> None:
        if self._large is None or self._large[0] != name:
            self._none.set_visibility(False)
            self._picture.clear()
            with self._picture:
                NewestImage(name, drives=True)
                boxes = DetectionBoxes().classes("absolute inset-0 w-full h-full pointer-events-none")
                floor = FloorPicture(name)
            if self._touch is not None:
                self._touch.listen(floor)
            self._large = (name, boxes, floor)
        boxes = self._large[1]
        boxes.show(self._cameras.boxes(name))

    def _show_small(self, names: list[str]) -> None:
        if self._small != names:
            self._beside.clear()
            self._small = names
            for name in names:
                with self._beside, ui.element("button") as button:
                    button.on("click", lambda name=name: self.choose(name))
                    button.props["title"] = button.props["aria-label"] = f"Show camera {name} large"
                    NewestImage(name)
                    ui.label(name)


def display_of(
    now: Movement,
    camera: str,
    scale_m_per_s: float,
    slowed: float = 1.0,
    look: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Return what the display shows, rounded so that it changes only if that can be seen."""

    def rounded(value: float | None, digits: int) -> float | None:
        return None if value is None else round(value, digits) + 0.0

    def degrees(value: float | None) -> int | None:
        return None if value is None else round(math.degrees(value))

    return {
        "camera": camera,
        "slowed": round(100 * slowed),
        "scale": scale_m_per_s,
        "look": None if look is None else [round(math.degrees(angle)) + 0 for angle in look],
        "linear": rounded(now.linear_m_per_s, 2),
        "angular": rounded(now.angular_rad_per_s, 1),
        "commanded": rounded(now.commanded_linear, 2),
        "commanded_turn": rounded(now.commanded_angular, 1),
        "heading": None if now.heading_rad is None else heading_deg(now.heading_rad),
        "pitch": degrees(now.pitch_rad),
        "roll": degrees(now.roll_rad),
        "ring": [rounded(one, 1) for one in now.ring_m],
        "pressed": [part.replace("_", " ") for part in now.pressed],
        "ahead": rounded(now.ahead_m, 1 if (now.ahead_m or 0.0) > 1.0 else 2),
        "silent": now.silent,
        "hint": now.hint,
    }
