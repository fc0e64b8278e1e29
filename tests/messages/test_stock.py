"""What the stock messages can do besides holding fields."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.messages import Duration, Quaternion, Time

NANOSECONDS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


@given(NANOSECONDS)
def test_times_and_durations_are_exact_to_the_nanosecond(nanoseconds: int) -> None:
    for kind in (Time, Duration):
        made = kind.from_nanoseconds(nanoseconds)
        assert made.nanoseconds == nanoseconds
        assert 0 <= made.nanosec < 10**9


def test_a_duration_in_seconds() -> None:
    assert Duration.from_seconds(1.25) == Duration(sec=1, nanosec=250_000_000)
    assert Duration.from_seconds(-0.25) == Duration(sec=-1, nanosec=750_000_000)
    assert Duration.from_seconds(-0.25).seconds == -0.25


@given(st.floats(-math.pi + 1e-9, math.pi - 1e-9))
def test_a_yaw_comes_back_from_its_quaternion(yaw: float) -> None:
    assert Quaternion.from_yaw(yaw).yaw == pytest.approx(yaw, abs=1e-9)
