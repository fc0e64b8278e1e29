"""The modules of the recorded robot, and loggers that do only a part of a logger's work."""

import os
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp import EncodedMessage, Message, Module, setting
from robbie_mp.logs.message_logger import MessageLogger
from robbie_mp.logs.recording.chunk import Chunk, Compression, compress
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import LogWriter
from robbie_mp.logs.recording.part_writer import RecordedChannel
from robbie_mp.logs.recording.recorder import LOGGER_NICE
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


class Camera(Module):
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


class PatientTaker(Taker):
    """Takes messages only every 20 ms, as the logger does."""

    patience_s = 0.02


class DiscardingLogger(MessageLogger):
    """Copies every message into chunks, as the logger does, and discards the chunks."""

    def make_writer(self, recording: Path, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        """Return a writer that does nothing."""
        return _make(DiscardingWriter, self, recording, dropped)


class NullLogger(MessageLogger):
    """Works like the logger, but writes to /dev/null, without file system and disk."""

    def make_writer(self, recording: Path, dropped: Callable[[], Mapping[ChannelKey, int]]) -> LogWriter:
        """Return a writer to /dev/null."""
        return _make(NullWriter, self, recording, dropped)


class DiscardingWriter(LogWriter):
    """Drops every chunk."""

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Count it."""
        self._channels = channels
        self.bytes += len(chunk.data)


class NullWriter(DiscardingWriter):
    """Compresses every chunk as the logger does, and writes it to /dev/null."""

    def write(self, chunk: Chunk, channels: Mapping[int, RecordedChannel]) -> None:
        """Take the checksum, compress, write."""
        super().write(chunk, channels)
        zlib.crc32(chunk.data)
        fd = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
        try:
            for piece in compress([chunk.data], self._compression):
                os.write(fd, piece)
        finally:
            os.close(fd)


def _make(
    writer: type[LogWriter],
    logger: MessageLogger,
    recording: Path,
    dropped: Callable[[], Mapping[ChannelKey, int]],
) -> LogWriter:
    real = MessageLogger.make_writer(logger, recording, dropped)
    return writer(recording, real._compression, real._run, real._split, real._budget, dropped)


class Bystander(Module):
    """Takes no messages, but compresses as much data as this robot's logger, with the same priority."""

    period_s = 1 / IMAGE_HZ
    nice = LOGGER_NICE

    def setup(self) -> None:
        """Draw what is compressed."""
        self.picture = draw_picture()

    def tick(self) -> None:
        """Copy, take the checksum, compress."""
        data = bytearray(self.picture)
        zlib.crc32(data)
        compress([data], Compression.ZSTD)
