"""Recent directions of the pan-tilt unit, for devices mounted on it."""

import math
from collections import deque

import numpy as np

from robbie_mp.messages import JointState

# The last second at 20 messages a second.
MAX_MESSAGES = 20
# A joint that was last seen turning is extrapolated for at most this time.
MAX_EXTRAPOLATION_S = 0.1


class PanTiltHistory:
    """The last directions that the pan-tilt unit published. Before the first one, it is straight ahead."""

    def __init__(self) -> None:
        self._told: deque[tuple[float, ...]] = deque(maxlen=MAX_MESSAGES)

    def add(self, message: JointState) -> None:
        """Add a direction; a message that lacks a joint or has a non-finite angle is ignored."""
        angles = dict(zip(message.name, message.position.tolist(), strict=False))
        rates = dict(zip(message.name, message.velocity.tolist(), strict=False))
        joints = [angles.get(name, math.nan) for name in ("pan", "tilt")]
        joints += [rates.get(name, 0.0) for name in ("pan", "tilt")]
        if not all(math.isfinite(value) for value in joints):
            return
        stamp_s = message.header.stamp.nanoseconds / 1e9
        if self._told and stamp_s <= self._told[-1][0]:
            self._told.clear()  # time was reset
        self._told.append((stamp_s, *joints))

    def at(self, stamp_s: float) -> tuple[float, float]:
        """Return pan and tilt at a time, rad, interpolated or briefly extrapolated."""
        if not self._told:
            return 0.0, 0.0
        stamps, pans, tilts, pan_rates, tilt_rates = np.array(self._told).T
        on_s = min(max(stamp_s - stamps[-1], 0.0), MAX_EXTRAPOLATION_S)
        pan, tilt = np.interp(stamp_s, stamps, pans), np.interp(stamp_s, stamps, tilts)
        return float(pan + on_s * pan_rates[-1]), float(tilt + on_s * tilt_rates[-1])
