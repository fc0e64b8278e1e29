"""Where a camera on a pan-tilt unit looks: at something, or around."""

import math

import numpy as np
from numpy.typing import ArrayLike

AROUND_RAD = (0.0, 1.2, 0.0, -1.2)
FARTHEST_RAD = 2.6


class LookAround:
    """Turns the camera in steps, because its images are sharp only while it stands still.

    Args:
        step_s: Time for each direction, including the turn to it.
        around_rad: The directions to look in, in order, measured to the left of straight ahead.
    """

    def __init__(self, step_s: float = 1.0, around_rad: tuple[float, ...] = AROUND_RAD) -> None:
        self._step_s = step_s
        self._around_rad = around_rad

    def pan_rad(self, now_s: float, pose: ArrayLike, look_at_xy_m: ArrayLike | None) -> float:
        """Return the direction to look in now, measured to the left of straight ahead.

        Args:
            now_s: The time.
            pose: The robot's x, y (m) and heading (rad), map frame.
            look_at_xy_m: m, map frame. None: look around. The camera also looks around while this
                point is behind the robot.
        """
        if look_at_xy_m is not None:
            x, y, heading = np.asarray(pose, float)
            dx, dy = np.asarray(look_at_xy_m, float) - (x, y)
            pan = math.remainder(math.atan2(dy, dx) - heading, math.tau)
            if abs(pan) <= FARTHEST_RAD:
                return pan
        return self._around_rad[int(now_s / self._step_s) % len(self._around_rad)]
