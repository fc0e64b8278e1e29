"""The module of the mission turns messages into goals and directions, and writes a report at the end."""

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture

from robbie_mp import (
    Array,
    CallError,
    CallRefused,
    Duration,
    GoalAborted,
    GoalCancelled,
    GoalPreempted,
    Header,
    Message,
    ModuleHarness,
    SettingError,
    uint8,
)
from robbie_mp.messages import (
    BatteryState,
    Bumper,
    CameraInfo,
    CancelNavigation,
    ControlState,
    DeviceState,
    Frontiers,
    MapMetaData,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
    OccupancyGrid,
    PanTiltCommand,
    Point,
    PointsOfInterest,
    Pose,
    PoseStamped,
    Quaternion,
    SetControl,
    decode_version,
    replace,
    schema_text,
)
from robbie_robots.modules.navigation.navigation import Navigation
from robbie_robots.modules.rescue.messages import (
    MissionResult,
    MissionStatus,
    OrderMission,
    SearchedWalls,
    VictimFound,
)
from robbie_robots.modules.rescue.mission import RescueMission
from robbie_robots.modules.rescue.team_messages import GoalClaim, MapAlignment
from robbie_robots.workers.exploration.frontiers import find_frontiers
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.rescue.mission_states import MissionState
from robbie_robots.workers.rescue.searched_walls import WallFronts, WallMemory
from robbie_robots.workers.rescue.victim_map import VictimState
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells

HALL = """
################
#..............#
#..............#
#..............#
#..............#
#..............#
################
"""
CELLS = drawn_cells(HALL)
FRONTS = WallFronts(CELLS, RESOLUTION_M, (0.0, 0.0))
INFO = MapMetaData(resolution=RESOLUTION_M, width=CELLS.shape[1], height=CELLS.shape[0])
START = (1.0, 0.8, 0.5)


class Robot:
    """The messages of the module's robot. Navigation reaches each goal at once."""

    def __init__(self, harness: ModuleHarness[RescueMission]) -> None:
        self.harness = harness
        self.pose = START
        self.searched = WallMemory()
        self.navigates = True
        self.cells = CELLS

    def go_on(self, seconds: float) -> list[NavigateTo]:
        """Let time pass; return the goals that came."""
        goals = []
        for _ in range(round(seconds / 0.5)):
            if self.harness.module.stop_requested:
                break
            self.tell()
            self.harness.advance(0.5)
            for goal in self.harness.take(NavigateTo):
                goals.append(goal)
                if self.navigates:
                    place = goal.pose.pose
                    self.pose = (place.position.x, place.position.y, place.orientation.yaw)
                    self.searched.look(FRONTS, self.pose, 0.7)
                    self.harness.end_goal(goal, NavigationResult())
        return goals

    def order(self, order: int) -> str:
        """Give an order; return the mission's state then."""
        return self.harness.call(OrderMission(order=order)).state

    def tell(self) -> None:
        x, y, heading = self.pose
        pose = Pose(position=Point(x=x, y=y), orientation=Quaternion.from_yaw(heading))
        self.harness.send(OccupancyGrid(info=INFO, data=self.cells.ravel()))
        self.harness.send(PoseStamped(pose=pose), topic="map_pose")
        self.harness.send(CameraInfo(), topic="camera")
        self.harness.send(SearchedWalls(info=INFO, data=self.searched.grid(FRONTS).ravel()))

    def feed_back(self, goal: NavigateTo, state: str, reason: str = "") -> None:
        self.harness.feed_back(goal, NavigationFeedback(state=state, reason=reason))

    def cancels(self) -> list[CancelNavigation]:
        return self.harness.take(CancelNavigation)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with ModuleHarness(RescueMission, output_directory=tmp_path) as harness:
        yield Robot(harness)


def test_whole_mission_ends_at_home_and_writes_its_report(robot: Robot, tmp_path: Path) -> None:
    robot.go_on(2.0)
    place = Pose(position=Point(x=3.75, y=0.9, z=0.35), orientation=Quaternion.from_yaw(math.pi))
    for number, state in ((7, VictimFound.CONFIRMED), (8, VictimFound.REJECTED)):
        robot.harness.send(VictimFound(id=number, name=f"tag {number}", pose=place, state=state))
    robot.harness.send(BatteryState(percentage=0.8), topic="battery")
    (home,) = robot.harness.take(PointsOfInterest, "mission")[-1].points
    assert (home.name, home.pose.position) == ("home", Point(x=START[0], y=START[1]))
    robot.harness.send(Bumper(pressed=["front_left"]), topic="bumper")
    robot.harness.send(Bumper(pressed=["front_left", "front_right"]), topic="bumper")
    robot.harness.send(Bumper(), topic="bumper")
    robot.harness.send(Bumper(pressed=["rear_left"]), topic="bumper")
    robot.go_on(300.0)
    assert robot.harness.module.stop_requested
    (result,) = robot.harness.take(MissionResult)
    assert (result.reason, result.confirmed, result.unconfirmed, result.collisions) == ("is home", 1, 0, 2)
    assert result.battery == pytest.approx(0.8)
    assert 0.0 < result.used_s < result.limit_s
    assert result.mapped_m2 > 1.0
    assert 0.0 < result.searched <= 1.0
    assert robot.pose[:2] == pytest.approx(START[:2])
    robot.harness.module.teardown()
    figures = json.loads((tmp_path / "mission.json").read_text())
    assert (figures["state"], figures["reason"]) == ("DONE", "is home")
    assert figures["battery"] == pytest.approx(0.8)
    assert figures["travelled_m"] > 1.0
    assert figures["mapped_m2"] == pytest.approx(CELLS.size * RESOLUTION_M**2)
    with (tmp_path / "rescue_victims.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["id"], row["x"], row["y"], row["z"]) == ("7", "3.750", "0.900", "0.350")
    picture = np.asarray(Picture.open(tmp_path / "rescue_map.png"))
    for colour in ((0, 40, 120), (240, 10, 10), (120, 0, 140), (255, 200, 0)):  # walls, victim, path, start
        assert (picture == colour).all(axis=-1).any()


def test_camera_looks_around_while_driving_and_at_the_wall_to_search(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.0)
    goals = robot.go_on(4.0)
    module = robot.harness.module
    about = present(module.mission.step().look_at_xy_m)
    x, y, heading = robot.pose
    expected = math.remainder(math.atan2(about[1] - y, about[0] - x) - heading, math.tau)
    assert robot.harness.take(PanTiltCommand)[-1].pan_rad == pytest.approx(expected)
    assert not goals or goals[0].pose.header.frame_id == "map"


@pytest.mark.parametrize("end", [GoalPreempted("by operator"), GoalCancelled("by operator"), "died"])
def test_goal_that_is_lost_is_sent_again(robot: Robot, end: CallError | str) -> None:
    robot.navigates = False
    (first, *_) = robot.go_on(1.5)
    if isinstance(end, CallError):
        robot.harness.end_goal(first, end)
    else:
        robot.harness.kill_server()
    (again,) = robot.go_on(4.0)
    assert again.pose.pose == first.pose.pose
    robot.feed_back(again, "DRIVE")
    assert robot.go_on(4.0) == []


def test_goal_that_cannot_be_reached_is_not_sent_again(robot: Robot) -> None:
    robot.navigates = False
    (first, *_) = robot.go_on(1.5)
    robot.harness.end_goal(first, GoalAborted("no path leads to the goal"))
    later = robot.go_on(4.0)
    assert later
    assert first.pose.pose not in [goal.pose.pose for goal in later]


def test_end_of_an_earlier_goal_is_ignored(robot: Robot) -> None:
    robot.navigates = False
    (first, *_) = robot.go_on(1.5)
    robot.order(OrderMission.RETURN)
    robot.pose = (2.0, 1.0, 0.0)
    goals = robot.go_on(1.0)
    robot.pose = START
    robot.tell()
    robot.harness.end_goal(first, NavigationResult())
    assert robot.harness.module.mission.state.name == "RETURN"
    robot.harness.end_goal(goals[-1], NavigationResult())
    assert robot.harness.module.mission.state.name in ("DONE", "FAILED")


def test_mission_without_navigation_halts_and_goes_on_when_it_is_back(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.harness.remove_server()
    robot.go_on(3.0)
    assert robot.harness.module.mission.state is MissionState.HALT
    assert "serves it no longer" in robot.harness.module.status
    robot.harness.bus.peers.has_server = True
    stand = robot.go_on(3.0)[-1]
    robot.feed_back(stand, "ALIGN")
    robot.go_on(0.5)
    assert robot.harness.module.mission.state in (MissionState.EXPLORE, MissionState.SEARCH)


def test_mission_finds_a_path_wherever_navigation_does(robot: Robot) -> None:
    with ModuleHarness(Navigation) as navigation:
        assert robot.harness.module.mission.settings.clearance_m == navigation.module.clearance_m


def test_silent_laser_stops_the_robot_and_is_in_the_report(
    robot: Robot, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    robot.navigates = False
    goals = robot.go_on(1.5)
    robot.feed_back(goals[-1], "STOPPED_NO_LASER", "the laser is silent for 0.7 s")
    (stand,) = robot.go_on(1.5)
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warnings == ["stopped: STOPPED_NO_LASER: the laser is silent for 0.7 s"]
    place = stand.pose.pose.position
    assert (place.x, place.y) == START[:2]
    robot.harness.module.teardown()
    notes = json.loads((tmp_path / "mission.json").read_text())["notes"]
    assert notes == ["stopped: STOPPED_NO_LASER: the laser is silent for 0.7 s"]


def test_mission_tells_at_once_which_device_is_away_and_reports_it(tmp_path: Path) -> None:
    with ModuleHarness(RescueMission, {"devices": ["base", "laser"]}, output_directory=tmp_path) as harness:
        robot = Robot(harness)

        def texts(topic: str, state: str) -> list[str]:
            harness.take(MissionStatus)
            harness.send(DeviceState(state=state), topic=topic)
            harness.advance(0.2)
            return [status.text for status in harness.take(MissionStatus)]

        robot.go_on(1.5)
        for topic in ("base", "laser"):
            texts(topic, "DISCONNECTED")  # it has not been connected yet
            texts(topic, "CONNECTED")
        assert "DISCONNECTED" not in harness.module.mission.status
        assert texts("base", "DISCONNECTED")[0].endswith("DISCONNECTED: base")
        assert texts("laser", "DISCONNECTED")[0].endswith("DISCONNECTED: base, laser")
        assert texts("base", "CONNECTED")[0].endswith("DISCONNECTED: laser")
        assert "DISCONNECTED" not in texts("laser", "CONNECTED")[0]
        texts("laser", "DISCONNECTED")
        harness.module.teardown()
    notes = json.loads((tmp_path / "mission.json").read_text())["notes"]
    assert [note for note in notes if "disconnected" in note] == [
        "base was disconnected",
        "laser was disconnected",
    ]


def test_robot_that_cannot_even_stand_where_it_is_goes_on_when_it_can_drive(robot: Robot) -> None:
    robot.navigates = False
    goals = robot.go_on(1.5)
    robot.feed_back(goals[-1], "EMERGENCY_STOP", "somebody pressed the button")
    (stand,) = robot.go_on(1.0)
    robot.harness.end_goal(stand, GoalAborted("the robot is not near any drivable place"))
    assert robot.go_on(3.0)
    assert robot.harness.module.mission.state is not MissionState.HALT


def test_pause_stops_the_robot_at_once_and_publishes_the_accepted_orders(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.harness.take(MissionStatus)
    assert robot.order(OrderMission.PAUSE) == "PAUSE"
    (cancel,) = robot.cancels()
    assert cancel.client == robot.harness.module.name
    (status,) = robot.harness.take(MissionStatus)
    assert status.state == "PAUSE"
    assert status.orders.tolist() == [OrderMission.START, OrderMission.ABORT, OrderMission.RETURN]
    assert status.text.startswith("stands, until the operator resumes (ordered by the operator)")


def test_paused_robot_can_be_driven_elsewhere_and_continues_from_there(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.order(OrderMission.PAUSE)
    (cancel,) = robot.cancels()
    robot.harness.reply(cancel, NavigationCancelled(client="module"))
    robot.pose = (2.0, 1.0, 0.0)
    assert robot.go_on(5.0) == []
    assert robot.cancels() == []
    robot.order(OrderMission.START)
    assert robot.harness.take(NavigateTo)


@pytest.mark.parametrize("fails", ["died", "silent"])
def test_cancel_is_repeated_until_navigation_has_confirmed_it(robot: Robot, fails: str) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.order(OrderMission.PAUSE)
    robot.cancels()
    if fails == "died":
        robot.harness.kill_server()
    robot.go_on(3.0)
    (cancel,) = robot.cancels()
    robot.harness.reply(cancel, NavigationCancelled())
    robot.go_on(5.0)
    assert robot.cancels() == []


def test_mission_resumed_after_a_short_pause_sends_its_goal_again(robot: Robot) -> None:
    robot.navigates = False
    (goal, *_) = robot.go_on(1.5)
    for order in (OrderMission.PAUSE, OrderMission.START):
        robot.order(order)
    (again,) = robot.harness.take(NavigateTo)
    assert again.pose.pose == goal.pose.pose


def test_refused_order_is_logged_and_told_to_the_operator(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    robot.go_on(1.5)
    with pytest.raises(CallRefused, match="START: the mission is under way"):
        robot.order(OrderMission.START)
    (warning,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warning.endswith("START: the mission is under way")
    assert robot.order(OrderMission.PAUSE) == "PAUSE"


def test_status_of_an_old_log_is_read_without_its_refusal() -> None:
    class OldStatus(Message, name="rescue_msgs/msg/OldStatus", version=1):
        header: Header
        state: str
        text: str
        orders: Array[uint8]
        refusal: str

    orders = np.array([2], np.uint8)
    old = OldStatus(header=Header(), state="PAUSE", text="stands", orders=orders, refusal="no")
    read = decode_version(MissionStatus, old.encode(), 1, schema_text(OldStatus))
    assert (read.state, read.text, read.orders.tolist()) == ("PAUSE", "stands", [2])


def test_aborted_mission_ends_and_writes_its_report(robot: Robot, tmp_path: Path) -> None:
    robot.go_on(1.5)
    assert robot.order(OrderMission.ABORT) == "ABORTED"
    robot.go_on(2.0)
    assert robot.harness.module.stop_requested
    figures = json.loads((tmp_path / "mission.json").read_text())
    assert (figures["state"], figures["reason"]) == ("ABORTED", "aborted by the operator")


def test_mission_that_keeps_the_run_lets_the_operator_start_another_one(tmp_path: Path) -> None:
    with ModuleHarness(RescueMission, {"goes_on": True}, output_directory=tmp_path) as harness:
        robot = Robot(harness)
        robot.go_on(1.5)
        robot.order(OrderMission.ABORT)
        robot.go_on(5.0)
        assert not harness.module.stop_requested
        (result,) = harness.take(MissionResult)
        assert (result.state, sorted(result.files)) == (
            "ABORTED",
            ["mission.json", "rescue_map.png", "rescue_victims.csv"],
        )
        assert harness.take(MissionStatus)[-1].orders.tolist() == [OrderMission.START, OrderMission.RETURN]
        harness.send(ControlState(mode=ControlState.HOLD), topic="control")
        robot.order(OrderMission.START)
        (control,) = harness.take(SetControl)
        assert control.mode == ControlState.AUTO
        harness.send(ControlState(mode=ControlState.AUTO), topic="control")
        while not (results := harness.take(MissionResult)):
            robot.go_on(5.0)
        (second,) = results
        assert (second.state, second.reason) == ("DONE", "is home")
        assert all((tmp_path / name).is_file() for name in ("mission.json", "mission_2.json", *second.files))
        assert json.loads((tmp_path / "mission.json").read_text())["state"] == "ABORTED"


def test_pause_outlives_a_restart(robot: Robot) -> None:
    robot.go_on(1.5)
    robot.order(OrderMission.PAUSE)
    with ModuleHarness(RescueMission, restored=robot.harness.checkpoint) as again:
        restarted = Robot(again)
        restarted.pose = robot.pose
        assert restarted.go_on(1.0) == []
        (cancel,) = restarted.cancels()
        assert cancel.client == again.module.name
        assert again.take(MissionStatus)[-1].state == "PAUSE"


def test_frontiers_are_published(robot: Robot) -> None:
    robot.cells = CELLS.copy()
    robot.cells[:, 45:] = -1
    robot.navigates = False
    robot.go_on(1.5)
    told = robot.harness.take(Frontiers)[-1]
    (found,) = find_frontiers(NavigationGrid(robot.cells, RESOLUTION_M, (0.0, 0.0), 0.27), 0.35)
    ((x, y),) = ((one.x, one.y) for one in told.middles)
    assert (x, y) == pytest.approx(found.middle_xy_m)
    assert told.lengths_m.tolist() == pytest.approx([found.length_m])


def test_restarted_module_continues_its_mission(robot: Robot) -> None:
    robot.go_on(3.0)
    with ModuleHarness(RescueMission, restored=robot.harness.checkpoint) as again:
        restarted = Robot(again)
        restarted.pose, restarted.searched = robot.pose, robot.searched
        restarted.go_on(300.0)
        assert again.module.stop_requested
        assert restarted.pose[:2] == pytest.approx(START[:2])


TEAM = {"team": ["blue"]}
BLUE_MAP = MapAlignment(
    robot="blue", pose=Pose(position=Point(x=1.0), orientation=Quaternion.from_yaw(math.pi))
)


def found(state: VictimState, x_m: float, victim: int = 7) -> VictimFound:
    pose = Pose(position=Point(x=x_m, y=0.5, z=0.3), orientation=Quaternion.from_yaw(0.0))
    return VictimFound(id=victim, name=f"tag {victim}", pose=pose, state=int(state))


def test_victim_that_another_robot_has_confirmed_needs_no_visit() -> None:
    with ModuleHarness(RescueMission, TEAM) as harness:
        victims = harness.module.mission.victims
        harness.send(found(VictimState.CONFIRMED, 3.0), topic="blue")
        assert not victims.reports, "nobody knows where the map of blue lies"
        harness.send(replace(BLUE_MAP, is_sure=True), topic="blue")
        harness.send(found(VictimState.SUSPECTED, 3.0, victim=8), topic="blue")
        harness.send(found(VictimState.CONFIRMED, 3.0), topic="blue")
        harness.send(found(VictimState.SUSPECTED, -1.9))
        (report,) = victims.reports.values()
        assert (report.x_m, report.y_m) == pytest.approx((-2.0, -0.5))
        assert report.state is VictimState.CONFIRMED
        assert not victims.suspected


def test_own_confirmed_victim_keeps_its_own_place() -> None:
    with ModuleHarness(RescueMission, TEAM) as harness:
        harness.send(replace(BLUE_MAP, is_known=True), topic="blue")
        harness.send(found(VictimState.CONFIRMED, -1.9))
        harness.send(found(VictimState.CONFIRMED, 3.0), topic="blue")
        assert harness.module.mission.victims.reports[7].x_m == pytest.approx(-1.9)


def test_walls_that_another_robot_has_searched_count_while_its_map_is_aligned() -> None:
    nothing, everything = np.zeros(INFO.width * INFO.height, np.int8), np.full(CELLS.size, 100, np.int8)
    moved = replace(
        BLUE_MAP, pose=Pose(position=Point(x=0.5), orientation=Quaternion.from_yaw(0.0)), is_sure=True
    )
    with ModuleHarness(RescueMission, TEAM) as harness:
        harness.send(SearchedWalls(info=INFO, data=everything), topic="blue")

        def counts(x_m: float) -> bool:
            harness.send(SearchedWalls(info=INFO, data=nothing))
            return bool(present(harness.module.mission.searched).holds(np.array([[x_m, 1.0]]))[0])

        assert not counts(1.0)
        harness.send(moved, topic="blue")
        assert counts(1.0)
        assert not counts(0.3), "the map of blue begins at 0.5 m"
        harness.send(replace(moved, is_sure=False), topic="blue")
        assert not counts(1.0)


def test_each_robot_claims_its_goal_and_knows_where_that_of_another_lies() -> None:
    with ModuleHarness(RescueMission, TEAM) as harness:
        claims = harness.module.mission.claims
        other = GoalClaim(
            pose=Pose(position=Point(x=0.5)),
            has_target=True,
            target=Point(x=-1.0, y=0.5),
            way_m=2.0,
            is_working=True,
            has_home=True,
            home=Point(x=0.2),
            vain_frontiers=[Point(x=-0.5)],
            vain_walls=[Point(x=-0.6), Point(x=-0.7)],
            valid_for=Duration(sec=2),
        )
        harness.send(other, topic="blue")
        assert not claims.current, "nobody knows where the map of blue lies"
        harness.send(replace(BLUE_MAP, is_sure=True), topic="blue")
        harness.send(other, topic="blue")
        claim = claims.current["blue"]
        assert claim.pose[:2] == pytest.approx([0.5, 0.0])
        assert present(claim.target_xy_m) == pytest.approx([2.0, -0.5])
        assert present(claim.home_xy_m) == pytest.approx([0.8, 0.0])
        assert (claim.goal, claim.way_m, claim.is_working) == (None, 2.0, True)
        vain = [(seen.kind, round(seen.about_xy_m[0], 3)) for seen in claims.seen_in_vain]
        assert vain == [("EXPLORE", 1.5), ("SEARCH", 1.6), ("SEARCH", 1.7)]

        robot = Robot(harness)
        robot.navigates = False
        goal = robot.go_on(2.0)[-1]
        own = harness.take(GoalClaim)[-1]
        assert own.drives
        assert own.has_target
        assert own.is_working
        assert own.goal.position == goal.pose.pose.position
        assert own.pose.position == Point(x=START[0], y=START[1])
        assert own.has_home
        assert own.home == Point(x=START[0], y=START[1])
        assert not claims.current, "blue has been silent for two seconds"
        assert own.vain_walls == []
        assert harness.module.mission.state is MissionState.SEARCH
        harness.module.mission.arrived()
        robot.go_on(3.0)  # it looks at the wall until it gives up: no camera searches it
        last = harness.take(GoalClaim)[-1]
        assert own.target in last.vain_walls
        assert last.vain_frontiers == []


def test_only_robots_of_the_team_go_first() -> None:
    with pytest.raises(SettingError, match="'green' is none of the team: blue"):
        RescueMission.check({**TEAM, "gives_way_to": ["green"]})


def test_start_that_waited_in_a_stopped_mission_is_refused(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness = robot.harness
    robot.go_on(1.0)
    robot.order(OrderMission.PAUSE)
    harness.send(ControlState(mode=ControlState.HOLD), topic="control")
    envelope, published_ns = harness.bus.envelope, harness.clock.monotonic_ns() - 10**10
    monkeypatch.setattr(harness.bus, "envelope", lambda: envelope()._replace(published_ns=published_ns))
    with pytest.raises(CallRefused, match="has waited"):
        robot.order(OrderMission.START)
    assert not harness.take(SetControl)
