"""The simulated IMU measures the physical motion, with noise and bias of the declared size."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.imu import ImuSample
from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.imu import GRAVITY_M_PER_S2, ImuNotMoved, SensorErrors, SimulatedImu

EXACT = SensorErrors(0.0, 0.0, 0.0)


def on_circle(stamp_s: float, linear: float = 0.5, angular: float = 0.8) -> DriveState:
    pose = ORIGIN.after_arc(linear * stamp_s, angular * stamp_s)
    return DriveState(stamp_s, pose, linear, angular)


def samples(imu: SimulatedImu, states: Iterable[DriveState]) -> list[ImuSample]:
    return [imu.read() for state in states if imu.move(state)]


def test_robot_on_a_circle_measures_centripetal_acceleration() -> None:
    imu = SimulatedImu(gyroscopes=EXACT, accelerometers=EXACT)
    (sample,) = samples(imu, [on_circle(1.0), on_circle(1.1)])
    np.testing.assert_allclose(sample.turn_rad_per_s, [0.0, 0.0, 0.8], atol=1e-12)
    np.testing.assert_allclose(sample.acceleration_m_per_s2, [0.0, 0.5 * 0.8, GRAVITY_M_PER_S2], atol=1e-12)
    assert sample.stamp_s == 1.1


def test_forward_acceleration_is_measured_along_x() -> None:
    imu = SimulatedImu(gyroscopes=EXACT, accelerometers=EXACT)
    (sample,) = samples(imu, [DriveState(0.0, ORIGIN, 0.1, 0.0), DriveState(0.2, ORIGIN, 0.4, 0.0)])
    np.testing.assert_allclose(sample.acceleration_m_per_s2, [1.5, 0.0, GRAVITY_M_PER_S2])


def test_turn_across_plus_minus_pi_is_small() -> None:
    imu = SimulatedImu(gyroscopes=EXACT, accelerometers=EXACT)
    states = [DriveState(0.0, Pose(0, 0, 3.1), 0, 0), DriveState(0.1, Pose(0, 0, -3.1), 0, 0)]
    (sample,) = samples(imu, states)
    assert sample.turn_rad_per_s[2] == pytest.approx((2 * math.pi - 6.2) / 0.1)


def test_no_sample_before_time_has_passed() -> None:
    imu = SimulatedImu()
    assert not imu.move(on_circle(1.0))
    with pytest.raises(ImuNotMoved, match=r"move\(\)"):
        imu.read()
    assert not imu.move(on_circle(1.0))
    assert imu.move(on_circle(1.1))


@pytest.mark.parametrize("period_s", [0.01, 0.1])
def test_noise_falls_with_the_square_root_of_the_averaging_time(period_s: float) -> None:
    noisy = SensorErrors(noise_density=0.02, first_bias=0.0, bias_walk=0.0)
    states = [DriveState(n * period_s, ORIGIN, 0.0, 0.0) for n in range(2001)]
    values = np.array([s.turn_rad_per_s for s in samples(SimulatedImu(gyroscopes=noisy), states)])
    assert values.std() == pytest.approx(0.02 / math.sqrt(period_s), rel=0.05)
    assert abs(values.mean()) < 0.02 / math.sqrt(2000 * period_s)


def test_bias_starts_and_walks_as_declared() -> None:
    errors = SensorErrors(noise_density=0.0, first_bias=0.3, bias_walk=0.05)
    states = [DriveState(n * 0.25, ORIGIN, 0.0, 0.0) for n in range(65)]
    runs = [samples(SimulatedImu(seed, gyroscopes=errors), states) for seed in range(150)]
    begin = np.array([run[0].turn_rad_per_s for run in runs])
    assert begin.std() == pytest.approx(math.hypot(0.3, 0.05 / 2), rel=0.15)
    walked = np.array([run[-1].turn_rad_per_s for run in runs]) - begin
    assert walked.std() == pytest.approx(0.05 * math.sqrt(63 * 0.25), rel=0.15)


def test_samples_depend_only_on_the_seed() -> None:
    states = [on_circle(n * 0.1) for n in range(4)]
    runs = [
        np.array([s.acceleration_m_per_s2 for s in samples(SimulatedImu(seed), states)]) for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
