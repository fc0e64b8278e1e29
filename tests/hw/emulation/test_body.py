"""The body behind an emulated base: its encoders count up to the moment at which they are asked."""

from collections.abc import Callable

import numpy as np
import pytest

from robbie_robots.hw.emulation.body import SimulatedBody
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.wheel import WheelErrors

ROOM = Arena(
    segments=box_segments(np.array([[0.0, 0.0, 20.0, 20.0]])),
    circles=np.zeros((0, 3)),
    start=Pose(2.0, 10.0, 0.0),
    width_m=20.0,
    height_m=20.0,
)
EXACT = WheelErrors(left_scale=0.0, right_scale=0.0, slip_m_per_sqrt_m=0.0)
SPEED_M_PER_S, TURN_RAD_PER_S = 0.6, 0.3
ACCELERATION_S = 1.0


def body_in_room(clock: Callable[[], float]) -> SimulatedBody:
    shape = DifferentialDrive()
    return SimulatedBody(SimulatedDrive(ROOM, clock, body=shape, errors=EXACT), shape)


def test_encoders_count_between_the_steps_of_the_simulation_too() -> None:
    now = [0.0]
    body = body_in_room(lambda: now[0])
    ways_m, turns_rad, times_s = [0.0], [0.0], [0.0]
    for _ in range(900):
        now[0] += 0.0037
        way_m, turn_rad = body.move(SPEED_M_PER_S, TURN_RAD_PER_S, 0.0037, now[0])
        times_s.append(now[0])
        ways_m.append(ways_m[-1] + way_m)
        turns_rad.append(turns_rad[-1] + turn_rad)
    at_speed = np.array(times_s) > ACCELERATION_S
    for counted, speed in ((ways_m, SPEED_M_PER_S), (turns_rad, TURN_RAD_PER_S)):
        rest = np.array(counted)[at_speed] - speed * np.array(times_s)[at_speed]
        # A tick is 0.15 mm; the simulation's steps are 6 mm.
        assert np.ptp(rest) < 0.0015
    assert ways_m[-1] == pytest.approx(SPEED_M_PER_S * times_s[-1] - 0.18, abs=0.01)


def test_body_that_has_stopped_counts_no_more() -> None:
    now = [0.0]
    body = body_in_room(lambda: now[0])
    for _ in range(100):
        now[0] += 0.013
        body.move(SPEED_M_PER_S, 0.0, 0.013, now[0])
    for _ in range(100):
        now[0] += 0.013
        last = body.move(0.0, 0.0, 0.013, now[0])
    assert last == (0.0, 0.0)


def test_encoders_that_are_read_late_tell_what_they_had_counted_in_time() -> None:
    now = [0.0]
    prompt, late = body_in_room(lambda: now[0]), body_in_room(lambda: now[0])
    ways_m = [0.0, 0.0]
    for number in range(300):
        now[0] = number * 0.015
        ways_m[0] += prompt.move(SPEED_M_PER_S, 0.0, 0.015, now[0])[0]
        # A busy machine lets every other report wait for 8 ms.
        at_s = now[0]
        now[0] += 0.008 * (number % 2)
        ways_m[1] += late.move(SPEED_M_PER_S, 0.0, 0.015, at_s)[0]
        if number > 100:
            # A tick is 0.15 mm; in 8 ms it drives 4.8 mm.
            assert ways_m[0] == pytest.approx(ways_m[1], abs=0.002)


def test_encoders_that_are_read_late_after_a_pause_tell_how_it_was_in_between() -> None:
    now = [0.0]
    prompt, late = body_in_room(lambda: now[0]), body_in_room(lambda: now[0])
    told = [[body.move(SPEED_M_PER_S, 0.0, 0.015, 0.0)[0]] for body in (prompt, late)]
    for number in range(1, 41):
        now[0] = number * 0.015
        told[0].append(prompt.move(SPEED_M_PER_S, 0.0, 0.015, now[0])[0])
        if number % 4 == 0:
            # Four reports at once, while the robot gathers speed.
            told[1] += [
                late.move(SPEED_M_PER_S, 0.0, 0.015, now[0] - 0.015 * missed)[0] for missed in (3, 2, 1, 0)
            ]
    assert np.cumsum(told[1]) == pytest.approx(np.cumsum(told[0]), abs=0.002)
    assert min(told[1]) >= 0.0
