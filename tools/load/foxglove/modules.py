"""The modules of the robot that clients look at, and stop."""

import numpy as np

from robbie_mp import Module
from robbie_mp.messages import EmergencyStop, Image

HEIGHT, WIDTH = 1000, 2000
IMAGE_HZ = 10.0
NAME = "image"
"""The name of the images for clients: they have no topic, so it is that of their type."""


class Camera(Module):
    """Publishes images of 2 MB, 20 MB in a second."""

    period_s = 1 / IMAGE_HZ

    def setup(self) -> None:
        """Make the image."""
        self.picture = np.random.default_rng(1).integers(0, 256, HEIGHT * WIDTH, np.uint8)

    def tick(self) -> None:
        """Publish the image again."""
        size = self.picture.size
        with self.loan(Image, height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH, data=size) as image:
            np.copyto(image.data, self.picture)


class Base(Module):
    """Says on `emergency_stop_state` that it has stopped, as a base does."""

    def setup(self) -> None:
        """Subscribe."""
        self.advertise(EmergencyStop, topic="emergency_stop_state")
        self.subscribe(EmergencyStop, self.on_emergency_stop, topic="emergency_stop")

    def on_emergency_stop(self, request: EmergencyStop) -> None:
        """Stop."""
        self.publish(request, topic="emergency_stop_state")
