"""Copied into the workspace of tests: a module with three cameras, whose pictures it sends at once."""

import numpy as np

from robbie_mp import Module
from robbie_mp.messages import BoundingBox2D, Detection2D, Detection2DArray, Image, Point2D, Pose2D


class ThreeEyes(Module):
    """Sends a picture of each camera in each tick, and what was found in it."""

    period_s = 0.1

    def tick(self) -> None:
        for topic in ("left", "middle", "right"):
            data = np.zeros(64 * 64, np.uint8)
            self.publish(Image(height=64, width=64, encoding="mono8", step=64, data=data), topic=topic)
        for topic in ("left", "middle", "right"):
            box = BoundingBox2D(center=Pose2D(position=Point2D(x=32.0, y=32.0)), size_x=9.0, size_y=9.0)
            self.publish(Detection2DArray(detections=[Detection2D(id=topic, bbox=box)]), topic=topic)
