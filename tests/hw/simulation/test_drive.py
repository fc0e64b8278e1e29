"""The simulated drive follows commands within its limits while they are valid, and stops at walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robbie_robots.hw.drive import DriveCommandError
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import AppearingObstacle
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.drive import SimulatedDrive, WorldState
from robbie_robots.hw.simulation.wheel import WheelErrors

EXACT = WheelErrors(0.0, 0.0, 0.0)
WALLS = box_segments(np.array([[0.0, 0.0, 20.0, 20.0]]))
HALL = Arena(WALLS, np.empty((0, 3)), Pose(10.0, 10.0, 0.0), 20.0, 20.0)


class Clock:
    """Time that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def drive_for(drive: SimulatedDrive, clock: Clock, seconds: float, linear: float, angular: float) -> None:
    """Command at 10 Hz."""
    for _ in range(round(seconds * 10)):
        drive.command(linear, angular, 0.3)
        clock.now_s += 0.1
        drive.read()


def test_drive_stands_still_until_commanded(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    clock.now_s += 10.0
    assert drive.ground_truth().pose == HALL.start
    assert drive.read().stamp_s == pytest.approx(clock.now_s)


def test_distance_driven_follows_from_speed_and_acceleration(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive_for(drive, clock, 4.0, 0.5, 0.0)
    # 0.5 s to speed up at 1 m/s2, so half of 0.25 m is missing.
    assert drive.ground_truth().pose.x_m - 10.0 == pytest.approx(4.0 * 0.5 - 0.125, abs=0.01)
    assert drive.ground_truth().linear_m_per_s == pytest.approx(0.5)


def test_drive_stops_when_commands_cease(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive_for(drive, clock, 2.0, 0.5, 0.3)
    begin = drive.ground_truth().pose
    clock.now_s += 5.0
    assert (drive.read().linear_m_per_s, drive.read().angular_rad_per_s) == (0.0, 0.0)
    assert drive.expired_commands == 1
    # 0.2 s left of the last command, then 0.5 / 6 s of braking hard.
    way_m = 0.5 * 0.2 + 0.5 * (0.5 / 6) / 2
    assert math.dist(begin[:2], drive.ground_truth().pose[:2]) == pytest.approx(way_m, abs=0.01)


def test_motion_does_not_depend_on_how_often_the_drive_is_read(clock: Clock) -> None:
    often, seldom = Clock(), Clock()
    drives = [SimulatedDrive(HALL, often, seed=3), SimulatedDrive(HALL, seldom, seed=3)]
    for drive in drives:
        drive.command(0.4, 0.5, 10.0)
    for _ in range(300):
        often.now_s += 0.01
        drives[0].read()
    seldom.now_s = often.now_s
    assert drives[0].read().pose == pytest.approx(drives[1].read().pose, abs=0.01)


def test_command_to_stand_still_does_not_expire(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive.command(0.0, 0.0, 0.1)
    clock.now_s += 1.0
    drive.read()
    assert drive.expired_commands == 0


def test_stop_brakes_to_a_halt(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive_for(drive, clock, 2.0, 0.5, 0.0)
    drive.stop()
    clock.now_s += 0.25
    assert 0.0 < drive.read().linear_m_per_s < 0.5
    clock.now_s += 0.3
    assert drive.read().linear_m_per_s == 0.0
    assert drive.expired_commands == 0


def test_speeds_are_limited_and_keep_the_curvature(clock: Clock) -> None:
    body = DifferentialDrive()
    drive = SimulatedDrive(HALL, clock, body=body)
    drive_for(drive, clock, 3.0, 50.0, 50.0)
    state = drive.read()
    fastest_wheel = state.linear_m_per_s + state.angular_rad_per_s * body.axle_m / 2
    assert fastest_wheel == pytest.approx(body.max_wheel_m_per_s)
    ratio = body.max_linear_m_per_s / body.max_angular_rad_per_s
    assert state.linear_m_per_s / state.angular_rad_per_s == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("command", "named"),
    [
        ((math.nan, 0.0, 1.0), "linear_m_per_s"),
        ((0.0, math.inf, 1.0), "angular_rad_per_s"),
        ((0.0, 0.0, math.nan), "valid_for_s"),
        ((0.1, 0.0, 0.0), "valid_for_s"),
        ((0.1, 0.0, -1.0), "valid_for_s"),
    ],
)
def test_invalid_command_is_refused_and_changes_nothing(
    clock: Clock, command: tuple[float, float, float], named: str
) -> None:
    drive = SimulatedDrive(HALL, clock)
    with pytest.raises(DriveCommandError, match=named):
        drive.command(*command)
    clock.now_s += 1.0
    assert drive.ground_truth().pose == HALL.start


def test_wall_stops_the_robot_and_is_counted_once(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock, resumed=WorldState(Pose(19.0, 10.0, 0.0)))
    drive_for(drive, clock, 5.0, 0.5, 0.0)
    assert drive.collisions == 1
    assert drive.ground_truth().pose.x_m == pytest.approx(20.0 - DifferentialDrive().body_radius_m, abs=0.01)
    assert drive.read().linear_m_per_s == 0.0


def test_robot_can_leave_a_wall_and_touch_it_again(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock, resumed=WorldState(Pose(19.5, 10.0, 0.0)))
    drive_for(drive, clock, 2.0, 0.5, 0.0)
    drive_for(drive, clock, 1.0, -0.5, 0.0)
    assert drive.ground_truth().pose.x_m < 19.7
    drive_for(drive, clock, 2.0, 0.5, 0.0)
    assert drive.collisions == 2


def test_robot_can_turn_on_the_spot_at_a_wall(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock, resumed=WorldState(Pose(19.79, 10.0, 0.0)))
    drive_for(drive, clock, 2.0, 0.0, 1.0)
    assert drive.collisions == 0
    assert drive.ground_truth().pose.heading_rad > 1.5


def test_odometry_of_exact_wheels_is_the_true_pose(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock, errors=EXACT)
    drive_for(drive, clock, 20.0, 0.4, 0.3)
    assert HALL.start.plus(drive.read().pose) == pytest.approx(drive.ground_truth().pose, abs=0.005)


def test_odometry_drifts_by_decimetres_and_degrees_in_a_minute(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive_for(drive, clock, 60.0, 0.4, 0.2)
    told, true = HALL.start.plus(drive.read().pose), drive.ground_truth().pose
    assert 0.1 < math.dist(told[:2], true[:2]) < 3.0
    assert 3 < math.degrees(abs(math.remainder(told.heading_rad - true.heading_rad, math.tau))) < 45


def test_drift_depends_only_on_the_seed() -> None:
    def odometry(seed: int) -> Pose:
        clock = Clock()
        drive = SimulatedDrive(HALL, clock, seed)
        drive_for(drive, clock, 5.0, 0.4, 0.2)
        return drive.read().pose

    assert odometry(7) == odometry(7)
    assert odometry(7) != odometry(8)


def test_replaced_drive_continues_where_the_last_one_was(clock: Clock) -> None:
    first = SimulatedDrive(HALL, clock)
    drive_for(first, clock, 3.0, 0.4, 0.2)
    world = first.world_state()
    second = SimulatedDrive(HALL, clock, resumed=world)
    assert second.ground_truth().pose == first.ground_truth().pose
    assert second.read().pose == first.read().pose
    assert second.read().linear_m_per_s == 0.0


def test_emergency_stop_brakes_harder_and_latches_until_released(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive_for(drive, clock, 2.0, 0.6, 0.0)
    begin = drive.ground_truth().pose
    drive.stop_for_emergency()
    drive_for(drive, clock, 3.0, 0.6, 0.0)
    # v^2 / 2a with six times the ordinary 1 m/s2.
    assert math.dist(begin[:2], drive.ground_truth().pose[:2]) == pytest.approx(0.36 / 12.0, abs=0.01)
    assert drive.is_emergency_stopped
    drive.release()
    clock.now_s += 0.2
    assert drive.read().linear_m_per_s == 0.0
    drive_for(drive, clock, 1.0, 0.6, 0.0)
    assert drive.read().linear_m_per_s == pytest.approx(0.6)


def test_emergency_stop_outlives_the_simulating_process(clock: Clock) -> None:
    drive = SimulatedDrive(HALL, clock)
    drive.stop_for_emergency()
    drive = SimulatedDrive(HALL, clock, resumed=drive.world_state())
    drive_for(drive, clock, 1.0, 0.6, 0.0)
    assert drive.ground_truth().pose == HALL.start


def test_temporary_obstacle_stops_the_robot_and_disappears(clock: Clock) -> None:
    wall = AppearingObstacle((12.0, 9.0, 12.2, 11.0), from_s=1.0, until_s=9.0)
    drive = SimulatedDrive(replace(HALL, appearing=(wall,)), clock)
    drive_for(drive, clock, 6.0, 0.6, 0.0)
    assert drive.ground_truth().pose.x_m == pytest.approx(11.8, abs=0.01)
    assert (drive.obstacles, drive.collisions) == ((0,), 1)
    drive = SimulatedDrive(replace(HALL, appearing=(wall,)), clock, resumed=drive.world_state())
    before = drive.obstacles
    drive_for(drive, clock, 4.0, 0.6, 0.0)
    assert (before, drive.obstacles) == ((0,), ())
    assert drive.ground_truth().pose.x_m > 12.0


def test_obstacle_does_not_appear_where_the_robot_stands(clock: Clock) -> None:
    person = AppearingObstacle((10.1, 10.0, 0.25), from_s=0.5)
    drive = SimulatedDrive(replace(HALL, appearing=(person,)), clock)
    clock.now_s += 2.0
    drive.read()
    before = drive.obstacles
    drive_for(drive, clock, 5.0, -0.6, 0.0)
    assert (before, drive.obstacles, drive.collisions) == ((), (0,), 0)
