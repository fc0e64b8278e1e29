"""The estimate of a device's clock is better than the time of arrival."""

import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_robots.hw.connection.clock import DeviceClock, RegularClock, lower_hull

# Until this time the first frames, which may all be late, can spoil the stamps.
SETTLED_S = 5.0


def run(
    clock: DeviceClock,
    seed: int,
    duration_s: float = 30.0,
    period_s: float = 0.025,
    drift: float = 0.0,
    offset_s: float = 1000.0,
    resolution_s: float = 0.0,
    wraps_at_s: float | None = None,
    start_s: float = 0.0,
) -> list[tuple[float, float]]:
    """Return time and error of each stamp: 2 ms of jitter, 3 % of the frames late by up to 50 ms besides."""
    chance, errors = random.Random(seed), []
    arrived_s = 0.0
    for number in range(int(duration_s / period_s)):
        true_s = offset_s + number * period_s
        device_s = start_s + number * period_s * (1 + drift)
        if resolution_s:
            device_s = int(device_s / resolution_s) * resolution_s
        if wraps_at_s:
            device_s %= wraps_at_s
        late_s = chance.uniform(0.005, 0.05) if chance.random() < 0.03 else 0.0
        arrived_s = max(arrived_s, true_s + chance.uniform(0.0, 0.002) + late_s)
        errors.append((number * period_s, clock.stamp_s(device_s, arrived_s) - true_s))
    return errors


def worst_ms(errors: list[tuple[float, float]]) -> float:
    return 1000 * max(abs(error) for at_s, error in errors if at_s >= SETTLED_S)


@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    drift=st.floats(-1e-4, 1e-4),
    period_s=st.sampled_from([0.025, 0.1]),
    resolution_s=st.sampled_from([0.0, 0.001]),
)
def test_stamps_are_within_a_millisecond_and_the_rounding_despite_jitter_and_late_frames(
    seed: int, drift: float, period_s: float, resolution_s: float
) -> None:
    clock = DeviceClock(resolution_s=resolution_s)
    errors = run(clock, seed, duration_s=20.0, period_s=period_s, drift=drift, resolution_s=resolution_s)
    assert worst_ms(errors) < 1.0 + 1000 * resolution_s


@given(seed=st.integers(0, 2**32), start_s=st.floats(16_770.0, 16_777.0))
@settings(max_examples=10, deadline=None)
def test_stamps_go_on_when_the_devices_clock_wraps(seed: int, start_s: float) -> None:
    clock = DeviceClock(wraps_at_s=16_777.216, resolution_s=0.001)
    errors = run(clock, seed, duration_s=15.0, resolution_s=0.001, wraps_at_s=16_777.216, start_s=start_s)
    assert worst_ms(errors) < 2.0
    assert clock.restarts == 0


def test_arrival_alone_would_miss_by_far() -> None:
    chance = random.Random(1)
    assert max(chance.uniform(0.005, 0.05) for _ in range(30)) > 0.04


def test_drift_is_found() -> None:
    clock = DeviceClock()
    run(clock, 3, duration_s=60.0, drift=-3e-4)
    assert clock.drift == pytest.approx(3e-4, rel=0.1)


def test_restarted_device_is_noticed_and_its_stamps_are_right_again() -> None:
    clock = DeviceClock()
    run(clock, 4, duration_s=20.0, start_s=500.0)
    errors = run(clock, 5, offset_s=1030.0, start_s=0.0)
    assert clock.restarts == 1
    assert worst_ms(errors) < 1.0


def test_stall_of_the_host_spoils_no_later_stamp() -> None:
    clock = DeviceClock()
    for number in range(200):
        clock.stamp_s(number * 0.1, 50 + number * 0.1)
    # Five frames wait for 3 s and arrive at once.
    for number in range(200, 235):
        clock.stamp_s(number * 0.1, max(50 + number * 0.1, 73.0))
    assert clock.stamp_s(23.5, 73.5) == pytest.approx(73.5, abs=1e-6)


@given(st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 1e6)), min_size=1, max_size=30))
def test_stamps_are_never_later_than_arrival_and_never_run_backwards(
    pairs: list[tuple[float, float]],
) -> None:
    clock, arrivals = DeviceClock(wraps_at_s=1000.0), sorted(arrived for _, arrived in pairs)
    stamps = [clock.stamp_s(device, arrived) for (device, _), arrived in zip(pairs, arrivals, strict=True)]
    assert all(stamp <= arrived for stamp, arrived in zip(stamps, arrivals, strict=True))
    assert stamps == sorted(stamps)


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=20))
def test_no_point_lies_below_the_lower_hull(values: list[int]) -> None:
    points = [(float(x), float(y)) for x, y in enumerate(values)]
    hull = lower_hull(points)
    for (x0, y0), (x1, y1) in pairwise(hull):
        assert all((x1 - x0) * (y - y0) >= (y1 - y0) * (x - x0) for x, y in points if x0 <= x <= x1)


PERIOD_S = 1 / 75


def late_s(number: int) -> float:
    """Return how late a frame is: most of them up to 2 ms, some by more than two periods."""
    return 0.03 if number % 40 == 7 else 0.002 * (number * 7 % 11) / 10


@pytest.mark.parametrize("gap_is_told", [True, False])
def test_frames_without_stamps_are_stamped_by_their_count(gap_is_told: bool) -> None:
    clock, errors = RegularClock(PERIOD_S), []
    for number in range(600):
        if 300 <= number < 303:
            continue  # lost on the way
        true_s = 50 + number * PERIOD_S
        stamp_s = clock.stamp_s(true_s + late_s(number), has_gap=gap_is_told and number == 303)
        errors.append(stamp_s - true_s)
    assert max(map(abs, errors[100:299])) < 0.001
    assert max(map(abs, errors[(300 if gap_is_told else 400) :])) < 0.001


def test_frame_that_was_late_behind_a_gap_is_not_counted_as_lost_for_long() -> None:
    clock, errors = RegularClock(PERIOD_S), []
    for number in range(200):
        true_s = 50 + number * PERIOD_S
        delay_s = 0.04 if number == 100 else 0.0
        errors.append(clock.stamp_s(true_s + delay_s, has_gap=number == 100) - true_s)
    assert errors[100] == pytest.approx(3 * PERIOD_S)
    # Its followers were early by that count.
    assert max(map(abs, errors[103:])) < 1e-6


def test_frames_on_a_slow_line_count_for_several_periods() -> None:
    for periods in (8, 9):  # the second is too many
        clock, errors = RegularClock(PERIOD_S, periods_per_frame=periods), []
        for number in range(100):
            true_s = 50 + 8 * number * PERIOD_S
            errors.append(clock.stamp_s(true_s + 0.002 * (number * 7 % 11) / 10) - true_s)
        assert max(map(abs, errors[10:])) < 0.001


def test_frames_that_arrive_together_are_stamped_like_single_ones() -> None:
    clock = RegularClock(PERIOD_S, latency_s=0.004)
    stamps = [clock.stamp_s(50 + number * PERIOD_S, frames=4) for number in range(0, 400, 4)]
    assert stamps[-1] == pytest.approx(50 + 396 * PERIOD_S - 0.004)
