"""Where images come from: a camera on V4L2, a camera on the network, or a file.

Source: Linux, Documentation/userspace-api/media/v4l (QUERYCAP, G_FMT, S_FMT).
"""

import errno
import fcntl
import os
import stat
import struct
import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from robbie_robots.hw.connection.background import BackgroundDevice, T
from robbie_robots.hw.connection.errors import DeviceFault

VIDIOC_QUERYCAP, VIDIOC_G_FMT, VIDIOC_S_FMT = 0x80685600, 0xC0D05604, 0xC0D05605
CAPABILITY_BYTES, FORMAT_BYTES = 104, 208
DEVICE_CAPABILITIES_AT, VIDEO_CAPTURE = 88, 1
# A stamp of the driver's that is older is of another clock.
MAX_AGE_S = 5.0


class CameraFault(DeviceFault):
    """The camera is not there, is no camera, is in use, or has not the wanted format."""


class CameraLibraryMissing(ImportError):
    """The library for this kind of camera is not installed."""


@dataclass(frozen=True)
class VideoFormat:
    """What a camera is asked for.

    Attributes:
        width: columns.
        height: rows.
        rate_hz: images each second.
    """

    width: int = 640
    height: int = 480
    rate_hz: float = 30.0


def is_address(source: str) -> bool:
    """Return whether a source is on the network."""
    return "://" in source


def is_device(source: str) -> bool:
    """Return whether a source is a device rather than a file."""
    return not is_address(source) and stat.S_ISCHR(os.stat(source).st_mode)


def check(source: str) -> None:
    """Find out why a source cannot be used: libraries only tell that they failed.

    Raises:
        CameraFault: it is not there, may not be opened, is no camera, or is in use.
    """
    if is_address(source):
        return
    try:
        if not is_device(source):
            return
        descriptor = os.open(source, os.O_RDWR | os.O_NONBLOCK)
    except FileNotFoundError as error:
        raise CameraFault(f"there is no camera at {source}: is it plugged in?") from error
    except PermissionError as error:
        raise CameraFault(f"you may not open {source}: add your user to the group video") from error
    except OSError as error:
        raise CameraFault(f"the camera at {source} cannot be opened: {error.strerror}") from error
    try:
        _check_device(source, descriptor)
    finally:
        os.close(descriptor)


def _check_device(source: str, descriptor: int) -> None:
    try:
        told = fcntl.ioctl(descriptor, VIDIOC_QUERYCAP, bytes(CAPABILITY_BYTES))
    except OSError as error:
        raise CameraFault(f"{source} is no camera ({error.strerror})") from error
    (capabilities,) = struct.unpack_from("=I", told, DEVICE_CAPABILITIES_AT)
    if not capabilities & VIDEO_CAPTURE:
        raise CameraFault(f"{source} gives no images: a camera's images come from its node with index 0")
    # Setting the format that it has changes nothing, but a camera that is in use refuses.
    try:
        question = struct.pack("=I", VIDEO_CAPTURE).ljust(FORMAT_BYTES, b"\0")
        now = fcntl.ioctl(descriptor, VIDIOC_G_FMT, question)
        fcntl.ioctl(descriptor, VIDIOC_S_FMT, now)
    except OSError as error:
        if error.errno == errno.EBUSY:
            raise CameraFault(f"the camera at {source} is in use by another program") from error
        raise CameraFault(f"the camera at {source} does not tell its format: {error.strerror}") from error


class VideoSource(BackgroundDevice[T]):
    """A camera, by any library. It reconnects by itself, at the same source.

    A video file is played at its own rate, again and again.

    Args:
        source: "/dev/v4l/by-id/…-index0", or a stable name from a udev rule; an address that the library
            knows, such as "rtsp://…"; or a video file.
        wanted: what a V4L2 camera is asked for; others give what they have.
        clock: the time for stamps, s.
        silence_s: see `BackgroundDevice`.
    """

    def __init__(
        self,
        source: str,
        wanted: VideoFormat | None = None,
        *,
        clock: Callable[[], float] = time.time,
        silence_s: float = 2.0,
    ) -> None:
        super().__init__(source, silence_s=silence_s)
        self.wanted = wanted or VideoFormat()
        self.missed = 0
        """Images that should have come at the camera's rate, and did not: it is dark, or the bus is full."""
        self._clock = clock
        self._rate_hz = self.wanted.rate_hz
        self._last_s: float | None = None
        self._is_file = self._has_images = False

    def _open(self) -> None:
        check(self.name)
        self._is_file = not is_address(self.name) and not is_device(self.name)
        self._last_s, self._has_images = None, False
        self._rate_hz = self._open_library() or self.wanted.rate_hz

    @abstractmethod
    def _open_library(self) -> float:
        """Open the source; return its rate in Hz, or 0 if it does not tell."""

    def _check_format(self, width: int, height: int) -> None:
        """Compare what a camera gives with what is wanted."""
        wanted = self.wanted
        if self._is_file or is_address(self.name):
            return
        if (width, height) != (wanted.width, wanted.height):
            raise CameraFault(
                f"the camera at {self.name} gives {width} x {height}, not {wanted.width} x {wanted.height}: "
                "`v4l2-ctl --list-formats-ext` tells what it has"
            )

    def _stamp_s(self, monotonic_s: float) -> float:
        """Return when an image was taken, by `clock`; count those that are missing before it.

        Args:
            monotonic_s: the driver's stamp, s; ignored if it cannot be of this machine's monotonic clock.
        """
        if self._is_file and self._last_s is not None:
            self._pause(self._last_s + 1.0 / self._rate_hz - time.monotonic())
        now_s, arrived_s = time.monotonic(), self._clock()
        is_stamped = not self._is_file and 0.0 <= now_s - monotonic_s <= MAX_AGE_S
        taken_s = monotonic_s if is_stamped else now_s
        if self._last_s is not None and not self._is_file:
            self.missed += max(0, round((taken_s - self._last_s) * self._rate_hz) - 1)
        self._last_s = taken_s
        self._has_images = True
        return arrived_s - (now_s - taken_s)

    def _ended(self) -> None:
        """Begin a file again; any other source that ends is lost."""
        if not self._is_file or not self._has_images:
            raise CameraFault(f"{self.name} gives no more images")
        self._close()
        check(self.name)
        self._has_images = False
        self._open_library()
