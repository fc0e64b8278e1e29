"""Nav2's behaviors, which move the robot by odometry under a guard."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from robbie_mp import Duration, Header, ModuleHarness, Time
from robbie_mp.messages import (
    CallRefusal,
    CancelNavigation,
    ControlState,
    DriveCommand,
    EmergencyStop,
    GoalEnd,
    LaserScan,
    NavigationCancelled,
    Odometry,
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
)
from robbie_robots.modules.navigation.nav2_behaviors import Nav2Behaviors
from robbie_robots.modules.navigation.nav2_types import (
    BackedUp,
    BackUp,
    DrivenOnHeading,
    DriveOnHeading,
    DrivingOnHeading,
    KiltedSpin,
    KiltedSpun,
    Spin,
    Spun,
    Wait,
    Waited,
    Waiting,
)

Harness = ModuleHarness[Nav2Behaviors]
FAR_M = 5.0


class World:
    """A robot whose drive follows the commands, and walls around it."""

    def __init__(self, nav2: Harness):
        self.nav2, self.x_m, self.heading_rad, self.wall_m = nav2, 0.0, 0.0, FAR_M
        self.is_stuck, self.late_ns = False, 0
        self.commands: list[DriveCommand] = []

    def tell(self) -> None:
        """Send odometry and a scan."""
        now = self.nav2.module.now()
        header = Header(stamp=Time.from_nanoseconds(now.nanoseconds - self.late_ns), frame_id="odom")
        turn = Quaternion(z=np.sin(self.heading_rad / 2), w=np.cos(self.heading_rad / 2))
        pose = PoseWithCovariance(pose=Pose(position=Point(x=self.x_m), orientation=turn))
        self.nav2.send(Odometry(header=header, pose=pose), topic="odom")
        ranges = np.full(181, self.wall_m, np.float32)
        scan = LaserScan(
            header=Header(stamp=now, frame_id="laser"),
            angle_min=-np.pi / 2,
            angle_max=np.pi / 2,
            angle_increment=np.pi / 180,
            range_min=0.05,
            range_max=10.0,
            ranges=ranges,
        )
        self.nav2.send(scan, topic="laser")

    def run(self, seconds: float) -> None:
        """Let time pass; the drive follows the newest command."""
        for _ in range(round(seconds / 0.05)):
            self.tell()
            self.nav2.advance(0.05)
            new = self.nav2.take(DriveCommand)
            self.commands += new
            if new and not self.is_stuck:
                self.x_m += 0.05 * new[-1].linear_m_per_s
                self.heading_rad += 0.05 * new[-1].angular_rad_per_s

    def begin(self, goal: Any) -> Any:
        """Send a goal, and let navigation stop."""
        sent = self.nav2.send_goal(goal)
        for one in self.nav2.take(CancelNavigation):
            self.nav2.reply(one, NavigationCancelled())
        return sent


@pytest.fixture
def world() -> Iterator[World]:
    with ModuleHarness(Nav2Behaviors) as harness:
        found = World(harness)
        found.run(0.2)
        yield found


def reason_of(world: World) -> str:
    (end,) = world.nav2.take(GoalEnd)
    return str(end.reason)


@pytest.mark.parametrize(("goal", "result"), [(Spin, Spun), (KiltedSpin, KiltedSpun)])
@pytest.mark.parametrize("angle_rad", [1.57, -4.0])
def test_robot_turns_by_the_angle(world: World, goal: Any, result: Any, angle_rad: float) -> None:
    world.begin(goal(target_yaw=angle_rad))
    world.run(9.0)
    assert world.heading_rad == pytest.approx(angle_rad, abs=0.08)
    assert world.nav2.take(result)
    assert all(one.valid_for.nanoseconds <= 300_000_000 for one in world.commands)
    assert not world.commands[-1].angular_rad_per_s


def test_robot_drives_straight_on_and_tells_how_far(world: World) -> None:
    world.begin(DriveOnHeading(target=Point(x=0.6), speed=0.2))
    world.run(6.0)
    assert world.x_m == pytest.approx(0.6, abs=0.05)
    assert world.nav2.take(DrivenOnHeading)[0].total_elapsed_time.nanoseconds > 2.9e9
    told = [one.distance_traveled for one in world.nav2.take(DrivingOnHeading)]
    assert told == sorted(told)
    assert told[-1] > 0.4
    assert max(one.linear_m_per_s for one in world.commands) <= 0.2 + 1e-6


def test_robot_backs_up_whatever_the_signs(world: World) -> None:
    world.begin(BackUp(target=Point(x=0.3), speed=0.1))
    world.run(6.0)
    assert world.x_m == pytest.approx(-0.3, abs=0.05)
    assert world.nav2.take(BackedUp)


def test_robot_waits_and_does_not_move(world: World) -> None:
    world.begin(Wait(time=Duration(sec=1)))
    world.run(0.5)
    assert 0 < world.nav2.take(Waiting)[-1].time_left.nanoseconds < 700_000_000
    world.run(0.7)
    assert world.nav2.take(Waited)
    assert not world.commands


def test_robot_stops_before_an_obstacle(world: World) -> None:
    world.begin(DriveOnHeading(target=Point(x=2.0), speed=0.3))
    world.run(1.0)
    assert world.x_m > 0.1
    world.wall_m = 0.27
    world.run(0.5)
    assert "COLLISION_AHEAD" in reason_of(world)
    assert not world.commands[-1].linear_m_per_s


@pytest.mark.parametrize(
    "goal",
    [
        BackUp(target=Point(x=2.0), speed=0.1),
        BackUp(target=Point(x=0.2), speed=0.0),
        DriveOnHeading(target=Point(x=0.2), speed=-0.1),
        DriveOnHeading(target=Point(x=0.2, y=0.1), speed=0.1),
        DriveOnHeading(target=Point(x=np.nan), speed=0.1),
        Spin(target_yaw=np.inf),
        KiltedSpin(target_yaw=1.0, disable_collision_checks=True),
    ],
)
def test_goal_that_cannot_be_is_refused(world: World, goal: Any) -> None:
    world.begin(goal)
    assert world.nav2.take(CallRefusal)
    world.run(0.3)
    assert not world.commands


def test_goal_ends_when_modules_may_not_drive_or_the_stop_is_engaged(world: World) -> None:
    hold = ControlState(mode=ControlState.HOLD, reason="somebody holds")
    stop = EmergencyStop(engaged=True, reason="a person")
    for message, topic in ((hold, "control"), (stop, "emergency_stop_state")):
        world.nav2.send(ControlState(mode=ControlState.AUTO), topic="control")
        world.begin(Spin(target_yaw=3.0))
        world.run(0.3)
        world.nav2.send(message, topic=topic)
        assert reason_of(world)
        assert not world.nav2.take(DriveCommand)[-1].angular_rad_per_s
    world.nav2.send(hold, topic="control")
    world.begin(Spin(target_yaw=3.0))
    assert "somebody holds" in world.nav2.take(CallRefusal)[0].reason


def test_robot_stands_until_navigation_has_stopped_and_gives_way_to_its_next_goal(world: World) -> None:
    world.nav2.send_goal(Spin(target_yaw=3.0))
    world.run(0.3)
    assert not world.commands
    for one in world.nav2.take(CancelNavigation):
        world.nav2.reply(one, NavigationCancelled())
    world.run(0.3)
    assert world.commands
    stamp = world.nav2.module.now()
    world.nav2.send(PoseStamped(header=Header(stamp=stamp, frame_id="map")), topic="goal")
    assert reason_of(world) == "navigation has got a goal"
    assert not world.nav2.take(DriveCommand)[-1].angular_rad_per_s


def test_goal_is_given_up_without_scans_and_when_its_time_is_over(world: World) -> None:
    world.begin(Spin(target_yaw=3.0))
    world.run(0.3)
    world.nav2.advance(0.5)
    assert not any(one.angular_rad_per_s for one in world.nav2.take(DriveCommand)[8:])
    world.nav2.advance(2.0)
    assert "has sent nothing lately" in reason_of(world)
    world.begin(DriveOnHeading(target=Point(x=2.0), speed=0.1, time_allowance=Duration(sec=1)))
    world.run(1.2)
    assert "TIMEOUT" in reason_of(world)


def test_newer_goal_takes_the_place_of_the_older_one(world: World) -> None:
    world.begin(Spin(target_yaw=3.0))
    world.begin(Wait(time=Duration(sec=1)))
    (end,) = world.nav2.take(GoalEnd)
    assert end.outcome == GoalEnd.PREEMPTED
    world.run(1.2)
    assert world.nav2.take(Waited)


@pytest.mark.parametrize(
    ("goal", "pose"),
    [
        (BackUp(target=Point(x=0.4), speed=0.1), Pose(position=Point(x=0.6))),
        (DriveOnHeading(target=Point(x=0.4), speed=0.1), Pose(position=Point(y=-0.6))),
        (Spin(target_yaw=1.0), Pose(orientation=Quaternion.from_yaw(-1.0))),
    ],
)
def test_goal_ends_when_odometry_jumps(world: World, goal: Any, pose: Pose) -> None:
    """A base that starts again counts from 0: the robot would drive further than it may."""
    world.begin(goal)
    world.run(0.3)
    header = Header(stamp=world.nav2.module.now(), frame_id="odom")
    world.nav2.send(Odometry(header=header, pose=PoseWithCovariance(pose=pose)), topic="odom")
    assert "odometry has jumped" in reason_of(world)
    last = world.nav2.take(DriveCommand)[-1]
    assert not last.linear_m_per_s
    assert not last.angular_rad_per_s
    world.run(0.3)
    world.begin(Spin(target_yaw=0.1))
    world.run(1.0)
    assert world.nav2.take(Spun)


@pytest.mark.parametrize("goal", [BackUp(target=Point(x=0.3), speed=0.2), Spin(target_yaw=1.0)])
def test_goal_ends_when_odometry_does_not_show_the_motion(world: World, goal: Any) -> None:
    """Its encoders may be dead, or its wheels: it would drive for ever, back without a laser."""
    world.begin(goal)
    world.is_stuck = True
    world.run(8.0)
    assert "odometry shows" in reason_of(world)
    told_m = 0.05 * sum(abs(one.linear_m_per_s) for one in world.commands)
    assert told_m < 0.95
    assert not world.commands[-1].linear_m_per_s
    assert not world.commands[-1].angular_rad_per_s


def test_robot_stands_while_odometry_is_old_and_gives_up_then(world: World) -> None:
    world.begin(DriveOnHeading(target=Point(x=2.0), speed=0.1))
    world.run(0.3)
    world.commands.clear()
    world.late_ns = 500_000_000
    world.run(1.0)
    assert not world.commands
    assert not world.nav2.take(GoalEnd)
    world.run(1.3)
    assert "has sent nothing lately" in reason_of(world)


@pytest.mark.parametrize("drives", [True, False])
def test_robot_stands_if_navigation_may_go_on(world: World, drives: bool) -> None:
    frame = "map" if drives else ""
    header = Header(stamp=world.nav2.module.now(), frame_id=frame)
    world.nav2.send(PoseStamped(header=header), topic="goal")
    world.nav2.advance(0.05)
    world.nav2.send_goal(Spin(target_yaw=1.0))
    assert world.nav2.take(CancelNavigation)
    world.run(1.5)
    if drives:
        assert "navigation" in reason_of(world)
        assert not any(one.angular_rad_per_s for one in world.commands)
    else:
        assert any(one.angular_rad_per_s for one in world.commands)


def test_goal_of_navigation_at_the_same_time_counts_as_newer(world: World) -> None:
    world.begin(Spin(target_yaw=3.0))
    header = Header(stamp=world.nav2.module.now(), frame_id="map")
    world.nav2.send(PoseStamped(header=header), topic="goal")
    assert reason_of(world) == "navigation has got a goal"


def test_goal_that_has_waited_long_is_refused(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its client may have given it up while this module was dead."""
    monkeypatch.setattr("robbie_robots.modules.devices.command_age.waiting_s", lambda _: 1.5)
    world.begin(Spin(target_yaw=1.0))
    assert "has waited" in world.nav2.take(CallRefusal)[0].reason
    world.begin(Wait(time=Duration(sec=1)))
    assert not world.nav2.take(CallRefusal)


def test_robot_stands_at_once_when_a_newer_goal_comes(world: World) -> None:
    world.begin(DriveOnHeading(target=Point(x=2.0), speed=0.2))
    world.run(0.5)
    world.begin(Wait(time=Duration(sec=1)))
    assert not world.nav2.take(DriveCommand)[-1].linear_m_per_s


def test_goal_ends_once_whatever_comes_at_its_end(world: World) -> None:
    sent = world.begin(Spin(target_yaw=0.2))
    world.run(2.0)
    assert len(world.nav2.take(Spun)) == 1
    world.nav2.send(EmergencyStop(engaged=True), topic="emergency_stop_state")
    world.nav2.send(ControlState(mode=ControlState.HOLD), topic="control")
    world.run(0.5)
    assert not world.nav2.take(GoalEnd)
    assert sent is not None


def test_goal_ends_when_the_module_was_stopped_for_long(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.begin(Spin(target_yaw=3.0))
    world.run(0.5)
    with monkeypatch.context() as stopped:
        stopped.setattr(world.nav2.module, "tick", lambda: None)
        world.run(3.0)
    world.commands.clear()
    world.run(0.1)
    assert "was stopped" in reason_of(world)
    assert not any(one.angular_rad_per_s for one in world.commands)


def test_next_process_does_not_go_on(world: World) -> None:
    world.begin(DriveOnHeading(target=Point(x=2.0), speed=0.2))
    world.run(0.5)
    with ModuleHarness(Nav2Behaviors) as again:
        other = World(again)
        other.run(1.0)
        assert not other.commands
