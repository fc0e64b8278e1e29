"""The module of the mission turns messages into goals and directions, and writes a report at the end."""

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture

from modules.navigation import Navigation
from modules.rescue.messages import MissionOrder, MissionStatus, SearchedWalls, VictimFound
from modules.rescue.mission import RescueMission
from robbie_mp import ModuleHarness
from robbie_mp.messages import (
    BatteryState,
    CameraInfo,
    CancelGoal,
    Frontiers,
    MapMetaData,
    NavigationState,
    OccupancyGrid,
    PanTiltCommand,
    Point,
    PointsOfInterest,
    Pose,
    PoseStamped,
    Quaternion,
)
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells
from workers.exploration.frontiers import find_frontiers
from workers.maps.navigation_grid import NavigationGrid
from workers.rescue.searched_walls import WallFronts, WallMemory

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

    def go_on(self, seconds: float) -> list[PoseStamped]:
        """Let time pass; return the goals that came."""
        goals = []
        for _ in range(round(seconds / 0.5)):
            if self.harness.module.stop_requested:
                break
            self.tell()
            self.harness.advance(0.5)
            for goal in self.harness.take(PoseStamped, "goal"):
                goals.append(goal)
                if self.navigates:
                    place = goal.pose.position
                    self.pose = (place.x, place.y, goal.pose.orientation.yaw)
                    self.searched.look(FRONTS, self.pose, 0.7)
                    self.tell_navigation("ARRIVED", goal)
        return goals

    def tell(self) -> None:
        x, y, heading = self.pose
        pose = Pose(position=Point(x=x, y=y), orientation=Quaternion.from_yaw(heading))
        self.harness.send(OccupancyGrid(info=INFO, data=self.cells.ravel()))
        self.harness.send(PoseStamped(pose=pose), topic="map_pose")
        self.harness.send(CameraInfo(), topic="camera")
        self.harness.send(SearchedWalls(info=INFO, data=self.searched.grid(FRONTS).ravel()))

    def tell_navigation(self, state: str, goal: PoseStamped | None = None, reason: str = "") -> None:
        pose = Pose() if goal is None else goal.pose
        self.harness.send(NavigationState(state=state, reason=reason, goal=pose))


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with ModuleHarness(RescueMission, output_directory=tmp_path) as harness:
        made = Robot(harness)
        made.tell_navigation("IDLE")
        yield made


def test_whole_mission_ends_at_home_and_writes_its_report(robot: Robot, tmp_path: Path) -> None:
    robot.go_on(2.0)
    place = Pose(position=Point(x=3.75, y=0.9, z=0.35), orientation=Quaternion.from_yaw(math.pi))
    for number, state in ((7, VictimFound.CONFIRMED), (8, VictimFound.REJECTED)):
        robot.harness.send(VictimFound(id=number, name=f"tag {number}", pose=place, state=state))
    robot.harness.send(BatteryState(percentage=0.8), topic="battery")
    (home,) = robot.harness.take(PointsOfInterest, "mission")[-1].points
    assert (home.name, home.pose.position) == ("home", Point(x=START[0], y=START[1]))
    robot.go_on(300.0)
    assert robot.harness.module.stop_requested
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
    assert not goals or goals[0].header.frame_id == "map"


def test_goal_that_navigation_has_lost_is_sent_again(robot: Robot) -> None:
    robot.navigates = False
    (first, *_) = robot.go_on(1.5)
    robot.tell_navigation("IDLE")  # it was restarted, and knows nothing
    again = robot.go_on(4.0)
    assert [goal.pose for goal in again][:1] == [first.pose]
    robot.tell_navigation("DRIVE", first)
    assert robot.go_on(4.0) == []


def test_goal_with_a_different_heading_is_a_new_goal(robot: Robot) -> None:
    robot.navigates = False
    (goal, *_) = robot.go_on(1.5)
    before = robot.harness.module.mission.state
    place = goal.pose.position
    turned = Quaternion.from_yaw(goal.pose.orientation.yaw + 0.5)
    robot.tell_navigation("ARRIVED", PoseStamped(pose=Pose(position=place, orientation=turned)))
    assert robot.harness.module.mission.state is before
    robot.tell_navigation("ARRIVED", goal)
    assert robot.harness.module.mission.state is not before


def test_navigation_without_a_goal_is_sent_home_even_at_the_origin(robot: Robot) -> None:
    module = robot.harness.module
    module.goal, module.sent_s = np.zeros(3), 0.0
    robot.tell_navigation("DRIVE", PoseStamped())
    assert module.is_known
    robot.tell_navigation("IDLE")
    assert not module.is_known


def test_mission_finds_a_path_wherever_navigation_does(robot: Robot) -> None:
    with ModuleHarness(Navigation) as navigation:
        assert robot.harness.module.mission.settings.clearance_m == navigation.module.clearance_m


def test_silent_laser_stops_the_robot_and_is_in_the_report(
    robot: Robot, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.tell_navigation("STOPPED_NO_LASER", reason="the laser is silent for 0.7 s")
    (stand,) = robot.go_on(1.5)
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warnings == ["stopped: STOPPED_NO_LASER: the laser is silent for 0.7 s"]
    assert (stand.pose.position.x, stand.pose.position.y) == START[:2]
    robot.harness.module.teardown()
    notes = json.loads((tmp_path / "mission.json").read_text())["notes"]
    assert notes == ["stopped: STOPPED_NO_LASER: the laser is silent for 0.7 s"]


def test_pause_stops_the_robot_at_once_and_publishes_the_accepted_orders(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.harness.take(MissionStatus)
    robot.harness.send(MissionOrder(order=MissionOrder.PAUSE))
    assert len(robot.harness.take(CancelGoal)) == 1
    (status,) = robot.harness.take(MissionStatus)
    assert (status.state, status.refusal) == ("PAUSE", "")
    assert status.orders.tolist() == [MissionOrder.START, MissionOrder.ABORT, MissionOrder.RETURN]
    assert status.text.startswith("stands, until the operator resumes (ordered by the operator)")


def test_paused_robot_can_be_driven_elsewhere_and_continues_from_there(robot: Robot) -> None:
    robot.navigates = False
    robot.go_on(1.5)
    robot.harness.send(MissionOrder(order=MissionOrder.PAUSE))
    robot.harness.take(CancelGoal)
    robot.tell_navigation("IDLE")
    robot.pose = (2.0, 1.0, 0.0)
    elsewhere = PoseStamped(pose=Pose(position=Point(x=3.0, y=1.0)))
    robot.tell_navigation("DRIVE", elsewhere)
    assert robot.go_on(5.0) == []
    assert robot.harness.take(CancelGoal) == []
    robot.harness.send(MissionOrder(order=MissionOrder.START))
    assert robot.harness.take(PoseStamped, "goal")


def test_goal_is_cancelled_again_if_restarted_navigation_still_drives_to_it(robot: Robot) -> None:
    robot.navigates = False
    (goal, *_) = robot.go_on(1.5)
    robot.harness.send(MissionOrder(order=MissionOrder.PAUSE))
    robot.tell_navigation("DRIVE", goal)
    robot.harness.take(CancelGoal)
    robot.go_on(3.0)
    assert len(robot.harness.take(CancelGoal)) == 1


def test_mission_resumed_after_a_short_pause_sends_its_goal_again(robot: Robot) -> None:
    robot.navigates = False
    (goal, *_) = robot.go_on(1.5)
    for order in (MissionOrder.PAUSE, MissionOrder.START):
        robot.harness.send(MissionOrder(order=order))
    (again,) = robot.harness.take(PoseStamped, "goal")
    assert again.pose == goal.pose


def test_refused_order_is_logged_and_in_the_status(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    robot.go_on(1.5)
    robot.harness.take(MissionStatus)
    robot.harness.send(MissionOrder(order=MissionOrder.START))
    (status,) = robot.harness.take(MissionStatus)
    assert status.refusal == "START: the mission is under way"
    (warning,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warning.endswith(status.refusal)
    robot.harness.send(MissionOrder(order=MissionOrder.PAUSE))
    assert robot.harness.take(MissionStatus)[-1].refusal == ""


def test_aborted_mission_ends_and_writes_its_report(robot: Robot, tmp_path: Path) -> None:
    robot.go_on(1.5)
    robot.harness.send(MissionOrder(order=MissionOrder.ABORT))
    robot.go_on(2.0)
    assert robot.harness.module.stop_requested
    robot.harness.module.teardown()
    figures = json.loads((tmp_path / "mission.json").read_text())
    assert (figures["state"], figures["reason"]) == ("DONE", "aborted by the operator")


def test_pause_outlives_a_restart(robot: Robot) -> None:
    robot.go_on(1.5)
    robot.harness.send(MissionOrder(order=MissionOrder.PAUSE))
    with ModuleHarness(RescueMission, restored=robot.harness.checkpoint) as again:
        restarted = Robot(again)
        restarted.pose = robot.pose
        restarted.tell_navigation("IDLE")
        assert restarted.go_on(1.0) == []
        assert len(again.take(CancelGoal)) == 1
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
        restarted.tell_navigation("IDLE")
        restarted.go_on(300.0)
        assert again.module.stop_requested
        assert restarted.pose[:2] == pytest.approx(START[:2])
