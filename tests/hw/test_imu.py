"""How long drivers of inertial units let samples gather."""

import pytest

from robbie_robots.hw.imu import gathered_s


@pytest.mark.parametrize(
    ("rate_hz", "expected_s"), [(100, 0.0), (150, 0.0), (200, 0.01), (400, 0.01), (450, 4 / 450)]
)
def test_samples_gather_for_whole_periods_of_the_unit(rate_hz: float, expected_s: float) -> None:
    assert gathered_s(rate_hz) == pytest.approx(expected_s)
