"""Detections in images (ROS vision_msgs, https://github.com/ros-perception/vision_msgs, branch ros2)."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond, outside
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import float64
from robbie_mp.messages.stock.geometry_msgs import PoseWithCovariance
from robbie_mp.messages.stock.std_msgs import Header


class Point2D(Message, name="vision_msgs/msg/Point2D", version=1):
    """A point of an image: pixels to the right of its left edge and below its upper one."""

    x: float64 = DEFAULT
    y: float64 = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return a coordinate that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "x", "y")


class Pose2D(Message, name="vision_msgs/msg/Pose2D", version=1):
    """A position and an orientation in an image."""

    position: Point2D = DEFAULT
    theta: float64 = DEFAULT  # rad

    def flaw(self) -> Flaw | None:
        """Return a rotation that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "theta")


class BoundingBox2D(Message, name="vision_msgs/msg/BoundingBox2D", version=1):
    """A rectangle around something in an image, in pixels."""

    center: Pose2D = DEFAULT
    size_x: float64 = DEFAULT
    size_y: float64 = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return a size that is negative or not finite."""
        return outside(self, 0.0, MAX_MAGNITUDE, "size_x", "size_y")


class ObjectHypothesis(Message, name="vision_msgs/msg/ObjectHypothesis", version=1):
    """A possible class of an object, with its score."""

    class_id: str = DEFAULT
    score: float64 = DEFAULT  # 0 … 1

    def flaw(self) -> Flaw | None:
        """Return a score that is not finite: detectors have scales of their own."""
        return beyond(self, MAX_MAGNITUDE, "score")


class ObjectHypothesisWithPose(Message, name="vision_msgs/msg/ObjectHypothesisWithPose", version=1):
    """A possible class of an object, and its pose in this case."""

    hypothesis: ObjectHypothesis = DEFAULT
    pose: PoseWithCovariance = DEFAULT


class Detection2D(Message, name="vision_msgs/msg/Detection2D", version=1):
    """An object found in an image."""

    header: Header = DEFAULT  # that of the image
    results: list[ObjectHypothesisWithPose] = DEFAULT  # what it may be
    bbox: BoundingBox2D = DEFAULT
    id: str = DEFAULT  # the same for the same thing in other images; '' if that is not known


class Detection2DArray(Message, name="vision_msgs/msg/Detection2DArray", version=1):
    """All objects found in an image. Robbie's modules publish it on the topic of the image."""

    header: Header = DEFAULT  # that of the image
    detections: list[Detection2D] = DEFAULT
