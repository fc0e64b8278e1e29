"""The newest images of the robot's cameras, and what was detected in them."""

import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple, Protocol

from robbie_mp.attached.views.image_pixels import DEPTHS
from robbie_mp.bus.observe import ChannelFigures
from robbie_mp.messages import CompressedImage, Detection2DArray, Image, Message
from robbie_mp.module.envelope import MessageType
from robbie_mp.module.module import MessageHandling
from robbie_mp.station.fleet.topics import is_preview
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.latest import Latest, MessageSource
from robbie_mp.station.watch.pictures import NewestPicture

MAX_CAMERAS = 12
MAX_PREVIEWS = 32
"""Maximum number of other robots whose pictures are shown."""
FRESH_NS = 500_000_000
"""Detections in an image are also drawn if it is older than the shown one by up to this time."""
MAX_BOXES = 100
HasTurned = Callable[[str, int, int], bool]
"""Returns whether a frame has turned between two times, ns."""
Picture = Image | CompressedImage
MAX_SENDERS = 16
"""Maximum number of modules that send detections in the images of one topic."""


class SeesFloor(Protocol):
    """Finds the floor in pictures."""

    def see(self, name: str, image: Picture) -> None:
        """Look at a new picture of a camera, in the module's thread."""

    def about(self, name: str, image: Picture) -> Mapping[str, object]:
        """Return what a page needs to draw on the floor of a picture. Any thread may call this."""


class ImageBox(NamedTuple):
    """A rectangle, as shares of the image's width and height, and a label."""

    left: float
    top: float
    width: float
    height: float
    text: str


def boxes_of(found: Detection2DArray, width: int, height: int) -> list[ImageBox]:
    """Return the boxes of detections in an image of `width` x `height` pixels; none if it is empty."""
    boxes: list[ImageBox] = []
    if not width or not height:
        return boxes
    for one in found.detections[:MAX_BOXES]:
        box, middle = one.bbox, one.bbox.center.position
        likely = max((result.hypothesis for result in one.results), key=lambda h: h.score, default=None)
        boxes.append(
            ImageBox(
                (middle.x - box.size_x / 2) / width,
                (middle.y - box.size_y / 2) / height,
                box.size_x / width,
                box.size_y / height,
                one.id if likely is None else f"{likely.class_id} {likely.score:.0%}",
            )
        )
    return boxes


class CameraTopic:
    """The images of one topic."""

    def __init__(
        self, births: Births | None = None, about: Callable[[Picture], Mapping[str, object]] | None = None
    ) -> None:
        self.latest: Latest[Image | CompressedImage] = Latest(births.now_s if births else time.monotonic)
        self.picture = NewestPicture(self.latest, births, about)

    def boxes(
        self, found: Iterable[Detection2DArray], has_turned: HasTurned = lambda _frame, _before, _now: False
    ) -> list[ImageBox]:
        """Return the boxes found in the newest image or shortly before it.

        Older ones are left out, and those from before the camera has turned, which would lie beside what
        they are about.

        Args:
            found: the newest detections of each module.
            has_turned: returns whether a frame has turned between two times, ns.
        """
        image = self.latest.message
        if not isinstance(image, Image):
            return []
        now_ns = image.header.stamp.nanoseconds
        fresh = [one for one in found if abs(now_ns - one.header.stamp.nanoseconds) <= FRESH_NS]
        frame = image.header.frame_id
        fresh = [one for one in fresh if not has_turned(frame, one.header.stamp.nanoseconds, now_ns)]
        boxes = [box for one in fresh for box in boxes_of(one, image.width, image.height)]
        return boxes[:MAX_BOXES]

    @property
    def description(self) -> str:
        """Size and encoding of the newest image."""
        image = self.latest.message
        if isinstance(image, Image):
            about = " (depth: near is bright)" if image.encoding in DEPTHS else ""
            return f"{image.width} x {image.height} {image.encoding}{about}, image {self.latest.count}"
        return f"{image.format if image else ''}, image {self.latest.count}"


class Cameras:
    """All cameras of the robot, for the panels that show them.

    Attributes:
        found: the cameras by the topic of their images.
        detections: the newest detections by the same topic, and by the module that sent them.
    """

    def __init__(
        self,
        station: MessageSource,
        births: Births | None = None,
        has_turned: HasTurned = lambda _frame, _before, _now: False,
        floor: SeesFloor | None = None,
    ):
        self._floor = floor
        self._station = station
        self._has_turned = has_turned
        self._births = births
        self.found: dict[str, CameraTopic] = {}
        self.previews: dict[str, CameraTopic] = {}
        """Small pictures of other robots, in the same way."""
        self.detections: dict[str, dict[str, Detection2DArray]] = {}
        self._by_topic: set[tuple[str, str]] = set()
        """The types and topics that have a subscription of their own."""
        newest = MessageHandling.KEEP_ONLY_NEWEST
        station.subscribe(Image, self._on_any_image, newest)
        station.subscribe(CompressedImage, self._on_any_image, newest)
        station.subscribe(Detection2DArray, self._on_any_detections, newest)

    def tick(self, channels: Iterable[ChannelFigures]) -> None:
        """Subscribe to each topic by itself; called in the module's thread with the channels of the run.

        A subscription to all topics keeps only one message. So of a module that sends the pictures of two
        cameras at once, it would lose one each time.
        """
        for channel in channels:
            key = (channel.type_name, channel.topic)
            of_type = sum(one[0] == channel.type_name for one in self._by_topic)
            if channel.topic and key not in self._by_topic and of_type < MAX_CAMERAS + MAX_PREVIEWS:
                if channel.type_name == Detection2DArray.type_name:
                    self._subscribe(Detection2DArray, self._on_detections, channel.topic)
                elif channel.type_name == Image.type_name:
                    self._subscribe(Image, self._on_image, channel.topic)
                elif channel.type_name == CompressedImage.type_name:
                    self._subscribe(CompressedImage, self._on_image, channel.topic)

    def _subscribe(
        self, message_type: type[MessageType], handler: Callable[[MessageType], None], topic: str
    ) -> None:
        self._by_topic.add((message_type.type_name, topic))
        self._station.newest(message_type, topic).listen(handler)  # a panel may have the same subscription

    def _has_own(self, message_type: type[Message]) -> bool:
        return (message_type.type_name, self._station.envelope.topic) in self._by_topic

    def _on_any_image(self, image: Image | CompressedImage) -> None:
        if not self._has_own(type(image)):
            self._on_image(image)

    def _on_any_detections(self, found: Detection2DArray) -> None:
        if not self._has_own(Detection2DArray):
            self._on_detections(found)

    def _on_image(self, image: Image | CompressedImage) -> None:
        topic = self._station.envelope.topic or "image"
        if is_preview(topic):
            self._on_preview(topic, image)
            return
        name = topic if isinstance(image, Image) else f"{topic}/compressed"
        camera = self.found.get(name)
        if camera is None:
            if len(self.found) >= MAX_CAMERAS:
                return
            about = None if self._floor is None else partial(self._floor.about, name)
            camera = CameraTopic(self._births, about)
            # A new dict, because pages read the old one.
            self.found = {**self.found, name: camera}
        if self._floor is not None:
            self._floor.see(name, image)
        camera.latest.put(image)

    def _on_preview(self, topic: str, image: Image | CompressedImage) -> None:
        """Keep the picture of another robot; its own is for the others."""
        robot = topic.rpartition("/")[0]
        if robot and topic not in self.previews and len(self.previews) < MAX_PREVIEWS:
            births = None if self._births is None else self._births.by_arrival()
            self.previews = {**self.previews, topic: CameraTopic(births)}
        if topic in self.previews:
            self.previews[topic].latest.put(image)

    def _on_detections(self, found: Detection2DArray) -> None:
        topic = self._station.envelope.topic or "image"
        of_topic = self.detections.get(topic, {})
        sender = self._station.envelope.sender
        has_room = topic in self.detections or len(self.detections) < MAX_CAMERAS
        if has_room and (sender in of_topic or len(of_topic) < MAX_SENDERS):
            # New dicts, because pages read the old ones.
            self.detections = {**self.detections, topic: {**of_topic, sender: found}}

    def boxes(self, name: str) -> list[ImageBox]:
        """Return what all modules together have found in the newest image of a camera."""
        return self.found[name].boxes(self.detections.get(name, {}).values(), self._has_turned)

    def pictures(self) -> dict[str, NewestPicture]:
        """Return the newest picture of each camera, for pages that show it."""
        return {name: camera.picture for name, camera in (self.found | self.previews).items()}
