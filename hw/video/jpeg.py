"""Cameras that send JPEG, whose images are passed on without decoding them, by PyAV (FFmpeg)."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.framing import DamagedFrame
from robbie_robots.hw.video.huffman import with_huffman_tables
from robbie_robots.hw.video.jpeg_check import whole_jpeg
from robbie_robots.hw.video.source import (
    CameraFault,
    CameraLibraryMissing,
    VideoFormat,
    VideoSource,
    is_address,
)

# A camera on the network that is silent for this time, when it is opened and later, is given up.
NETWORK_S = 5.0


@dataclass(frozen=True)
class JpegFrame:
    """One image.

    Attributes:
        stamp_s: when it was taken.
        width: columns.
        height: rows.
        data: (N,) the JPEG file.
    """

    stamp_s: float
    width: int
    height: int
    data: NDArray[np.uint8]


class JpegCamera(VideoSource[JpegFrame]):
    """A camera that compresses its images itself. Images that are cut, or of another size, are dropped.

    Args:
        source: see `VideoSource`.
        wanted: likewise.
        clock: the time for stamps, s.
        silence_s: see `BackgroundDevice`.

    Raises:
        CameraLibraryMissing: PyAV is not installed.

    Example:
        with closing(JpegCamera("/dev/v4l/by-id/usb-046d_C920-video-index0")) as camera:
            for frame in camera.poll(1.0):
                Path("image.jpeg").write_bytes(frame.data)
    """

    def __init__(
        self,
        source: str,
        wanted: VideoFormat | None = None,
        *,
        clock: Callable[[], float] = time.time,
        silence_s: float = 2.0,
    ) -> None:
        super().__init__(source, wanted, clock=clock, silence_s=silence_s)
        self._av = pyav()
        self._container: Any = None
        self._packets: Iterator[Any] = iter(())
        self._size = (0, 0)

    def _open_library(self) -> float:
        try:
            self._container = self._av.open(self.name, **self._arguments())
        except self._av.FFmpegError as error:
            raise CameraFault(f"FFmpeg cannot open {self.name} for JPEG: {error.strerror}") from error
        if not self._container.streams.video:
            raise CameraFault(f"{self.name} has no images")
        stream = self._container.streams.video[0]
        coding = stream.codec_context.name
        if coding != "mjpeg":
            raise CameraFault(f"{self.name} gives {coding}, not JPEG: read it through OpenCV")
        self._size = stream.codec_context.width, stream.codec_context.height
        self._check_format(*self._size)
        self._packets = self._container.demux(stream)
        return float(stream.average_rate or 0)

    def _arguments(self) -> dict[str, Any]:
        """Return how FFmpeg opens the source."""
        if is_address(self.name):
            return {"timeout": NETWORK_S}
        if self._is_file:
            return {}
        size, rate_hz = f"{self.wanted.width}x{self.wanted.height}", f"{self.wanted.rate_hz:g}"
        options = {"input_format": "mjpeg", "video_size": size, "framerate": rate_hz}
        return {"format": "v4l2", "options": options}

    def _read(self) -> JpegFrame | None:
        try:
            packet = next(self._packets, None)
        except self._av.FFmpegError as error:
            raise CameraFault(f"{self.name} broke: {error.strerror}") from error
        if packet is None or not packet.size:
            self._ended()
            return None
        pts_s = float(packet.pts * packet.time_base) if packet.pts is not None else 0.0
        stamp_s = self._stamp_s(pts_s)
        try:
            image = whole_jpeg(bytes(packet), *self._size)
        except DamagedFrame:
            self.counters.damaged += 1
            return None
        return JpegFrame(stamp_s, *self._size, np.frombuffer(with_huffman_tables(image), np.uint8))

    def _close(self) -> None:
        self._packets = iter(())
        if self._container is not None:
            self._container.close()
            self._container = None


def pyav() -> ModuleType:
    """Return PyAV.

    Raises:
        CameraLibraryMissing: it is not installed.
    """
    try:
        import av  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise CameraLibraryMissing("JPEG cameras need PyAV: pip install av") from error
    return av
