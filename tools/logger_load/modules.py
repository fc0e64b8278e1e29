"""The modules of the robot that is recorded."""

import numpy as np

from robbie_mp.bus import EncodedMessage
from robbie_mp.messages import DriveCommand, Image, Message, PoseStamped, TwistStamped
from robbie_mp.module import Module, setting

HEIGHT, WIDTH, CHANNELS = 1080, 1920, 3
IMAGE_HZ = 10.0
SMALL_TYPES: tuple[type[Message], ...] = (TwistStamped, PoseStamped, DriveCommand)


class Camera(Module):
    """Publishes images of 6.2 MB: smooth, with noise in the lowest three bits, as cameras see a room."""

    period_s = 1 / IMAGE_HZ

    def setup(self) -> None:
        """Draw the one image."""
        across, down = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        smooth = (across // 8 + down // 8) % 240
        noise = np.random.default_rng(1).integers(0, 8, (HEIGHT, WIDTH, CHANNELS), np.uint8)
        self.picture = (smooth[:, :, None].astype(np.uint8) + noise).reshape(-1)

    def tick(self) -> None:
        """Publish it once more."""
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
    """Publishes small messages at a steady rate."""

    rate_hz: float = setting(200.0, "messages in a second")
    number: int = setting(0, "which of the talkers it is: chooses type and topic")

    def setup(self) -> None:
        """Choose."""
        self.period_s = 1 / self.rate_hz
        self.message = SMALL_TYPES[self.number % len(SMALL_TYPES)]()

    def tick(self) -> None:
        """Publish one."""
        self.publish(self.message, topic=f"small/{self.number}")


class Listener(Module):
    """Gets what one talker says."""

    number: int = setting(0, "which of the talkers it hears")

    def setup(self) -> None:
        """Subscribe."""
        message_type = SMALL_TYPES[self.number % len(SMALL_TYPES)]
        self.subscribe(message_type, self.on_message, topic=f"small/{self.number}")

    def on_message(self, message: Message) -> None:
        """Do nothing: how long it took to come is counted anyway."""


class Taker(Module):
    """Takes every message as a logger does, and does nothing with it: what one more subscriber costs."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe_encoded("*", self.on_message)

    def on_message(self, message: EncodedMessage) -> None:
        """Look at its size."""
        self.last_bytes = len(message.data)


class PatientTaker(Taker):
    """Takes what has come, every now and then."""

    patience_s = 0.02
