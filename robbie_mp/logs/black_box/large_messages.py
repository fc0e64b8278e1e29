"""Thins out large messages, so that a camera does not fill the black box with the last second alone."""

import time
from collections.abc import Callable

import numpy as np

from robbie_mp.attached.views.image_pixels import JPEG_ENCODINGS, NoPicture, jpeg
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.messages import CompressedImage, DecodeError, Image

JPEG_SHARE = 0.01
"""Share of a processor that JPEG may take, for each camera."""
JPEG_PIXELS = 1280
"""Larger images are scaled down to this length of their longer side."""
RAW_SHARE = 0.25
"""Share of the ring that other large messages may fill, all together."""


class LargeMessages:
    """Decides which large messages are kept, and makes JPEG of images where Pillow is installed.

    Args:
        every_s: least time between two that are kept of a channel.
        bytes_per_s: how much may be kept unchanged, of all channels together.
        quality: of JPEG, 1 to 95; 0: images stay as they are.
        clock: monotonic time in s.
    """

    def __init__(
        self, every_s: float, bytes_per_s: float, quality: int, clock: Callable[[], float] = time.monotonic
    ):
        self._every_s = every_s
        self._bytes_per_s = bytes_per_s
        self._quality = quality
        self._clock = clock
        self._next_s: dict[ChannelKey, float] = {}
        self._raw_s = 0.0
        """When the next message may be kept unchanged."""
        # Loading Pillow takes longer than a queue lasts.
        _as_jpeg(Image(height=1, width=1, encoding="mono8", step=1, data=np.zeros(1, np.uint8)).encode(), 50)

    def take(self, key: ChannelKey, data: memoryview) -> tuple[ChannelKey, bytes | memoryview] | None:
        """Return what is kept instead of a large message: itself, or a JPEG image; None if it is left out."""
        now_s = self._clock()
        if now_s < self._next_s.get(key, 0.0):
            return None
        self._next_s[key] = now_s + self._every_s
        if key.type_name == Image.type_name and self._quality:
            began_s = time.thread_time()
            if (image := _as_jpeg(data, self._quality)) is not None:
                took_s = time.thread_time() - began_s
                self._next_s[key] = now_s + max(self._every_s, took_s / JPEG_SHARE)
                return key._replace(type_name=CompressedImage.type_name, version=1), image
        if now_s < self._raw_s:
            return None
        self._raw_s = now_s + len(data) / self._bytes_per_s
        return key, data


def _as_jpeg(data: bytes | memoryview, quality: int) -> bytes | None:
    try:
        image = Image.decode(data)
        if image.encoding not in JPEG_ENCODINGS:
            return None
        picture = np.frombuffer(jpeg(image, quality, JPEG_PIXELS), np.uint8)
    except (ImportError, NoPicture, DecodeError):
        return None
    return CompressedImage(header=image.header, format="jpeg", data=picture).encode()
