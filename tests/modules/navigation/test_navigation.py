"""The module of navigation in the demo arena, driven in a test's time."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from robbie_mp import CallRefused, EncodedMessage, Header, Message, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    CallRefusal,
    CancelNavigation,
    Costmap,
    DriveCommand,
    EmergencyStop,
    GoalEnd,
    IllFormed,
    LaserScan,
    MapAnnotations,
    MapMetaData,
    MappingState,
    NavigateTo,
    NavigationFeedback,
    NavigationResult,
    NoGoArea,
    OccupancyGrid,
    PathPlanned,
    PlanPath,
    Point,
    PointOfInterest,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
    TimeJump,
    Transform,
    TransformStamped,
    Vector3,
    as_dict,
    check_well_formed,
    decode_version,
    from_dict,
    message_type_from_schema,
    schema_text,
)
from robbie_mp.messages import Path as PathMessage
from robbie_mp.messages.stock.nav2_msgs import Cost
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose as Pose2D
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.random_rooms import drawn_map
from robbie_robots.modules.navigation.navigation import Navigation
from tests._support.places import ARENAS

ARENA = read_arena(ARENAS / "demo.yaml")
CELLS, CORNER = drawn_map(ARENA, 0.05)
STEP_S = 0.12
WALL, BEHIND_WALL = (0.5, 3.02), (0.6, 3.65)
"""In the wall to the left of the start, and in the room behind it; a door leads there."""


def pose_of(x_m: float, y_m: float, heading_rad: float) -> Pose:
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion.from_yaw(heading_rad))


GOAL = NavigateTo(pose=PoseStamped(header=Header(frame_id="map"), pose=pose_of(3.5, 2.4, 1.0)))
NEAR = NavigateTo(pose=PoseStamped(pose=pose_of(2.1, 2.4, 0.0)))


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
                self.send_scans(stamp)
            self.harness.advance(STEP_S)
            for command in self.harness.take(DriveCommand):
                self.drive.command(
                    command.linear_m_per_s, command.angular_rad_per_s, command.valid_for.nanoseconds / 1e9
                )

    def send_scans(self, stamp: Time) -> None:
        self.harness.send(self.scan(stamp, self.laser))

    def scan(self, stamp: Time, laser: SimulatedLaser, frame: str = "laser") -> LaserScan:
        laser.place(self.drive.ground_truth().pose, stamp.nanoseconds / 1e9)
        geometry = laser.geometry
        return LaserScan(
            header=Header(stamp=stamp, frame_id=frame),
            angle_min=geometry.angle_min_rad,
            angle_increment=geometry.angle_increment_rad,
            range_min=geometry.range_min_m,
            range_max=geometry.range_max_m,
            ranges=laser.scan().ranges_m,
        )

    def until_reached(self, client: str = "client") -> NavigationResult:
        """Let time pass until a client is told that the robot is at the goal."""
        for _ in range(20):
            self.go_on(1.0)
            results = self.harness.take(NavigationResult, client)
            if results:
                assert len(results) == 1
                return results[0]
        raise AssertionError(f"the goal was not reached in 20 s: {self.states}")

    @property
    def states(self) -> list[str]:
        return [feedback.state for feedback in self.harness.take(NavigationFeedback)]


class RobotWithTwoLasers(Robot):
    """Something stands close behind it that only its rear laser sees, and that is not on the map."""

    BEHIND_M = -0.45
    MOUNT = Pose2D(-0.175, 0.0, math.pi)

    def __init__(self, harness: ModuleHarness[Navigation]) -> None:
        super().__init__(harness)
        self.behind = ARENA.start.plus(Pose2D(self.BEHIND_M, 0.0, 0.0))
        there = replace(ARENA, circles=np.vstack([ARENA.circles, [self.behind.x_m, self.behind.y_m, 0.05]]))
        view = LaserGeometry(angle_min_rad=math.radians(-120), beams=241)
        self.laser = SimulatedLaser(there, view)
        self.rear_laser = SimulatedLaser(there, replace(view, mount=self.MOUNT))
        self.has_rear_laser = True

    def send_scans(self, stamp: Time) -> None:
        self.harness.send(self.scan(stamp, self.laser), topic="scan")
        if self.has_rear_laser:
            self.harness.send(self.scan(stamp, self.rear_laser, "rear_laser"), topic="rear_scan")

    def tell_mounts(self) -> None:
        mounts = [("laser", Pose2D(0.0, 0.0, 0.0)), ("rear_laser", self.MOUNT)]
        transforms = [
            TransformStamped(
                header=Header(frame_id="base_link"),
                child_frame_id=frame,
                transform=Transform(
                    translation=Vector3(x=mount.x_m, y=mount.y_m),
                    rotation=Quaternion.from_yaw(mount.heading_rad),
                ),
            )
            for frame, mount in mounts
        ]
        self.harness.send(TFMessage(transforms=transforms), topic="tf_static")


def test_robot_drives_slowly_while_mapping_knows_its_position_badly() -> None:
    fastest = []
    with ModuleHarness(Navigation) as harness:
        robot = Robot(harness)
        robot.go_on(0.5)
        harness.send_goal(GOAL)
        for spread_m in (0.1, 2.0, 0.1):
            harness.send(MappingState(certain=True, spread_m=spread_m))
            speeds = []
            for _ in range(8):
                before = robot.drive.ground_truth().pose
                robot.go_on(STEP_S)
                after = robot.drive.ground_truth().pose
                speeds.append(math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) / STEP_S)
            fastest.append(max(speeds[3:]))
        assert "slowly" not in harness.module.status
    assert fastest[0] > 0.3
    assert fastest[1] < 0.25
    assert fastest[2] > 0.3


def test_careful_robot_is_slow_in_reverse_too() -> None:
    with ModuleHarness(Navigation) as harness:
        harness.send(MappingState(certain=True, spread_m=2.0))
        assert harness.module._careful(-0.5, 0.5) == pytest.approx((-0.2, 0.2))


TWO_LASERS = {"scan_topic": "scan", "more_scan_topics": ["rear_scan"]}


def test_robot_avoids_and_passes_slowly_what_only_its_rear_laser_sees() -> None:
    costs, speeds = [], []
    for has_rear_laser in (True, False):
        with ModuleHarness(Navigation, TWO_LASERS) as harness:
            robot = RobotWithTwoLasers(harness)
            robot.tell_mounts()
            robot.has_rear_laser = has_rear_laser
            robot.go_on(0.5)
            harness.send_goal(GOAL)
            robot.go_on(0.6)
            costs.append(cost_at(harness.take(Costmap, "costmap")[-1], robot.behind.x_m, robot.behind.y_m))
            speeds.append(robot.drive.read().linear_m_per_s)
            assert ("no fresh scan of rear_scan" in harness.module.status) is not has_rear_laser
    assert costs[0] >= Cost.TOO_NEAR > costs[1]
    assert 0.0 < speeds[0] < speeds[1]


def test_scan_of_a_laser_whose_place_is_unknown_is_not_used() -> None:
    with ModuleHarness(Navigation, TWO_LASERS) as harness:
        robot = RobotWithTwoLasers(harness)
        robot.go_on(0.5)
        assert harness.module.navigator is not None
        assert harness.module.navigator.silent == ["rear_scan"]
        robot.tell_mounts()
        robot.go_on(0.5)
        assert harness.module.navigator.silent == []
        robot.has_rear_laser = False
        robot.go_on(1.0)
        assert harness.module.navigator.silent == ["rear_scan"]


@pytest.mark.parametrize(
    "topics",
    [
        {"more_scan_topics": ["rear_scan"]},
        {"scan_topic": "scan", "more_scan_topics": ["scan"]},
        {"scan_topic": "scan", "more_scan_topics": [""]},
    ],
)
def test_lasers_that_the_topics_do_not_tell_apart_are_refused(topics: dict[str, object]) -> None:
    with (
        pytest.raises(SettingError, match="each laser needs a topic of its own"),
        ModuleHarness(Navigation, topics),
    ):
        pass


@pytest.fixture
def robot() -> Iterator[Robot]:
    with ModuleHarness(Navigation) as harness:
        yield Robot(harness)


def test_robot_drives_to_a_goal_with_expiring_commands_and_a_path(robot: Robot) -> None:
    robot.go_on(0.5)
    assert robot.harness.module.navigator is not None
    assert not robot.harness.take(DriveCommand)
    robot.harness.send_goal(GOAL)
    result = robot.until_reached()
    feedbacks = robot.harness.take(NavigationFeedback)
    assert list(dict.fromkeys(feedback.state for feedback in feedbacks)) == ["DRIVE", "ALIGN"]
    left = [feedback.distance_left_m for feedback in feedbacks if feedback.state == "DRIVE"]
    assert left[1] > 1.5 > left[-1] >= 0.0
    assert 3.0 < result.duration_s < 20.0
    shown, ended = robot.harness.take(PoseStamped, "goal")
    assert shown.pose == GOAL.pose.pose
    assert (shown.header.frame_id, ended.header.frame_id) == ("map", "")  # there is none any more
    paths = robot.harness.take(PathMessage, "path")
    end = next(path for path in paths if path.poses).poses[-1].pose.position
    assert math.hypot(end.x - 3.5, end.y - 2.4) < 0.1
    costmap = robot.harness.take(Costmap, "costmap")[-1]
    assert cost_at(costmap, end.x, end.y) <= Cost.AVOIDED
    assert cost_at(costmap, 2.5, 0.05) == Cost.OBSTACLE
    assert cost_at(costmap, 2.5, 0.4) == Cost.TOO_NEAR
    truth = robot.drive.ground_truth().pose
    assert math.hypot(truth.x_m - 3.5, truth.y_m - 2.4) < 0.2
    assert truth.heading_rad == pytest.approx(1.0, abs=0.2)


def cost_at(costmap: Costmap, x_m: float, y_m: float) -> int:
    """Return what it costs to be at a place, m, map frame."""
    corner, info = costmap.metadata.origin.position, costmap.metadata
    column, row = (int((at - begin) // info.resolution) for at, begin in ((x_m, corner.x), (y_m, corner.y)))
    return int(costmap.data[row * info.size_x + column])


def test_silent_laser_stops_the_robot_and_is_told(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.go_on(2.0)
    assert robot.drive.read().linear_m_per_s > 0.2
    robot.has_laser = False
    robot.go_on(1.5)
    assert robot.drive.read().linear_m_per_s == 0.0
    last = robot.harness.take(NavigationFeedback)[-1]
    assert last.state == "STOPPED_NO_LASER"
    assert last.reason.startswith("no scan for 0.")
    assert "laser is silent" in robot.harness.module.status


def test_goal_waits_for_the_first_scan(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.has_laser = False
    robot.go_on(0.5)
    (told,) = robot.harness.take(NavigationFeedback)
    assert (told.state, told.reason) == ("STOPPED_NO_LASER", "no scan has arrived yet")
    robot.has_laser = True
    robot.go_on(0.5)
    assert robot.states[-1] == "DRIVE"


def test_navigation_waits_while_the_emergency_stop_is_engaged(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.go_on(0.5)
    stop = EmergencyStop(engaged=True, reason="somebody pressed the button")
    robot.harness.send(stop, topic="emergency_stop_state")
    robot.go_on(0.3)
    last = robot.harness.take(NavigationFeedback)[-1]
    assert (last.state, last.reason) == ("EMERGENCY_STOP", "somebody pressed the button")
    robot.harness.send(EmergencyStop(), topic="emergency_stop_state")
    robot.go_on(0.3)
    assert robot.states[-1] == "DRIVE"


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (PoseStamped(header=Header(frame_id="odom")), "must be given in the frame 'map', not 'odom'"),
        (PoseStamped(pose=pose_of(math.nan, 0.0, 0.0)), "expected a finite number"),
    ],
)
def test_invalid_goal_is_refused_and_the_robot_keeps_its_goal(
    robot: Robot, pose: PoseStamped, reason: str
) -> None:
    robot.harness.send_goal(NEAR)
    robot.go_on(0.5)
    kept = robot.harness.checkpoint
    robot.harness.send_goal(NavigateTo(pose=pose), client="other")
    (refusal,) = robot.harness.take(CallRefusal, "other")
    assert reason in refusal.reason
    assert robot.harness.checkpoint == kept
    robot.until_reached()


def test_goal_that_cannot_be_reached_ends_with_the_reason(robot: Robot) -> None:
    robot.go_on(0.3)
    robot.harness.send_goal(NavigateTo(pose=PoseStamped(pose=pose_of(50.0, 0.0, 0.0))))
    robot.go_on(0.5)
    (end,) = robot.harness.take(GoalEnd)
    assert (end.outcome, end.reason) == (GoalEnd.ABORTED, "the goal lies in unknown space")
    assert robot.harness.checkpoint is None
    assert robot.drive.read().linear_m_per_s == 0.0


def test_newer_goal_takes_the_place_of_the_older_one(robot: Robot) -> None:
    robot.harness.send_goal(GOAL, client="mission")
    robot.go_on(1.0)
    robot.harness.send_goal(NEAR, client="operator")
    (end,) = robot.harness.take(GoalEnd, "mission")
    assert (end.outcome, end.reason) == (GoalEnd.PREEMPTED, "operator has sent another goal")
    robot.until_reached("operator")
    assert not robot.harness.take(NavigationResult)


def test_restarted_navigation_continues_only_to_goals_not_yet_reached(robot: Robot) -> None:
    sent = robot.harness.send_goal(NEAR)
    robot.go_on(1.0)
    kept = robot.harness.checkpoint
    with ModuleHarness(Navigation, restored=kept) as restarted:
        again = Robot(restarted)
        assert again.until_reached().call == sent.call
        assert restarted.checkpoint is None


def test_navigation_whose_newest_checkpoint_was_damaged_drives_to_no_older_goal(robot: Robot) -> None:
    robot.harness.send_goal(NEAR)
    kept = robot.harness.checkpoint
    with ModuleHarness(Navigation, restored=kept, checkpoint_lost=True) as restarted:
        again = Robot(restarted)
        again.go_on(1.0)
        assert again.drive.read().linear_m_per_s == 0.0
        assert not restarted.take(DriveCommand)


def test_cancelled_goal_is_forgotten_and_the_drive_stopped_at_once(robot: Robot) -> None:
    sent = robot.harness.send_goal(GOAL)
    robot.go_on(2.0)
    assert robot.drive.read().linear_m_per_s > 0.2
    robot.harness.cancel_goal(sent, "for a test")
    robot_stands_without_a_goal(robot)
    (end,) = robot.harness.take(GoalEnd)
    assert (end.outcome, end.reason) == (GoalEnd.CANCELLED, "for a test")


@pytest.mark.parametrize("meant", ["", "mission"])
def test_goal_of_any_client_can_be_cancelled(robot: Robot, meant: str) -> None:
    robot.harness.send_goal(GOAL, client="mission")
    robot.go_on(2.0)
    assert robot.harness.call(CancelNavigation(client="operator")).client == ""
    assert not robot.harness.take(GoalEnd)
    assert robot.harness.call(CancelNavigation(client=meant, reason="for a test")).client == "mission"
    robot_stands_without_a_goal(robot)
    (end,) = robot.harness.take(GoalEnd, "mission")
    assert (end.outcome, end.reason) == (GoalEnd.CANCELLED, "for a test")
    assert robot.harness.call(CancelNavigation()).client == ""


def robot_stands_without_a_goal(robot: Robot) -> None:
    (halt,) = robot.harness.take(DriveCommand)
    assert (halt.linear_m_per_s, halt.angular_rad_per_s) == (0.0, 0.0)
    assert robot.harness.checkpoint is None
    robot.drive.command(0.0, 0.0, 0.3)
    robot.go_on(2.0)
    assert not robot.harness.take(DriveCommand)
    assert robot.drive.read().linear_m_per_s == 0.0


def test_goal_ends_when_time_jumps(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.go_on(0.5)
    robot.harness.send(TimeJump(reason="seek"))
    (end,) = robot.harness.take(GoalEnd)
    assert (end.outcome, end.reason) == (GoalEnd.ABORTED, "time jumped: seek")
    robot.go_on(0.5)
    assert robot.harness.checkpoint is None
    assert robot.drive.read().linear_m_per_s == 0.0


def checkpoint_when(
    harness: ModuleHarness[Navigation], ended: type[GoalEnd | NavigationResult]
) -> list[object]:
    """What a new process finds if this one dies right after it has said that the goal has ended."""
    kept: list[object] = []
    publish = harness.bus.publish

    def noting(message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        if isinstance(message, ended):
            kept.append(harness.checkpoint)
        return publish(message, topic, latched)

    harness.bus.publish = noting  # type: ignore[method-assign]
    return kept


@pytest.mark.parametrize("outcome", ["reached", "cancelled", "preempted"])
def test_goal_whose_end_was_told_does_not_come_back_after_a_crash(robot: Robot, outcome: str) -> None:
    sent = robot.harness.send_goal(NEAR)
    robot.go_on(0.5)
    kept = checkpoint_when(robot.harness, NavigationResult if outcome == "reached" else GoalEnd)
    if outcome == "reached":
        robot.until_reached()
        assert kept == [None]
    elif outcome == "cancelled":
        robot.harness.cancel_goal(sent)
        assert kept == [None]
    else:
        robot.harness.send_goal(GOAL, client="operator")
        assert kept == [robot.harness.checkpoint]
        with ModuleHarness(Navigation, restored=robot.harness.checkpoint) as restarted:
            assert restarted.module.active is not None
            assert restarted.module.active.client == "operator"


def test_maximum_speed_can_be_changed_while_driving(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.go_on(0.5)
    robot.harness.change_setting("max_linear_m_per_s", 0.1)
    robot.go_on(2.0)
    assert 0.05 < robot.drive.read().linear_m_per_s <= 0.1


def area(*corners: tuple[float, float]) -> NoGoArea:
    return NoGoArea(name="wet floor", corners=[Point(x=x, y=y) for x, y in corners])


def test_robot_drives_around_a_no_go_area_that_is_drawn_across_its_path(robot: Robot) -> None:
    robot.harness.send_goal(GOAL)
    robot.go_on(1.0)
    start = robot.drive.ground_truth().pose
    assert start.x_m < 1.9
    low, high = (2.2, 1.9), (2.7, 2.9)
    planned = [pose.pose.position for path in robot.harness.take(PathMessage, "path") for pose in path.poses]
    assert any(low[0] < at.x < high[0] and low[1] < at.y < high[1] for at in planned)
    wet = area(low, (high[0], low[1]), high, (low[0], high[1]))
    robot.harness.send(MapAnnotations(no_go=[wet]))
    for _ in range(300):
        robot.go_on(STEP_S)
        at = robot.drive.ground_truth().pose
        assert not (low[0] < at.x_m < high[0] and low[1] < at.y_m < high[1])
        if robot.harness.take(NavigationResult):
            break
    assert math.hypot(at.x_m - 3.5, at.y_m - 2.4) < 0.2


def test_goal_in_a_no_go_area_and_a_robot_in_one_are_told(robot: Robot) -> None:
    robot.go_on(0.3)
    robot.harness.send(MapAnnotations(no_go=[area((3.0, 2.0), (4.0, 2.0), (4.0, 3.0), (3.0, 3.0))]))
    robot.harness.send_goal(GOAL)
    robot.go_on(0.5)
    (end,) = robot.harness.take(GoalEnd)
    assert (end.outcome, end.reason) == (GoalEnd.ABORTED, "the goal lies in a no-go area")
    at = robot.drive.ground_truth().pose
    around = [(at.x_m + x, at.y_m + y) for x, y in ((-0.4, -0.4), (0.4, -0.4), (0.0, 0.4))]
    robot.harness.send(MapAnnotations(no_go=[area(*around)]))
    robot.harness.send_goal(GOAL)
    robot.go_on(0.5)
    (end,) = robot.harness.take(GoalEnd)
    assert "the robot stands in a no-go area" in end.reason
    robot.harness.send(MapAnnotations())
    robot.harness.send_goal(NEAR)
    robot.until_reached()


def test_robot_drives_to_a_place_by_its_name_also_after_a_restart(robot: Robot) -> None:
    robot.harness.send_goal(NavigateTo(place="kitchen"))
    (refusal,) = robot.harness.take(CallRefusal)
    assert refusal.reason == "no place on the map is called 'kitchen'; there are: none"
    places = [PointOfInterest(name="kitchen", pose=NEAR.pose.pose)]
    robot.harness.send(MapAnnotations(places=places))
    sent = robot.harness.send_goal(NavigateTo(place="kitchen"))
    robot.go_on(0.5)
    with ModuleHarness(Navigation, restored=robot.harness.checkpoint) as restarted:
        again = Robot(restarted)
        assert again.until_reached().call == sent.call
        at = again.drive.ground_truth().pose
        assert math.hypot(at.x_m - 2.1, at.y_m - 2.4) < 0.3


def test_goal_of_version_1_is_read_as_a_pose() -> None:
    now = schema_text(NavigateTo)
    before = now.replace("string place\n", "")
    assert before != now
    old = message_type_from_schema(NavigateTo.type_name, before, 1)
    written = from_dict(old, {name: value for name, value in as_dict(GOAL).items() if name != "place"})
    assert decode_version(NavigateTo, written.encode(), 1, before) == GOAL


def planned(robot: Robot, x_m: float, y_m: float, seen_from: list[Point]) -> PathPlanned:
    """Ask for the path to a place."""
    place = PoseStamped(header=Header(frame_id="map"), pose=pose_of(x_m, y_m, 0.0))
    return robot.harness.call(PlanPath(pose=place, seen_from=seen_from))


def test_path_is_planned_and_not_driven(robot: Robot) -> None:
    with pytest.raises(CallRefused, match="no scan has arrived yet"):
        planned(robot, 3.5, 2.4, [])
    robot.go_on(1.0)
    begin = robot.drive.ground_truth().pose
    found = [(one.pose.position.x, one.pose.position.y) for one in planned(robot, 3.5, 2.4, []).path.poses]
    assert math.dist(found[0], begin[:2]) < 0.1
    assert math.dist(found[-1], (3.5, 2.4)) < 0.1
    assert max(math.dist(a, b) for a, b in itertools.pairwise(found)) < 0.1
    robot.go_on(2.0)
    assert robot.drive.ground_truth().pose == begin
    assert robot.harness.take(DriveCommand) == []
    assert not any(path.poses for path in robot.harness.take(PathMessage))


def test_path_is_refused_with_the_reason(robot: Robot) -> None:
    robot.go_on(1.0)
    for x_m, y_m, reason in ((-3.0, 0.0, "unknown"), (WALL[0], WALL[1], "in or too near to an obstacle")):
        with pytest.raises(CallRefused, match=reason):
            planned(robot, x_m, y_m, [])
    robot.has_laser = False
    robot.go_on(1.0)
    with pytest.raises(CallRefused, match=r"no scan for [0-9.]+ s"):
        planned(robot, 3.5, 2.4, [])


def test_goal_that_a_camera_cannot_have_seen_is_refused(robot: Robot) -> None:
    robot.go_on(1.0)
    x_m, y_m, _ = robot.drive.ground_truth().pose
    eye = [Point(x=x_m, y=y_m)]
    assert planned(robot, x_m + 1.0, y_m, eye).path.poses
    assert planned(robot, *BEHIND_WALL, []).path.poses
    with pytest.raises(CallRefused, match="stands before the goal"):
        planned(robot, *BEHIND_WALL, eye)
    far = [Point(x=9e5, y=9e5)]
    with pytest.raises(CallRefused, match="stands before the goal"):
        planned(robot, *BEHIND_WALL, far)


def test_goal_that_two_places_have_seen_is_ill_formed() -> None:
    with pytest.raises(IllFormed, match="seen_from"):
        check_well_formed(PlanPath(seen_from=[Point(), Point()]))
