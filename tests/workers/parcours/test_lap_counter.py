"""Laps are counted by odometry that drifts, to the left and to the right, and over restarts."""

import math

import pytest

from robbie_robots.hw.pose import Pose
from robbie_robots.workers.parcours.lap_counter import LapCounter, LapState


def drive(counter: LapCounter, laps: float, *, side: int = 1, drift_m: float = 0.0) -> list[float]:
    """Drive circles of 10 s each; return when laps ended."""
    ends_s = []
    for step in range(round(200 * laps) + 1):
        turn = side * 2 * math.pi * step / 200
        ahead_m, aside_m = 5 * math.sin(side * turn), 5 * side * (1 - math.cos(turn))
        pose = Pose(ahead_m, aside_m + drift_m * step / 200, turn)
        if counter.see(pose, step / 20):
            ends_s.append(step / 20)
    return ends_s


@pytest.mark.parametrize("side", [1, -1])
def test_lap_ends_when_the_robot_is_back(side: int) -> None:
    counter = LapCounter()
    assert drive(counter, 2.5, side=side, drift_m=0.5) == pytest.approx([10.0, 20.0], abs=0.2)
    assert counter.laps == 2


def test_line_that_is_crossed_without_a_turn_ends_no_lap() -> None:
    counter = LapCounter()
    for number, x_m in enumerate([0.0, 1.0, -1.0, 1.0, -1.0, 1.0]):
        assert not counter.see(Pose(x_m, 0.0, 0.0), number)


def test_new_process_goes_on_counting() -> None:
    counter = LapCounter()
    drive(counter, 0.6)
    resumed = LapCounter(LapState.from_plain(counter.state.plain()))
    for step in range(121, 205):
        turn = 2 * math.pi * step / 200
        resumed.see(Pose(5 * math.sin(turn), 5 * (1 - math.cos(turn)), turn), step / 20)
    assert resumed.laps == 1
