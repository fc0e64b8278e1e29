"""Cameras through OpenCV: decoded images."""

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraFrame
from robbie_robots.hw.video.source import (
    CameraFault,
    CameraLibraryMissing,
    VideoFormat,
    VideoSource,
    is_address,
)


class OpenCvCamera(VideoSource[CameraFrame]):
    """A camera whose images OpenCV decodes to red, green, blue.

    Args:
        source: see `VideoSource`.
        wanted: likewise.
        pixel_format: four letters that a V4L2 camera is asked for, such as "MJPG"; "": what it has.
        clock: the time for stamps, s.
        silence_s: see `BackgroundDevice`.
        capture: opens a source; for tests, in place of `cv2.VideoCapture`.

    Raises:
        CameraLibraryMissing: OpenCV is not installed.

    Example:
        with closing(OpenCvCamera("/dev/v4l/by-id/usb-046d_C920-video-index0")) as camera:
            for frame in camera.poll(1.0):
                print(frame.pixels.shape)
    """

    def __init__(
        self,
        source: str,
        wanted: VideoFormat | None = None,
        *,
        pixel_format: str = "",
        clock: Callable[[], float] = time.time,
        silence_s: float = 2.0,
        capture: Callable[[str, int], Any] | None = None,
    ) -> None:
        super().__init__(source, wanted, clock=clock, silence_s=silence_s)
        self._cv2 = opencv()
        self._capture_class = capture or self._cv2.VideoCapture
        self._pixel_format = pixel_format
        self._capture: Any = None

    def _open_library(self) -> float:
        cv2 = self._cv2
        is_live = not self._is_file and not is_address(self.name)
        self._capture = self._capture_class(self.name, cv2.CAP_V4L2 if is_live else cv2.CAP_ANY)
        if not self._capture.isOpened():
            raise CameraFault(f"OpenCV cannot open {self.name}")
        if is_live:
            self._ask_for(cv2)
        width, height = self._get(cv2.CAP_PROP_FRAME_WIDTH), self._get(cv2.CAP_PROP_FRAME_HEIGHT)
        self._check_format(int(width), int(height))
        return self._get(cv2.CAP_PROP_FPS)

    def _ask_for(self, cv2: ModuleType) -> None:
        if self._pixel_format:
            letters = cv2.VideoWriter_fourcc(*self._pixel_format)
            self._capture.set(cv2.CAP_PROP_FOURCC, letters)
            if int(self._get(cv2.CAP_PROP_FOURCC)) != letters:
                raise CameraFault(f"the camera at {self.name} has no format {self._pixel_format}")
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, self.wanted.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, self.wanted.height),
            (cv2.CAP_PROP_FPS, self.wanted.rate_hz),
        ):
            self._capture.set(key, value)

    def _get(self, key: int) -> float:
        return float(self._capture.get(key))

    def _read(self) -> CameraFrame | None:
        is_good, image = self._capture.read()
        if not is_good:
            self._ended()
            return None
        # V4L2's driver stamps with the monotonic clock; in files this is the time since their beginning.
        stamp_s = self._stamp_s(self._get(self._cv2.CAP_PROP_POS_MSEC) / 1000)
        pixels: NDArray[np.uint8] = self._cv2.cvtColor(image, self._cv2.COLOR_BGR2RGB)
        return CameraFrame(stamp_s, pixels)

    def _close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None


def opencv() -> ModuleType:
    """Return OpenCV.

    Raises:
        CameraLibraryMissing: it is not installed.
    """
    try:
        import cv2  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise CameraLibraryMissing("cameras need OpenCV: pip install opencv-python-headless") from error
    return cv2
