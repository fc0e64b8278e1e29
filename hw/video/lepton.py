"""FLIR's Lepton 3.5 on a PureThermal board: a V4L2 camera whose 16-bit pixels are temperatures.

Source: FLIR, Lepton Engineering Datasheet (telemetry, TLinear); GroupGets, PureThermal 2 datasheet (Y16).
"""

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraFrame
from robbie_robots.hw.video.opencv import OpenCvCamera
from robbie_robots.hw.video.source import CameraFault, VideoFormat

ROWS, COLUMNS, TELEMETRY_ROWS = 120, 160, 2
# The board sends 27 frames each second, three alike, or 9.
RATE_HZ = 9.0
# Words of the telemetry: number of the frame (two), TLinear on or off, and its unit.
FRAME_COUNTER, TLINEAR_ON, TLINEAR_UNIT = slice(20, 22), 208, 209
# Hundredths of a kelvin for each code of the unit.
UNITS = {0: 10, 1: 1}


class LeptonCamera(OpenCvCamera):
    """A thermal camera. Its images have hundredths of a kelvin: (120, 160) uint16.

    It must be radiometric, and in its mode TLinear, as a Lepton 3.5 is after power-on: the telemetry says so.
    A frame that the board sends again comes out once.

    Args:
        source: "/dev/v4l/by-id/…-index0", or a stable name from a udev rule.
        clock: the time for stamps, s.
        silence_s: see `BackgroundDevice`.
        capture: opens a source; for tests, in place of `cv2.VideoCapture`.

    Raises:
        CameraLibraryMissing: OpenCV is not installed.
    """

    def __init__(
        self,
        source: str,
        *,
        clock: Callable[[], float] = time.time,
        silence_s: float = 2.0,
        capture: Callable[[str, int], Any] | None = None,
    ) -> None:
        super().__init__(
            source,
            VideoFormat(COLUMNS, ROWS + TELEMETRY_ROWS, RATE_HZ),
            pixel_format="Y16 ",
            clock=clock,
            silence_s=silence_s,
            capture=capture,
        )
        self.repeated = 0
        """Frames that came once more."""
        self._counter = b""

    def _ask_for(self, cv2: ModuleType) -> None:
        super()._ask_for(cv2)
        # Else OpenCV makes colours of the upper eight bits.
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        self._counter = b""

    def _read(self) -> CameraFrame | None:
        is_good, image = self._capture.read()
        if not is_good:
            self._ended()
            return None
        raw = np.asarray(image)
        if raw.dtype != np.uint16 or raw.size != (ROWS + TELEMETRY_ROWS) * COLUMNS:
            raise CameraFault(
                f"{self.name} gives {raw.dtype} {raw.shape}, not 122 x 160 of 16 bits with telemetry"
            )
        rows = raw.reshape(-1, COLUMNS)
        unit = self._unit(rows[ROWS:].ravel())
        counter = rows[ROWS:].ravel()[FRAME_COUNTER].tobytes()
        # Frames that the board repeats are in time, too.
        stamp_s = self._stamp_s(self._get(self._cv2.CAP_PROP_POS_MSEC) / 1000)
        if counter == self._counter:
            self.repeated += 1
            return None
        self._counter = counter
        pixels = np.minimum(rows[:ROWS].astype(np.uint32) * unit, np.iinfo(np.uint16).max).astype(np.uint16)
        return CameraFrame(stamp_s, pixels)

    def _unit(self, telemetry: NDArray[np.uint16]) -> int:
        """Return the unit of the pixels, hundredths of a kelvin."""
        unit = UNITS.get(int(telemetry[TLINEAR_UNIT]))
        if telemetry[TLINEAR_ON] != 1 or unit is None:
            raise CameraFault(f"the pixels of {self.name} are no temperatures: switch on its mode TLinear")
        return unit
