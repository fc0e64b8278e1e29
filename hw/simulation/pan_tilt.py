"""A simulated pan-tilt unit."""

from collections.abc import Callable

from robbie_robots.hw.pan_tilt import PanTiltLimits, PanTiltState, PanTiltUnit


class SimulatedPanTilt(PanTiltUnit):
    """A unit that moves each joint to its target at a constant rate, according to a clock.

    Args:
        clock: returns the time in s; it must not go back.
        limits: limits of its angles and speed.
        direction: initial pan and tilt, rad.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        limits: PanTiltLimits | None = None,
        direction: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self._clock = clock
        self._limits = limits or PanTiltLimits()
        self._from = self._target = self._limits.within(*direction)
        self._since_s = clock()

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Move towards a direction; beyond the limits, to the nearest one within."""
        target = self._limits.within(pan_rad, tilt_rad)
        now = self.read()
        self._from, self._since_s = (now.pan_rad, now.tilt_rad), now.stamp_s
        self._target = target

    def read(self) -> PanTiltState:
        """Return the unit's current direction."""
        now_s = self._clock()
        passed_s = now_s - self._since_s
        (pan, pan_rate), (tilt, tilt_rate) = (
            self._joint(begin, end, passed_s) for begin, end in zip(self._from, self._target, strict=True)
        )
        return PanTiltState(now_s, pan, tilt, pan_rate, tilt_rate)

    def _joint(self, begin: float, end: float, passed_s: float) -> tuple[float, float]:
        """Return the angle and rate of one joint after a time."""
        rate = self._limits.rate_rad_per_s
        if abs(end - begin) <= rate * passed_s:
            return end, 0.0
        rate = rate if end > begin else -rate
        return begin + rate * passed_s, rate
