"""Nav2's actions of a stock robot over DDS, by another bridge: there are no wheels of nav2_msgs."""

import os
from typing import Any

import pytest

from robbie_mp import ModuleHarness
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.messages import GoalEnd, Header, Point, Pose, PoseStamped
from robbie_mp.messages.stock.nav2_msgs import FollowWaypoints, NavigateThroughPoses, NavigateToPose
from tests._support.robot import Robot
from tests.connect.ros2._support.ros_nodes import until

pytestmark = pytest.mark.slow
DOMAIN = 140 + os.getpid() % 60
PROFILE = f"""
parents: [robbie:navigation]
modules:
  nav2:
    class: robbie_robots.modules.navigation.nav2_actions:Nav2Actions
  ros2:
    class: robbie_mp.connect.ros2.module:Ros2Bridge
    settings:
      middleware: dds
      domain: {DOMAIN}
      actions:
        /navigate_to_pose: NavigateToPose
        /navigate_through_poses: NavigateThroughPoses
        /follow_waypoints: FollowWaypoints
      services: {{/lifecycle_manager_navigation/is_active: IsNavigationActive}}
"""
CALLS = {
    "/navigate_to_pose": "NavigateToPose",
    "/navigate_through_poses": "NavigateThroughPoses",
    "/follow_waypoints": "FollowWaypoints",
}


def at(x_m: float, frame: str = "map") -> PoseStamped:
    return PoseStamped(header=Header(frame_id=frame), pose=Pose(position=Point(x=x_m)))


def test_goals_of_ros_drive_the_stock_robot_as_far_as_it_may_drive_by_itself(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda figures: all(one["state"] == "RUNNING" for one in figures.values()))
    settings = {"middleware": "dds", "domain": DOMAIN, "calls": CALLS, "parameters": "none"}
    with ModuleHarness(Ros2Bridge, settings) as ros:

        def told() -> list[Any]:
            return [one.message for one in ros.published if one.topic == "client"]

        def end_of(goal: Any) -> Any:
            ros.bus.published.clear()
            ros.send_goal(goal)
            until(ros, lambda: told() and not told()[-1].type_name.endswith("_Feedback"), 60.0)
            return told()[-1]

        until(ros, lambda: "frame" in getattr(end_of(NavigateToPose(pose=at(0.5, "odom"))), "reason", ""))
        assert robot.command("call", "SetControl", "{mode: 2}").returncode == 0
        until(ros, lambda: "refused" in getattr(end_of(NavigateToPose(pose=at(0.5))), "reason", ""))
        assert robot.command("call", "SetControl", "{mode: 0}").returncode == 0
        until(ros, lambda: end_of(NavigateToPose(pose=at(0.5))).type_name.endswith("_Result"), 60.0)
        assert end_of(NavigateThroughPoses(poses=[at(0.8), at(0.5)])).type_name.endswith("Poses_Result")
        assert end_of(FollowWaypoints(poses=[at(0.8), at(0.5)])).type_name.endswith("FollowWaypoints_Result")
        ros.bus.published.clear()
        sent = ros.send_goal(NavigateToPose(pose=at(2.5)))
        until(ros, lambda: told() and told()[-1].distance_remaining > 0.0)
        ros.cancel_goal(sent, "enough")
        until(ros, lambda: told()[-1].type_name == GoalEnd.type_name)
        assert told()[-1].outcome == GoalEnd.CANCELLED
