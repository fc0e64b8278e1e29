"""An emulated FLIR Lepton 3.5 on a PureThermal board, in place of OpenCV's capture.

A kernel without V4L2 has no virtual cameras: what is emulated are the frames that V4L2 would give.

Source: FLIR, Lepton Engineering Datasheet: telemetry of revision 14.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 160, 120
TELEMETRY_WORDS = 320
# Row A: revision, time in ms and number of the frame, two words each. Row C: TLinear and its unit.
REVISION_WORD, TIME_WORD, FRAME_WORD, TLINEAR_WORD, UNIT_WORD = 0, 1, 20, 160 + 48, 160 + 49
REVISION = 14


class EmulatedLepton:
    """A camera that measures temperatures; hand `capture` to the driver.

    Args:
        measure: returns temperatures, hundredths of a kelvin: (120, 160).
        repeats: how often each frame is sent.

    Attributes:
        is_linear: whether it is in the mode TLinear; set it to your liking.
        is_fine: whether its unit is 0.01 K; else 0.1 K.
        is_plugged_in: whether frames come.
    """

    def __init__(self, measure: Callable[[], NDArray[np.uint16]], repeats: int = 3) -> None:
        self.is_linear = self.is_fine = self.is_plugged_in = True
        self._measure, self._repeats = measure, repeats
        self._sent = 0
        self._settings: dict[int, float] = {}
        self._frame = np.zeros((HEIGHT, WIDTH), np.uint16)

    def capture(self, _source: str, _interface: int) -> "EmulatedLepton":
        """Open it, as `cv2.VideoCapture` does."""
        return self

    def isOpened(self) -> bool:
        """Return whether it is there."""
        return self.is_plugged_in

    def set(self, key: int, value: float) -> bool:
        """Set a property."""
        self._settings[key] = value
        return True

    def get(self, key: int) -> float:
        """Return a property."""
        return self._settings.get(key, 0.0)

    def read(self) -> tuple[bool, NDArray[np.uint16] | NDArray[np.uint8] | None]:
        """Return the next frame: whether there is one, and its pixels."""
        if not self.is_plugged_in:
            return False, None
        if self._sent % self._repeats == 0:
            self._frame = self._measure() // (1 if self.is_fine else 10)
        number = self._sent // self._repeats
        self._sent += 1
        words = np.zeros(TELEMETRY_WORDS, np.uint16)
        words[REVISION_WORD] = REVISION
        words[TIME_WORD : TIME_WORD + 2] = divmod(number * 111, 1 << 16)
        words[FRAME_WORD : FRAME_WORD + 2] = divmod(number, 1 << 16)
        words[TLINEAR_WORD], words[UNIT_WORD] = self.is_linear, self.is_fine
        image = np.vstack([self._frame, words.reshape(-1, WIDTH)]).astype(np.uint16)
        if self._settings.get(cv2.CAP_PROP_CONVERT_RGB, 1.0):
            return True, np.repeat((image >> 8).astype(np.uint8)[:, :, None], 3, axis=2)
        return True, image

    def release(self) -> None:
        """Close it."""
