"""Where the pan-tilt unit looked lately, for devices that stand on it."""

import math
from collections import deque

import numpy as np

from robbie_mp.messages import JointState

# At 20 messages a second the last second.
REMEMBERED = 20
# A joint that was last seen to turn is taken to have turned on for so long at most.
GOES_ON_S = 0.1


class PanTiltHistory:
    """Remembers what the pan-tilt unit has told; before that, it looks straight ahead."""

    def __init__(self) -> None:
        self._told: deque[tuple[float, ...]] = deque(maxlen=REMEMBERED)

    def add(self, message: JointState) -> None:
        """Remember where it looks; a message without both joints, or with what is no angle, is left out."""
        angles = dict(zip(message.name, message.position.tolist(), strict=False))
        rates = dict(zip(message.name, message.velocity.tolist(), strict=False))
        joints = [angles.get(name, math.nan) for name in ("pan", "tilt")]
        joints += [rates.get(name, 0.0) for name in ("pan", "tilt")]
        if not all(math.isfinite(value) for value in joints):
            return
        stamp_s = message.header.stamp.nanoseconds / 1e9
        if self._told and stamp_s <= self._told[-1][0]:
            self._told.clear()  # time has begun anew
        self._told.append((stamp_s, *joints))

    def at(self, stamp_s: float) -> tuple[float, float]:
        """Return pan and tilt at a moment, rad, from what is known of the time around it."""
        if not self._told:
            return 0.0, 0.0
        stamps, pans, tilts, pan_rates, tilt_rates = np.array(self._told).T
        on_s = min(max(stamp_s - stamps[-1], 0.0), GOES_ON_S)
        pan, tilt = np.interp(stamp_s, stamps, pans), np.interp(stamp_s, stamps, tilts)
        return float(pan + on_s * pan_rates[-1]), float(tilt + on_s * tilt_rates[-1])
