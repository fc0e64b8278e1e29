"""The simulated pan-tilt unit moves to its target at its rate and within its limits."""

import math

import pytest

from robbie_robots.hw.pan_tilt import PanTiltError, PanTiltLimits
from robbie_robots.hw.simulation.pan_tilt import SimulatedPanTilt


class Clock:
    now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_joints_move_at_their_rate_and_stop_at_the_target(clock: Clock) -> None:
    unit = SimulatedPanTilt(clock, PanTiltLimits(rate_rad_per_s=0.5))
    unit.look(1.0, -0.2)
    clock.now_s += 0.3
    state = unit.read()
    assert (state.pan_rad, state.tilt_rad) == pytest.approx((0.15, -0.15))
    assert (state.pan_rad_per_s, state.tilt_rad_per_s) == (0.5, -0.5)
    clock.now_s += 0.3
    assert unit.read().tilt_rad == -0.2
    clock.now_s += 1.5
    state = unit.read()
    assert (state.pan_rad, state.pan_rad_per_s, state.tilt_rad_per_s) == (1.0, 0.0, 0.0)


def test_motion_to_a_new_target_starts_at_the_current_direction(clock: Clock) -> None:
    unit = SimulatedPanTilt(clock, PanTiltLimits(rate_rad_per_s=1.0))
    unit.look(1.0, 0.0)
    clock.now_s += 0.6
    unit.look(0.0, 0.0)
    assert unit.read().pan_rad == pytest.approx(0.6)
    clock.now_s += 0.2
    assert unit.read().pan_rad == pytest.approx(0.4)


def test_target_beyond_the_limits_becomes_the_nearest_allowed_one(clock: Clock) -> None:
    limits = PanTiltLimits(pan_rad=2.0, tilt_up_rad=0.5, tilt_down_rad=0.7)
    unit = SimulatedPanTilt(clock, limits)
    unit.look(-9.0, 9.0)
    clock.now_s += 60.0
    assert (unit.read().pan_rad, unit.read().tilt_rad) == (-2.0, 0.7)
    unit.look(9.0, -9.0)
    clock.now_s += 60.0
    assert (unit.read().pan_rad, unit.read().tilt_rad) == (2.0, -0.5)


@pytest.mark.parametrize("direction", [(math.nan, 0.0), (0.0, math.inf)])
def test_invalid_direction_is_refused_and_changes_nothing(
    clock: Clock, direction: tuple[float, float]
) -> None:
    unit = SimulatedPanTilt(clock)
    unit.look(1.0, 0.0)
    with pytest.raises(PanTiltError, match="finite"):
        unit.look(*direction)
    clock.now_s += 60.0
    assert unit.read().pan_rad == 1.0


def test_unit_in_a_new_process_keeps_its_direction(clock: Clock) -> None:
    assert SimulatedPanTilt(clock, direction=(0.3, 0.1)).read().pan_rad == 0.3
