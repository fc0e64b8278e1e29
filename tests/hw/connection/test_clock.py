"""The estimate of a device's clock is better than the time of arrival."""

import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.connection.clock import DeviceClock, lower_hull

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
