"""A simulated laser range finder in an arena."""

import numpy as np
from numpy.typing import NDArray
from strenum import StrEnum

from robbie_robots.hw.laser import DeviceSweep, LaserGeometry, LaserRangeFinder
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena


class LaserNotPlaced(RuntimeError):
    """The simulated laser was asked for a sweep before it was placed."""


class LaserSilent(TimeoutError):
    """The simulated laser's failure is `silent`."""


class LaserFailure(StrEnum):
    """Failures of a simulated laser."""

    NONE = "none"
    SILENT = "silent"
    """The laser sends nothing."""
    BLIND = "blind"
    """The laser gets no returns."""
    FROZEN = "frozen"
    """The laser repeats its last sweep with new stamps."""


class SimulatedLaser(LaserRangeFinder):
    """A laser with noise. It measures the arena from the place where `place` last put it.

    Only the simulated drive knows the robot's true pose; the owner of both devices passes it on. A sweep has
    the stamp of that pose, so it is correct for its stamp even if the pose arrived late.

    Args:
        arena: the world to measure; you may replace it when it changes.
        geometry: the laser's mounting pose and beams.
        noise_m: standard deviation of a range.
        missing: fraction of beams that return nothing.
        seed: random seed of the noise; the same seed and poses give the same sweeps.
    """

    def __init__(
        self,
        arena: Arena,
        geometry: LaserGeometry | None = None,
        noise_m: float = 0.01,
        missing: float = 0.003,
        seed: int = 0,
    ) -> None:
        self.arena = arena
        self._geometry = geometry or LaserGeometry()
        self._angles_rad = self._geometry.angles_rad()
        self._noise_m = noise_m
        self._missing = missing
        self._random = np.random.default_rng(seed)
        self._placed: tuple[Pose, float] | None = None
        self._last_m: NDArray[np.float32] | None = None
        self.failure = LaserFailure.NONE
        """The failure to simulate from now on."""

    @property
    def geometry(self) -> LaserGeometry:
        """Return the laser's mounting pose and beams."""
        return self._geometry

    def place(self, robot: Pose, stamp_s: float) -> None:
        """Put the laser's robot at a true pose.

        Args:
            robot: pose of the robot, arena frame.
            stamp_s: when the robot was there.
        """
        self._placed = (Pose(*robot), stamp_s)

    def scan(self) -> DeviceSweep:
        """Return a sweep from the last place, with the stamp given there.

        Raises:
            LaserNotPlaced: `place` has not been called.
            LaserSilent: the failure is `silent`.
        """
        if self._placed is None:
            raise LaserNotPlaced("the simulated laser has no pose: call place() before scan()")
        if self.failure is LaserFailure.SILENT:
            raise LaserSilent("the simulated laser's failure is set to silent: it sends nothing")
        robot, stamp_s = self._placed
        if self.failure is not LaserFailure.FROZEN or self._last_m is None:
            self._last_m = self._measure(robot)
        return DeviceSweep(stamp_s, self._last_m.copy())

    def _measure(self, robot: Pose) -> NDArray[np.float32]:
        if self.failure is LaserFailure.BLIND:
            return np.full(self._geometry.beams, np.inf, np.float32)
        eye = robot.plus(self._geometry.mount)
        ranges = self.arena.ranges_m(eye.x_m, eye.y_m, self._angles_rad + eye.heading_rad)
        ranges += self._random.normal(0.0, self._noise_m, len(ranges))
        too_near = ranges < self._geometry.range_min_m
        lost = self._random.random(len(ranges)) < self._missing
        ranges[lost | (ranges > self._geometry.range_max_m)] = np.inf
        ranges[too_near] = -np.inf
        return ranges.astype(np.float32)
