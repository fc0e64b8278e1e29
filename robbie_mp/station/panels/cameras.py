"""The newest image of each camera, as often as the link allows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

from robbie_mp.station.live import SCRIPTS
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel
from robbie_mp.station.watch.cameras import CameraTopic, ImageBox

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

REFRESH_S = 0.1
"""Time between two updates of what is drawn over a picture."""
STYLE = Path(__file__).parent / "newest_image.css"


class DetectionBoxes(Element, component="detection_boxes.js"):
    """Draws boxes over a picture."""

    def __init__(self) -> None:
        super().__init__()
        self._props["boxes"] = []

    def show(self, boxes: list[ImageBox]) -> None:
        """Draw these boxes, if they have changed."""
        plain = [[*box] for box in boxes]  # named tuples do not become JSON
        if self._props["boxes"] != plain:
            self._props["boxes"] = plain
            self.update()


class NewestImage(Element, component="newest_image.js", esm=SCRIPTS):
    """Shows the pictures of a camera as they come.

    Args:
        camera: its name.
        drives: whether operators drive by it: the older it is, the slower.
    """

    def __init__(self, camera: str, *, drives: bool = False):
        super().__init__()
        ui.add_css(STYLE)
        self._props["camera"] = camera
        self._props["drives"] = drives
        self._props["alt"] = f"camera {camera}"


class CamerasPanel(Panel):
    """Shows a picture for each topic with images."""

    name = "cameras"
    title = "Cameras"
    icon = "photo_camera"
    is_built_when_shown = True

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._cameras = station.robot.cameras

    def build(self, page: Page) -> None:
        """Build a card for each camera, and add cards for new cameras."""
        hint = ui.label("no camera has sent an image yet").classes("text-grey")
        row = ui.element("div").classes("all-cameras")
        cards: dict[str, CameraCard] = {}

        def update() -> None:
            for name, camera in sorted(self._cameras.found.items()):
                if name not in cards:
                    hint.set_visibility(False)
                    with row:
                        cards[name] = CameraCard(name)
                cards[name].show(camera, self._cameras.boxes(name))

        page.every(REFRESH_S, self.name, update)


class CameraCard:
    """The picture of a camera, the detections in it, and the line below."""

    def __init__(self, name: str):
        with ui.element("figure").classes("camera-card"):
            with ui.element("div").classes("camera-card-picture"):
                NewestImage(name)
                self._boxes = DetectionBoxes().classes("absolute inset-0 w-full h-full pointer-events-none")
            with ui.element("figcaption"):
                ui.label(name).classes("font-bold")
                self._text = ui.label("").classes("text-grey")

    def show(self, camera: CameraTopic, boxes: list[ImageBox]) -> None:
        """Show the detections in the newest image, and what it is."""
        self._boxes.show(boxes)
        self._text.set_text(camera.description)
