"""A simulated inertial measurement unit on a robot that moves in the plane."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.imu import Imu, ImuSample
from robbie_robots.hw.pose import wrapped

GRAVITY_M_PER_S2 = 9.80665


class ImuNotMoved(RuntimeError):
    """The simulated IMU was read before `move` had been called twice."""


@dataclass(frozen=True)
class SensorErrors:
    """White noise and random-walk bias of three sensors of one kind, in the sensor's unit.

    Attributes:
        noise_density: density of the white noise, unit / sqrt(Hz).
        first_bias: standard deviation of the bias at switch-on, unit.
        bias_walk: density of the bias's random walk, unit / s / sqrt(Hz).
    """

    noise_density: float
    first_bias: float
    bias_walk: float


# About those of a cheap MEMS unit (data sheet of the MPU-6050: 0.005 deg/s/sqrt(Hz), 400 ug/sqrt(Hz)) that
# was calibrated once.
GYROSCOPES = SensorErrors(noise_density=9e-5, first_bias=2e-3, bias_walk=2e-5)
ACCELEROMETERS = SensorErrors(noise_density=4e-3, first_bias=3e-2, bias_walk=3e-4)


class SimulatedImu(Imu):
    """An IMU at the robot's centre, with noise and bias.

    Args:
        seed: random seed of noise and biases; the same seed and motion give the same samples.
        gyroscopes: errors of the gyroscopes, rad/s.
        accelerometers: errors of the accelerometers, m/s².
    """

    def __init__(
        self,
        seed: int = 0,
        gyroscopes: SensorErrors = GYROSCOPES,
        accelerometers: SensorErrors = ACCELEROMETERS,
    ) -> None:
        self._gyroscopes = _ThreeSensors(gyroscopes, (seed, 0))
        self._accelerometers = _ThreeSensors(accelerometers, (seed, 1))
        self._before: DriveState | None = None
        self._sample: ImuSample | None = None

    def move(self, truth: DriveState) -> bool:
        """Measure the robot's motion since the last call.

        Returns:
            Whether there is a new sample. The first call gives none, nor does a call at the same time as the
            last one.
        """
        before = self._before
        if before is not None and truth.stamp_s <= before.stamp_s:
            return False
        self._before = truth
        if before is None:
            return False
        passed_s = truth.stamp_s - before.stamp_s
        turn_rad_per_s = wrapped(truth.pose.heading_rad - before.pose.heading_rad) / passed_s
        ahead = (truth.linear_m_per_s - before.linear_m_per_s) / passed_s
        # The centripetal acceleration points to the side.
        aside = (truth.linear_m_per_s + before.linear_m_per_s) / 2 * turn_rad_per_s
        self._sample = ImuSample(
            truth.stamp_s,
            self._gyroscopes.measure(np.array([0.0, 0.0, turn_rad_per_s]), passed_s),
            self._accelerometers.measure(np.array([ahead, aside, GRAVITY_M_PER_S2]), passed_s),
        )
        return True

    def read(self) -> ImuSample:
        """Return the sample of the last motion.

        Raises:
            ImuNotMoved: `move` has not been called twice yet.
        """
        if self._sample is None:
            raise ImuNotMoved("the simulated IMU has no sample: call move() twice before read()")
        return self._sample


class _ThreeSensors:
    """Adds the errors of three sensors."""

    def __init__(self, errors: SensorErrors, seed: tuple[int, int]) -> None:
        self._errors = errors
        self._random = np.random.default_rng(seed)
        self._bias = errors.first_bias * self._random.standard_normal(3)

    def measure(self, true: NDArray[np.float64], passed_s: float) -> NDArray[np.float64]:
        """Return the mean of the measurements in a time."""
        # The mean of white noise falls with the square root of the time; a random walk grows with it.
        root = math.sqrt(passed_s)
        self._bias = self._bias + self._errors.bias_walk * root * self._random.standard_normal(3)
        return true + self._bias + self._errors.noise_density / root * self._random.standard_normal(3)
