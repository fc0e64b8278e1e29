"""The module of navigation in the demo arena, driven in a test's time."""

import math
from collections.abc import Iterator

import pytest

from hw.simulation.arena_file import read_arena
from hw.simulation.drive import SimulatedDrive
from hw.simulation.laser import SimulatedLaser
from modules.navigation import Navigation
from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import (
    CancelGoal,
    DriveCommand,
    EmergencyStop,
    LaserScan,
    MapMetaData,
    NavigationState,
    OccupancyGrid,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    TimeJump,
)
from robbie_mp.messages import Path as PathMessage
from tests._support.places import ARENAS
from tools.random_rooms import drawn_map

ARENA = read_arena(ARENAS / "demo.yaml")
CELLS, CORNER = drawn_map(ARENA, 0.05)
STEP_S = 0.12


def pose_of(x_m: float, y_m: float, heading_rad: float) -> Pose:
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))


GOAL = PoseStamped(header=Header(frame_id="map"), pose=pose_of(3.5, 2.4, 1.0))


class Robot:
    """What the module's robot does and sees."""

    def __init__(self, harness: ModuleHarness[Navigation]) -> None:
        self.harness = harness
        self.drive = SimulatedDrive(ARENA, self.now_s)
        self.laser = SimulatedLaser(ARENA)
        self.has_laser = True
        height, width = CELLS.shape
        origin = pose_of(float(CORNER[0]), float(CORNER[1]), 0.0)
        info = MapMetaData(resolution=0.05, width=width, height=height, origin=origin)
        harness.send(OccupancyGrid(info=info, data=CELLS.ravel()))

    def now_s(self) -> float:
        return self.harness.clock.monotonic_ns() / 1e9

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            truth = self.drive.ground_truth()
            stamp = Time.from_nanoseconds(round(truth.stamp_s * 1e9))
            header = Header(stamp=stamp, frame_id="map")
            self.harness.send(PoseStamped(header=header, pose=pose_of(*truth.pose)), topic="map_pose")
            if self.has_laser:
                self.harness.send(self.scan(stamp))
            self.harness.advance(STEP_S)
            for command in self.harness.take(DriveCommand):
                self.drive.command(
                    command.linear_m_per_s, command.angular_rad_per_s, command.valid_for.nanoseconds / 1e9
                )

    def scan(self, stamp: Time) -> LaserScan:
        self.laser.place(self.drive.ground_truth().pose, stamp.nanoseconds / 1e9)
        geometry = self.laser.geometry
        return LaserScan(
            header=Header(stamp=stamp, frame_id="laser"),
            angle_min=geometry.angle_min_rad,
            angle_increment=geometry.angle_increment_rad,
            range_min=geometry.range_min_m,
            range_max=geometry.range_max_m,
            ranges=self.laser.scan().ranges_m,
        )

    @property
    def states(self) -> list[str]:
        return [message.state for message in self.harness.take(NavigationState)]


@pytest.fixture
def robot() -> Iterator[Robot]:
    with ModuleHarness(Navigation) as harness:
        yield Robot(harness)


def test_robot_drives_to_a_goal_with_expiring_commands_and_a_path(robot: Robot) -> None:
    robot.go_on(0.5)
    assert set(robot.states) == {"IDLE"}
    assert not robot.harness.take(DriveCommand)
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(20.0)
    messages = robot.harness.take(NavigationState)
    states = list(dict.fromkeys(message.state for message in messages))
    assert states == ["DRIVE", "ALIGN", "ARRIVED"]
    left = [message.distance_left_m for message in messages if message.state == "DRIVE"]
    assert left[1] > 1.5 > left[-1] >= 0.0
    assert messages[-1].goal == GOAL.pose
    paths = robot.harness.take(PathMessage, "path")
    end = next(path for path in paths if path.poses).poses[-1].pose.position
    assert math.hypot(end.x - 3.5, end.y - 2.4) < 0.1
    truth = robot.drive.ground_truth().pose
    assert math.hypot(truth.x_m - 3.5, truth.y_m - 2.4) < 0.2
    assert truth.heading_rad == pytest.approx(1.0, abs=0.2)


def test_silent_laser_stops_the_robot_and_is_reported(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(2.0)
    assert robot.drive.read().linear_m_per_s > 0.2
    robot.has_laser = False
    robot.go_on(1.5)
    assert robot.drive.read().linear_m_per_s == 0.0
    last = robot.harness.take(NavigationState)[-1]
    assert last.state == "STOPPED_NO_LASER"
    assert last.reason.startswith("no scan for 0.")
    assert "laser is silent" in robot.harness.module.status


def test_navigation_waits_while_the_emergency_stop_is_engaged(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(0.5)
    stop = EmergencyStop(engaged=True, reason="somebody pressed the button")
    robot.harness.send(stop, topic="emergency_stop_state")
    robot.go_on(0.3)
    last = robot.harness.take(NavigationState)[-1]
    assert (last.state, last.reason) == ("EMERGENCY_STOP", "somebody pressed the button")
    robot.harness.send(EmergencyStop(), topic="emergency_stop_state")
    robot.go_on(0.3)
    assert robot.states[-1] == "DRIVE"


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        (PoseStamped(header=Header(frame_id="odom")), "must be given in the frame 'map', not 'odom'"),
        (PoseStamped(pose=pose_of(math.nan, 0.0, 0.0)), "must have finite coordinates"),
        (PoseStamped(pose=pose_of(50.0, 0.0, 0.0)), "the goal lies in unknown space"),
    ],
)
def test_impossible_goal_is_unreachable_with_its_reason(robot: Robot, goal: PoseStamped, reason: str) -> None:
    robot.go_on(0.3)
    robot.harness.send(goal, topic="goal")
    robot.go_on(0.5)
    last = robot.harness.take(NavigationState)[-1]
    assert last.state == "UNREACHABLE"
    assert reason in last.reason
    assert robot.drive.read().linear_m_per_s == 0.0


def test_restarted_navigation_continues_only_to_goals_not_yet_reached(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(1.0)
    kept = robot.harness.checkpoint
    with ModuleHarness(Navigation, restored=kept) as restarted:
        again = Robot(restarted)
        again.go_on(20.0)
        assert again.states[-1] == "ARRIVED"
        assert restarted.checkpoint is None


def test_cancelled_goal_is_forgotten_and_the_drive_stopped_at_once(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(2.0)
    assert robot.drive.read().linear_m_per_s > 0.2
    robot.harness.send(CancelGoal(reason="for a test"))
    (halt,) = robot.harness.take(DriveCommand)
    assert (halt.linear_m_per_s, halt.angular_rad_per_s) == (0.0, 0.0)
    last = robot.harness.take(NavigationState)[-1]
    assert (last.state, last.reason) == ("IDLE", "for a test")
    assert robot.harness.checkpoint is None
    robot.drive.command(0.0, 0.0, 0.3)
    robot.go_on(2.0)
    assert not robot.harness.take(DriveCommand)
    assert robot.drive.read().linear_m_per_s == 0.0


def test_goal_is_forgotten_when_time_jumps(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(0.5)
    robot.harness.send(TimeJump(reason="seek"))
    robot.go_on(0.5)
    assert robot.states[-1] == "IDLE"
    assert robot.harness.checkpoint is None
    assert robot.drive.read().linear_m_per_s == 0.0


def test_maximum_speed_can_be_changed_while_driving(robot: Robot) -> None:
    robot.harness.send(GOAL, topic="goal")
    robot.go_on(0.5)
    robot.harness.change_setting("max_linear_m_per_s", 0.1)
    robot.go_on(2.0)
    assert 0.05 < robot.drive.read().linear_m_per_s <= 0.1
