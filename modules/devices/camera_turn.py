"""Turns the camera of a robot's head, for modules that look at what they do."""

import math

from robbie_mp import Header, Module, Time
from robbie_mp.messages import PanTiltCommand
from robbie_robots.modules.devices.command_age import LOOK_FOR

MIN_TURN_RAD = 0.02
"""Smaller turns are not worth a command."""
REPEAT_S = 0.5
"""Time after which a direction is commanded again: the unit drops what it may not follow for longer."""


class CameraTurn:
    """Commands directions of the camera, each if it differs from the one before, and again after a while.

    Args:
        module: the module that looks.
        min_turn_rad: smaller turns are not commanded.
    """

    def __init__(self, module: Module, min_turn_rad: float = MIN_TURN_RAD) -> None:
        self._module = module
        self._min_turn_rad = min_turn_rad
        self._direction = (math.nan, math.nan)
        self._commanded_s = -math.inf

    def to(self, pan_rad: float, tilt_rad: float, based_on: Time) -> None:
        """Turn the camera.

        Args:
            pan_rad: direction from straight ahead, to the left, rad.
            tilt_rad: direction from level, down, rad.
            based_on: stamp of the pose from which the direction was computed.
        """
        now_s = self._module.monotonic_s()
        is_small = math.dist((pan_rad, tilt_rad), self._direction) < self._min_turn_rad
        if is_small and now_s - self._commanded_s < REPEAT_S:
            return
        self._direction, self._commanded_s = (pan_rad, tilt_rad), now_s
        self._module.publish(
            PanTiltCommand(
                header=Header(stamp=self._module.now(), frame_id="base_link"),
                pan_rad=pan_rad,
                tilt_rad=tilt_rad,
                valid_for=LOOK_FOR,
                based_on=based_on,
            )
        )
