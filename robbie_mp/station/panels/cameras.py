"""The newest image of each camera, as often as the link allows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from nicegui import ui
from nicegui.element import Element
from starlette.responses import Response

from robbie_mp.messages import CompressedImage, Detection2DArray, Image
from robbie_mp.module.module import MessageHandling
from robbie_mp.station.context import Page
from robbie_mp.station.latest import Latest, silence
from robbie_mp.station.panel import Panel
from robbie_mp.station.pictures import (
    NewestPicture,
    encode_image,
    no_picture,
    serve_pictures,
)

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext

REFRESH_S = 0.1
"""Minimum time between two notifications of a new image to a page."""
MAX_CAMERAS = 12
FRESH_NS = 500_000_000
"""Detections in an image are also drawn if it is older than the shown one by up to this time."""
SILENT_AFTER_S = 2.0
"""Maximum time between two images of a working camera."""
ADDRESS = "/pictures/camera/{name:path}"
MAX_BOXES = 100


class Box(NamedTuple):
    """A rectangle, as shares of the image's width and height, and a label."""

    left: float
    top: float
    width: float
    height: float
    text: str


class DetectionBoxes(Element, component="detection_boxes.js"):
    """Draws boxes over a picture."""

    def __init__(self) -> None:
        super().__init__()
        self._props["boxes"] = []

    def show(self, boxes: list[Box]) -> None:
        """Draw these boxes, if they have changed."""
        plain = [[*box] for box in boxes]  # named tuples do not become JSON
        if self._props["boxes"] != plain:
            self._props["boxes"] = plain
            self.update()


def boxes_of(found: Detection2DArray, width: int, height: int) -> list[Box]:
    """Return the boxes of detections in an image of `width` columns and `height` rows."""
    boxes = []
    for one in found.detections[:MAX_BOXES]:
        box, middle = one.bbox, one.bbox.center.position
        likely = max((result.hypothesis for result in one.results), key=lambda h: h.score, default=None)
        boxes.append(
            Box(
                (middle.x - box.size_x / 2) / width,
                (middle.y - box.size_y / 2) / height,
                box.size_x / width,
                box.size_y / height,
                one.id if likely is None else f"{likely.class_id} {likely.score:.0%}",
            )
        )
    return boxes


class NewestImage(Element, component="newest_image.js"):
    """Shows a picture, and fetches the next one when it has this one.

    Args:
        address: address of the pictures.
        description: the alternative text.
    """

    def __init__(self, address: str, description: str):
        super().__init__()
        self._props["address"] = address
        self._props["alt"] = description
        self.show(0)

    def show(self, count: int) -> None:
        """Show the newest picture, unless it is shown already.

        Args:
            count: number of the message from which it is made; 0: there is none.
        """
        if self._props.get("count") != count:
            self._props["count"] = count
            self.update()


class Camera:
    """The images of one topic."""

    def __init__(self) -> None:
        self.latest: Latest[Image | CompressedImage] = Latest()
        self.picture = NewestPicture(self.latest, encode_image)

    def boxes(self, found: Detection2DArray | None) -> list[Box]:
        """Return the boxes found in the newest image, or in one shortly before it; [] if they are too old."""
        image = self.latest.message
        if found is None or not isinstance(image, Image):
            return []
        age_ns = image.header.stamp.nanoseconds - found.header.stamp.nanoseconds
        return boxes_of(found, image.width, image.height) if abs(age_ns) <= FRESH_NS else []

    @property
    def description(self) -> str:
        """Size and encoding of the newest image."""
        image = self.latest.message
        if isinstance(image, Image):
            return f"{image.width} x {image.height} {image.encoding}, image {self.latest.count}"
        return f"{image.format if image else ''}, image {self.latest.count}"


class Cameras:
    """All cameras of the robot, for the panels that show them.

    Attributes:
        found: the cameras by the topic of their images.
        detections: the newest detections by the same topic.
    """

    def __init__(self, station: StationContext):
        self._station = station
        self.found: dict[str, Camera] = {}
        self.detections: dict[str, Detection2DArray] = {}
        newest = MessageHandling.KEEP_ONLY_NEWEST
        station.subscribe(Image, self._on_image, newest)
        station.subscribe(CompressedImage, self._on_image, newest)
        station.subscribe(Detection2DArray, self._on_detections, newest)
        serve_pictures(ADDRESS, self._answer)

    def _on_image(self, image: Image | CompressedImage) -> None:
        topic = self._station.envelope.topic or "image"
        name = topic if isinstance(image, Image) else f"{topic}/compressed"
        camera = self.found.get(name)
        if camera is None:
            if len(self.found) >= MAX_CAMERAS:
                return
            camera = Camera()
            # A new dict, because pages read the old one.
            self.found = {**self.found, name: camera}
        camera.latest.put(image)

    def _on_detections(self, found: Detection2DArray) -> None:
        topic = self._station.envelope.topic or "image"
        if topic in self.detections or len(self.detections) < MAX_CAMERAS:
            self.detections = {**self.detections, topic: found}

    def _answer(self, name: str) -> Response:
        camera = self.found.get(name)
        return camera.picture.answer() if camera else no_picture("there is no such camera")


class CamerasPanel(Panel):
    """Shows a picture for each topic with images."""

    name = "cameras"
    title = "Cameras"
    icon = "photo_camera"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self._cameras = station.cameras

    def build(self, page: Page) -> None:
        """Build a card for each camera, and add cards for new cameras."""
        hint = ui.label("no camera has sent an image yet").classes("text-grey")
        row = ui.row().classes("w-full gap-4")
        cards: dict[str, CameraCard] = {}

        def update() -> None:
            for name, camera in sorted(self._cameras.found.items()):
                if name not in cards:
                    hint.set_visibility(False)
                    with row, ui.card():
                        cards[name] = CameraCard(name)
                cards[name].show(camera, self._cameras.detections.get(name))

        page.every(REFRESH_S, self.name, update)


class CameraCard:
    """The picture of a camera, the detections in it, and the line below."""

    def __init__(self, name: str):
        ui.label(name).classes("font-bold")
        with ui.element("div").classes("relative w-full").style("min-width: 20rem; max-width: 40rem"):
            self._image = NewestImage(ADDRESS.replace("{name:path}", name), f"camera {name}")
            self._image.classes("w-full block").style("image-rendering: pixelated")
            self._boxes = DetectionBoxes().classes("absolute inset-0 w-full h-full pointer-events-none")
        self._text = ui.label("").classes("text-sm")
        self._silent = ui.label("").classes("text-orange font-bold camera-silent")

    def show(self, camera: Camera, found: Detection2DArray | None) -> None:
        """Show the newest image and the detections in it."""
        self._image.show(camera.latest.count)
        self._boxes.show(camera.boxes(found))
        self._text.set_text(camera.description)
        silent = silence(camera.latest.age_s, SILENT_AFTER_S)
        self._silent.set_text(f"silent: this image is {silent} old" if silent else "")
        self._image.classes(add="grayscale" if silent else "", remove="" if silent else "grayscale")
