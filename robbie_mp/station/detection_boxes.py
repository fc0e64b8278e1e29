"""What was found in an image, drawn over it."""

from typing import NamedTuple

from nicegui.element import Element

from robbie_mp.messages import Detection2DArray

MOST_BOXES = 100


class Box(NamedTuple):
    """A rectangle, as shares of the image's width and height, and what is in it."""

    left: float
    top: float
    width: float
    height: float
    text: str


class DetectionBoxes(Element, component="detection_boxes.js"):
    """Lies over a picture."""

    def __init__(self) -> None:
        super().__init__()
        self._props["boxes"] = []

    def show(self, boxes: list[Box]) -> None:
        """Draw these, if they are others than before."""
        plain = [[*box] for box in boxes]  # named tuples do not become JSON
        if self._props["boxes"] != plain:
            self._props["boxes"] = plain
            self.update()


def boxes_of(found: Detection2DArray, width: int, height: int) -> list[Box]:
    """Return the boxes of detections in an image of so many columns and rows."""
    boxes = []
    for one in found.detections[:MOST_BOXES]:
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
