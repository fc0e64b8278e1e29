"""The modules of the recorded robot."""

import numpy as np
from numpy.typing import NDArray

from robbie_mp import EncodedMessage, Message, Module, setting
from robbie_mp.messages import DriveCommand, Image, PoseStamped, TwistStamped

HEIGHT, WIDTH, CHANNELS = 1080, 1920, 3
IMAGE_HZ = 10.0
SMALL_TYPES: tuple[type[Message], ...] = (TwistStamped, PoseStamped, DriveCommand)


def draw_picture() -> NDArray[np.uint8]:
    """Return an image of 6.2 MB: smooth, with noise in the lowest three bits, like that of a real camera."""
    across, down = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    smooth = (across // 8 + down // 8) % 240
    noise = np.random.default_rng(1).integers(0, 8, (HEIGHT, WIDTH, CHANNELS), np.uint8)
    picture: NDArray[np.uint8] = smooth[:, :, None].astype(np.uint8) + noise
    return picture.reshape(-1)


class ImageSource(Module):
    """Publishes images."""

    period_s = 1 / IMAGE_HZ

    def setup(self) -> None:
        """Make the image."""
        self.picture = draw_picture()

    def tick(self) -> None:
        """Publish the image again."""
        size = self.picture.size
        with self.loan(
            Image, height=HEIGHT, width=WIDTH, encoding="rgb8", step=WIDTH * CHANNELS, data=size
        ) as image:
            np.copyto(image.data, self.picture)


class Viewer(Module):
    """Looks at each image."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(Image, self.on_image)

    def on_image(self, image: Image) -> None:
        """Read a few pixels."""
        self.status = str(int(image.data[:: WIDTH * CHANNELS].sum()))


class Talker(Module):
    """Publishes small messages at a constant rate."""

    rate_hz: float = setting(200.0, "messages in a second")
    number: int = setting(0, "index of this talker, which determines type and topic")

    def setup(self) -> None:
        """Choose type and topic."""
        self.period_s = 1 / self.rate_hz
        self.message = SMALL_TYPES[self.number % len(SMALL_TYPES)]()

    def tick(self) -> None:
        """Publish one message."""
        self.publish(self.message, topic=f"small/{self.number}")


class Listener(Module):
    """Receives the messages of one talker."""

    number: int = setting(0, "index of the talker to subscribe to")

    def setup(self) -> None:
        """Subscribe."""
        message_type = SMALL_TYPES[self.number % len(SMALL_TYPES)]
        self.subscribe(message_type, self.on_message, topic=f"small/{self.number}")

    def on_message(self, message: Message) -> None:
        """Do nothing: the framework measures the latency anyway."""


class Taker(Module):
    """Takes every message as a logger does, and does nothing with it. It shows the cost of a subscriber."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe_encoded("*", self.on_message)

    def on_message(self, message: EncodedMessage) -> None:
        """Read the size of the message."""
        self.last_bytes = len(message.data)
