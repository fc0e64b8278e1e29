"""The race in the real run: laps are counted, a restart loses none, a silent laser stops the robot."""

import json
import math

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import (
    DriveCommand,
    LaserScan,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    replace,
)
from robbie_robots.modules.parcours import Parcours

BEAMS = 90
SCAN = LaserScan(
    angle_min=-math.pi, angle_increment=2 * math.pi / BEAMS, range_min=0.05, range_max=10.0,
    ranges=np.full(BEAMS, 3.0, np.float32),
)  # fmt: skip
Race = ModuleHarness[Parcours]


def drive_circle(race: Race, begin: int, end: int) -> None:
    """Let odometry tell of a circle of 5 m radius; 100 steps, 10 s, are once round."""
    for step in range(begin, end):
        turn = 2 * math.pi * step / 100
        place = Pose(
            position=Point(x=5 * math.sin(turn), y=5 * (1 - math.cos(turn))),
            orientation=Quaternion.from_yaw(turn),
        )
        race.send(Odometry(pose=PoseWithCovariance(pose=place)), topic="odom")
        race.send(SCAN)
        race.advance(0.1)


def has_ended(race: Race) -> bool:
    return race.module.stop_requested


def test_module_ends_after_its_laps_and_writes_their_times() -> None:
    with ModuleHarness(Parcours, {"laps": 2}) as race:
        drive_circle(race, 0, 195)
        assert not has_ended(race)
        drive_circle(race, 195, 205)
        assert has_ended(race)
        assert race.take(DriveCommand)[-1].linear_m_per_s == 0.0
        times_s = json.loads((race.module.output_directory / "laps.json").read_text())["laps_s"]
    assert times_s == pytest.approx([10.0, 10.0], abs=0.3)


def test_killed_module_goes_on_counting() -> None:
    with ModuleHarness(Parcours, {"laps": 1}) as race:
        drive_circle(race, 0, 60)
        kept = race.checkpoint
    with ModuleHarness(Parcours, {"laps": 1}, restored=kept) as race:
        drive_circle(race, 60, 103)
        assert has_ended(race)


def test_laps_are_counted_on_the_map_if_there_is_one() -> None:
    with ModuleHarness(Parcours, {"laps": 1}) as race:
        drive_circle(race, 0, 30)
        for step in range(101):
            turn = 2 * math.pi * (step - 1) / 100
            place = Pose(position=Point(x=5 * math.sin(turn)), orientation=Quaternion.from_yaw(turn))
            race.send(PoseStamped(pose=place), topic="map_pose")
            race.advance(0.1)
            assert not has_ended(race) or step > 95
        drive_circle(race, 0, 3)
        race.send(PoseStamped(pose=Pose(position=Point(x=0.3))), topic="map_pose")
        race.advance(0.1)
        assert has_ended(race)


def test_robot_stands_while_the_laser_is_silent() -> None:
    with ModuleHarness(Parcours) as race:
        race.advance(0.2)
        race.send(SCAN)
        race.advance(0.1)
        assert race.take(DriveCommand)[-1].linear_m_per_s > 0
        race.advance(0.5)
        assert race.take(DriveCommand)[-1].linear_m_per_s == 0.0


def test_command_expires_by_itself() -> None:
    with ModuleHarness(Parcours, {"command_valid_for_s": 0.25}) as race:
        race.send(SCAN)
        race.advance(0.1)
        assert race.take(DriveCommand)[-1].valid_for.nanoseconds == 250_000_000


def test_command_rests_on_the_older_of_scan_and_speed() -> None:
    with ModuleHarness(Parcours) as race:
        race.advance(1.0)
        now_ns = race.clock.now_ns()
        for odometry_s, scan_s in ((0.0, 0.1), (0.2, 0.0)):
            stamps = [Time.from_nanoseconds(now_ns - round(one * 1e9)) for one in (odometry_s, scan_s)]
            race.send(Odometry(header=Header(stamp=stamps[0])), topic="odom")
            race.send(replace(SCAN, header=Header(stamp=stamps[1])))
            race.advance(0.05)
            assert race.take(DriveCommand)[-1].based_on == min(stamps, key=lambda one: one.nanoseconds)


def test_robot_stands_when_its_laser_is_silent_and_the_clock_is_set_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ModuleHarness(Parcours) as race:
        race.advance(10.0)
        race.send(replace(SCAN, header=Header(stamp=Time.from_nanoseconds(race.clock.now_ns()))))
        monkeypatch.setattr(race.clock, "now_ns", lambda: race.clock.monotonic_ns() - 3_000_000_000)
        race.advance(0.1)
        assert race.take(DriveCommand)[-1].linear_m_per_s > 0
        race.advance(2.0)
        assert race.take(DriveCommand)[-1].linear_m_per_s == 0.0
