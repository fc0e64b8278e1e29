"""Nav2's actions of a stock robot, driven by action clients of rclpy; see `make ros`.

There are no wheels of nav2_msgs, so the test builds its actions from these definitions of Jazzy and Kilted.
"""

import json
import math
import os
import subprocess
from collections.abc import Iterator

import pytest

import robbie_mp
from robbie_mp.messages import Odometry
from tests._support.robot import Robot, wait_until
from tests.connect.ros2._support.ros_nodes import WHEELS, RosNode, ros_node, ros_python
from tests.docs._support.pages import ROOT, block

pytestmark = pytest.mark.slow
DOMAIN = 140 + os.getpid() % 60
PROFILE = """
parents: [robbie:navigation]
modules:
  nav2:
    class: robbie_robots.modules.navigation.nav2_actions:Nav2Actions
    settings: {stops_on_missed: false}
  behaviors:
    class: robbie_robots.modules.navigation.nav2_behaviors:Nav2Behaviors
  ros2:
    class: robbie_mp.connect.ros2.module:Ros2Bridge
    settings:
      middleware: dds
      domain: DOMAIN
      actions: ACTIONS
      services: {/lifecycle_manager_navigation/is_active: IsNavigationActive}
"""
TO_POSE = "action/NavigateToPose.action"
MISSED = "uint32 index\ngeometry_msgs/PoseStamped goal\nuint16 error_code\n"
STATUS = (
    "uint8 waypoint_status\nuint32 waypoint_index\ngeometry_msgs/PoseStamped waypoint_pose\n"
    "uint16 error_code\nstring error_msg\n"
)
FOLLOW = """uint32 number_of_loops
uint32 goal_index 0
geometry_msgs/PoseStamped[] poses
---
{missed}[] missed_waypoints
uint16 error_code
string error_msg
---
uint32 current_waypoint
"""
THROUGH = """{poses} poses
string behavior_tree
---
uint16 error_code
string error_msg
{statuses}---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
int16 number_of_poses_remaining
{statuses}"""
TOLD = """
builtin_interfaces/Duration total_elapsed_time
uint16 error_code
string error_msg
---
"""
ALLOWED = "builtin_interfaces/Duration time_allowance\n"
UNCHECKED = "bool disable_collision_checks False\n"
SPIN = "float32 target_yaw\n" + ALLOWED
STRAIGHT = "geometry_msgs/Point target\nfloat32 speed\n" + ALLOWED
WAIT = f"builtin_interfaces/Duration time\n---{TOLD}builtin_interfaces/Duration time_left\n"


def behaviors(more: str) -> dict[str, str]:
    """Return the definitions of Nav2's behaviors, with a further field of the goals of all but one."""
    turned, driven = "float32 angular_distance_traveled\n", "float32 distance_traveled\n"
    return {
        "action/Spin.action": f"{SPIN}{more}---{TOLD}{turned}",
        "action/BackUp.action": f"{STRAIGHT}{more}---{TOLD}{driven}",
        "action/DriveOnHeading.action": f"{STRAIGHT}{more}---{TOLD}{driven}",
        "action/Wait.action": WAIT,
    }


DEFINITIONS = {
    "jazzy": {
        **behaviors(""),
        "msg/MissedWaypoint.msg": MISSED,
        "action/FollowWaypoints.action": FOLLOW.format(missed="MissedWaypoint"),
        "action/NavigateThroughPoses.action": THROUGH.format(
            poses="geometry_msgs/PoseStamped[]", statuses=""
        ),
    },
    "kilted": {
        **behaviors(UNCHECKED),
        "msg/WaypointStatus.msg": STATUS,
        "action/FollowWaypoints.action": FOLLOW.format(missed="WaypointStatus"),
        "action/NavigateThroughPoses.action": THROUGH.format(
            poses="nav_msgs/Goals", statuses="WaypointStatus[] waypoint_statuses\n"
        ),
    },
}
CLIENT = """
import sys, threading
sys.path.insert(0, interfaces)
import nav2_msgs.action
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
class Client(ActionClient):
    _lock = threading.Lock()  # rclpy 9.1 sets it after the threads that spin have seen the client
def pose(x):
    made = PoseStamped()
    made.header.frame_id, made.pose.position.x, made.pose.orientation.w = "map", x, 1.0
    return made
# All from the beginning: what a server tells before it has found a new client's subscription is lost.
clients = {name: Client(node, getattr(nav2_msgs.action, kind), name) for kind, name in names.items()}
sent = []
class Sent:
    def __init__(self, kind, name, fields):
        self.answer = self.end = None
        self.feedback = []
        assert clients[name].wait_for_server(20.0)
        future = clients[name].send_goal_async(kind.Goal(**fields), self.on_feedback)
        future.add_done_callback(self.on_answer)
    def on_feedback(self, message):
        self.feedback.append(message.feedback)
    def on_answer(self, future):
        self.answer = future.result()
        if self.answer.accepted:
            self.answer.get_result_async().add_done_callback(self.on_end)
    def on_end(self, future):
        self.end = future.result()
"""
SEND = """
fields = {**numbers}
if at:
    poses = [pose(x) for x in at]
    if kind == "NavigateThroughPoses" and has_goals:
        from nav_msgs.msg import Goals
        poses = Goals(goals=poses)
    fields |= {"pose": poses[0]} if kind == "NavigateToPose" else {"poses": poses}
sent.append(Sent(getattr(nav2_msgs.action, kind), name, fields))
"""
IS_ACCEPTED = "result = sent[-1].answer and sent[-1].answer.accepted"
HAS_ENDED = """
end = sent[-1].end
result = end and [end.status, end.result.error_code, end.result.error_msg]
"""
MISSED_ONES = """
ones = sent[-1].end.result.missed_waypoints
result = [[getattr(one, "index", None) or one.waypoint_index, one.error_code] for one in ones]
"""
STATUSES = """
told = lambda message: [one.waypoint_status for one in message.waypoint_statuses]
result = [*(told(one) for one in sent[-1].feedback), told(sent[-1].end.result)]
"""
SEND_BEHAVIOR = """
from geometry_msgs.msg import Point
fields = dict(numbers)
if "x" in fields:
    fields["target"] = Point(x=fields.pop("x"))
if "time" in fields:
    fields["time"] = __import__("builtin_interfaces.msg").msg.Duration(sec=fields["time"])
sent.append(Sent(getattr(nav2_msgs.action, kind), name, fields))
"""
TRAVELED = """
told = [one for one in sent[-1].feedback]
result = [getattr(one, "distance_traveled", None) or one.angular_distance_traveled for one in told]
"""
WAYPOINTS = "result = [one.current_waypoint for one in sent[-1].feedback]"
LEFT = "result = [[one.distance_remaining, one.number_of_poses_remaining] for one in sent[-1].feedback]"
DISTANCES = "result = [one.distance_remaining for one in sent[-1].feedback]"
REPLACED = "result = sent[-2].end.status"
CANCEL = "sent[-1].answer.cancel_goal_async()"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
NAMES = {
    "NavigateToPose": "/navigate_to_pose",
    "NavigateThroughPoses": "/navigate_through_poses",
    "FollowWaypoints": "/follow_waypoints",
    "Spin": "/spin",
    "BackUp": "/backup",
    "DriveOnHeading": "/drive_on_heading",
    "Wait": "/wait",
}
SAME = ("NavigateToPose", "Wait")
"""Those that Kilted did not change."""
NEAR_M = 0.4
"""Navigation's tolerance, and what the map may be off."""
NEAR_RAD = 0.2
FAR_M = 500.0
"""Beyond all walls."""


class Driver:
    """A robot, and a node that sends it goals.

    Attributes:
        robot: the robot.
        node: the node.
        distribution: the node's.
    """

    def __init__(self, robot: Robot, node: RosNode, distribution: str):
        self.robot, self.node, self.distribution = robot, node, distribution

    def begin(self, kind: str, *at: float, **numbers: int) -> None:
        """Send a goal with poses on the x axis, in m."""
        has_goals = self.distribution == "kilted"
        self.node.run(SEND, kind=kind, name=NAMES[kind], at=at, numbers=numbers, has_goals=has_goals)

    def send(self, kind: str, *at: float, **numbers: int) -> bool:
        """Send a goal; return whether it is accepted."""
        self.begin(kind, *at, **numbers)
        found: list[bool] = []

        def is_answered() -> bool:
            answer = self.node.run(IS_ACCEPTED)
            found[:] = [] if answer is None else [answer]
            return bool(found)

        wait_until(is_answered)
        return found[0]

    def end(self) -> tuple[int, int, str]:
        """Return status, error code and error text of the newest goal, once it has ended."""
        wait_until(lambda: self.node.run(HAS_ENDED))
        status, code, text = self.node.run(HAS_ENDED)
        return status, code, text

    def until_ready(self) -> None:
        """Wait until navigation has its map and its pose."""
        wait_until(lambda: self.send("NavigateToPose", 0.3) and self.end()[0] == SUCCEEDED)


@pytest.fixture(params=WHEELS)
def driver(
    request: pytest.FixtureRequest, robot: Robot, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Driver]:
    distribution = request.param
    folder = tmp_path_factory.mktemp("nav2")
    package = folder / "source" / "nav2_msgs"
    of_the_page = block("docs/ros2-robot.md", f"file interfaces/nav2_msgs/{TO_POSE}")
    definitions = {**DEFINITIONS[distribution], TO_POSE: of_the_page}
    for name, text in definitions.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    command = [ros_python(distribution).path, str(ROOT / "tools/ros_wheels.py"), "interfaces"]
    subprocess.run([*command, str(package), str(folder)], check=True, timeout=400)
    domain = DOMAIN + WHEELS.index(distribution)
    actions = {
        name: kind if distribution == "jazzy" or kind in SAME else f"Kilted{kind} as nav2_msgs/action/{kind}"
        for kind, name in NAMES.items()
    }
    robot.write_profile(PROFILE.replace("DOMAIN", str(domain)).replace("ACTIONS", json.dumps(actions)))
    robot.start()
    robot.until(lambda top: all(one["state"] == "RUNNING" for one in top.values()))
    with ros_node(distribution, domain, folder) as node:
        node.run(CLIENT, interfaces=str(folder), names=NAMES)
        yield Driver(robot, node, distribution)


def heading_rad() -> float:
    """Return the direction of the robot, rad."""
    with robbie_mp.attach() as run:
        turn = run.latest(Odometry, "ground_truth").pose.pose.orientation
        return 2 * math.atan2(turn.z, turn.w)


def place_m() -> float:
    """Return where the robot is, along the x axis, in m."""
    with robbie_mp.attach() as run:
        return float(run.latest(Odometry, "ground_truth").pose.pose.position.x)


def test_clients_of_rclpy_drive_the_stock_robot_as_far_as_it_may_drive_by_itself(driver: Driver) -> None:
    driver.until_ready()
    follow_waypoints(driver)
    drive_through_poses(driver)
    miss_a_waypoint(driver)
    behave(driver)
    refuse_and_cancel(driver)
    assert "not asked for" not in driver.robot.top()["ros2"]["status"], "a hash of feedback is another"


def follow_waypoints(driver: Driver) -> None:
    assert driver.send("FollowWaypoints", 0.9, 0.3, number_of_loops=1)
    assert driver.end() == (SUCCEEDED, 0, "")
    assert driver.node.run(WAYPOINTS) == [0, 1, 0, 1]
    assert abs(place_m() - 0.3) < NEAR_M
    assert driver.send("FollowWaypoints", 0.3, 0.9, goal_index=1)
    assert driver.end() == (SUCCEEDED, 0, "")
    assert driver.node.run(WAYPOINTS) == [1]
    assert abs(place_m() - 0.9) < NEAR_M
    assert not driver.send("FollowWaypoints", 0.3, goal_index=1)
    assert not driver.send("FollowWaypoints")


def drive_through_poses(driver: Driver) -> None:
    assert driver.send("NavigateThroughPoses", 0.3, 0.9)
    assert driver.end() == (SUCCEEDED, 0, "")
    left = driver.node.run(LEFT)
    assert {poses for _, poses in left} == {1, 2}
    assert left[-1][0] < left[0][0]
    assert abs(place_m() - 0.9) < NEAR_M
    if driver.distribution == "kilted":
        *told, end = driver.node.run(STATUSES)
        assert [0, 0] in told
        assert [1, 0] in told
        assert end == [1, 1]


def miss_a_waypoint(driver: Driver) -> None:
    assert driver.send("FollowWaypoints", 0.6, FAR_M, 0.3)
    assert driver.end()[0] == SUCCEEDED
    assert driver.node.run(MISSED_ONES) == [[1, 601]]
    assert abs(place_m() - 0.3) < NEAR_M


def behave(driver: Driver) -> None:
    """Turn, drive on and back, and wait."""

    def do(kind: str, **numbers: float) -> tuple[int, int, str]:
        driver.node.run(SEND_BEHAVIOR, kind=kind, name=NAMES[kind], numbers=numbers)
        wait_until(lambda: driver.node.run(IS_ACCEPTED))
        return driver.end()

    before_rad, before_m = heading_rad(), place_m()
    assert do("Spin", target_yaw=0.8)[0] == SUCCEEDED
    assert abs(math.remainder(heading_rad() - before_rad - 0.8, math.tau)) < NEAR_RAD
    assert driver.node.run(TRAVELED)[-1] > 0.4
    assert do("Spin", target_yaw=-0.8)[0] == SUCCEEDED
    assert do("BackUp", x=0.3, speed=0.15)[0] == SUCCEEDED
    assert place_m() < before_m - 0.1
    assert do("DriveOnHeading", x=0.3, speed=0.15)[0] == SUCCEEDED
    assert abs(place_m() - before_m) < 0.15
    assert do("Wait", time=1)[0] == SUCCEEDED
    status, _, text = do("DriveOnHeading", x=FAR_M, speed=0.3)
    assert status == ABORTED, "there is a wall"
    assert "COLLISION_AHEAD" in text or "lately" in text  # a laser may be late on a busy machine


def refuse_and_cancel(driver: Driver) -> None:
    assert driver.send("NavigateToPose", FAR_M)
    status, _, text = driver.end()
    assert status == ABORTED
    assert text
    assert driver.robot.command("call", "SetControl", "{mode: 2}").returncode == 0
    wait_until(lambda: not driver.send("FollowWaypoints", 0.6))
    # Right after one operator has ordered to hold, another one is asked to look first.
    wait_until(lambda: driver.robot.command("call", "SetControl", "{mode: 0}").returncode == 0)
    wait_until(lambda: driver.send("FollowWaypoints", 2.5))
    assert driver.send("NavigateToPose", 2.5)
    wait_until(lambda: any(one > 0.0 for one in driver.node.run(DISTANCES)))
    assert driver.node.run(REPLACED) == ABORTED
    driver.node.run(CANCEL)
    assert driver.end()[0] == CANCELED
