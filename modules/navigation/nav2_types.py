"""Types of Nav2's actions: its behaviors, and those that differ between Jazzy and Kilted.

ROS gives the types of all distributions the same names. So those of Kilted have names of their own here, and
a bridge offers them by `KiltedSpin as nav2_msgs/action/Spin`. `Wait` is the same in both.

Source: https://github.com/ros-navigation/navigation2, 1.3.13 (Jazzy) and 1.4.2 (Kilted).
"""

from typing import ClassVar

from robbie_mp import (
    DEFAULT,
    Duration,
    Feedback,
    Goal,
    Header,
    Message,
    Result,
    float32,
    int16,
    uint8,
    uint16,
    uint32,
)
from robbie_mp.messages import Point, PoseStamped


class Spinning(Feedback, name="nav2_msgs/action/Spin_Feedback"):
    """How far the robot has turned."""

    angular_distance_traveled: float32 = DEFAULT  # rad


class Spun(Result, name="nav2_msgs/action/Spin_Result"):
    """The robot has turned."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class Spin(Goal[Spinning, Spun], name="nav2_msgs/action/Spin_Goal"):
    """Turn on the spot."""

    target_yaw: float32 = DEFAULT  # rad, counter-clockwise
    time_allowance: Duration = DEFAULT  # 0: any


class BackingUp(Feedback, name="nav2_msgs/action/BackUp_Feedback"):
    """How far the robot has driven."""

    distance_traveled: float32 = DEFAULT  # m


class BackedUp(Result, name="nav2_msgs/action/BackUp_Result"):
    """The robot has driven the distance."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class BackUp(Goal[BackingUp, BackedUp], name="nav2_msgs/action/BackUp_Goal"):
    """Drive straight back."""

    target: Point = DEFAULT  # x: distance, m, of any sign; y and z must be 0
    speed: float32 = DEFAULT  # m/s, of any sign
    time_allowance: Duration = DEFAULT  # 0: any


class DrivingOnHeading(Feedback, name="nav2_msgs/action/DriveOnHeading_Feedback"):
    """How far the robot has driven."""

    distance_traveled: float32 = DEFAULT  # m


class DrivenOnHeading(Result, name="nav2_msgs/action/DriveOnHeading_Result"):
    """The robot has driven the distance."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class DriveOnHeading(Goal[DrivingOnHeading, DrivenOnHeading], name="nav2_msgs/action/DriveOnHeading_Goal"):
    """Drive straight on."""

    target: Point = DEFAULT  # x: distance, m, with the sign of the speed; y and z must be 0
    speed: float32 = DEFAULT  # m/s; negative: back
    time_allowance: Duration = DEFAULT  # 0: any


class Waiting(Feedback, name="nav2_msgs/action/Wait_Feedback"):
    """How long the robot still waits."""

    time_left: Duration = DEFAULT


class Waited(Result, name="nav2_msgs/action/Wait_Result"):
    """The robot has waited."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class Wait(Goal[Waiting, Waited], name="nav2_msgs/action/Wait_Goal"):
    """Wait, and move nothing."""

    time: Duration = DEFAULT


class KiltedSpinning(Feedback, name="nav2_msgs/action/KiltedSpin_Feedback"):
    """How far the robot has turned."""

    angular_distance_traveled: float32 = DEFAULT  # rad


class KiltedSpun(Result, name="nav2_msgs/action/KiltedSpin_Result"):
    """The robot has turned."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class KiltedSpin(Goal[KiltedSpinning, KiltedSpun], name="nav2_msgs/action/KiltedSpin_Goal"):
    """Turn on the spot."""

    target_yaw: float32 = DEFAULT  # rad, counter-clockwise
    time_allowance: Duration = DEFAULT  # 0: any
    disable_collision_checks: bool = False  # refused if true


class KiltedBackingUp(Feedback, name="nav2_msgs/action/KiltedBackUp_Feedback"):
    """How far the robot has driven."""

    distance_traveled: float32 = DEFAULT  # m


class KiltedBackedUp(Result, name="nav2_msgs/action/KiltedBackUp_Result"):
    """The robot has driven the distance."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class KiltedBackUp(Goal[KiltedBackingUp, KiltedBackedUp], name="nav2_msgs/action/KiltedBackUp_Goal"):
    """Drive straight back."""

    target: Point = DEFAULT  # x: distance, m, of any sign; y and z must be 0
    speed: float32 = DEFAULT  # m/s, of any sign
    time_allowance: Duration = DEFAULT  # 0: any
    disable_collision_checks: bool = False  # refused if true


class KiltedDrivingOnHeading(Feedback, name="nav2_msgs/action/KiltedDriveOnHeading_Feedback"):
    """How far the robot has driven."""

    distance_traveled: float32 = DEFAULT  # m


class KiltedDrivenOnHeading(Result, name="nav2_msgs/action/KiltedDriveOnHeading_Result"):
    """The robot has driven the distance."""

    total_elapsed_time: Duration = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class KiltedDriveOnHeading(
    Goal[KiltedDrivingOnHeading, KiltedDrivenOnHeading], name="nav2_msgs/action/KiltedDriveOnHeading_Goal"
):
    """Drive straight on."""

    target: Point = DEFAULT  # x: distance, m, with the sign of the speed; y and z must be 0
    speed: float32 = DEFAULT  # m/s; negative: back
    time_allowance: Duration = DEFAULT  # 0: any
    disable_collision_checks: bool = False  # refused if true


class PoseGoals(Message, name="nav_msgs/msg/Goals"):
    """Poses to drive through (Kilted)."""

    header: Header = DEFAULT
    goals: list[PoseStamped] = DEFAULT


class WaypointStatus(Message, name="nav2_msgs/msg/WaypointStatus"):
    """What became of a waypoint (Kilted)."""

    PENDING: ClassVar[uint8] = 0
    COMPLETED: ClassVar[uint8] = 1
    SKIPPED: ClassVar[uint8] = 2
    FAILED: ClassVar[uint8] = 3

    waypoint_status: uint8 = PENDING
    waypoint_index: uint32 = DEFAULT
    waypoint_pose: PoseStamped = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class KiltedNavigatingThroughPoses(Feedback, name="nav2_msgs/action/KiltedNavigateThroughPoses_Feedback"):
    """How far the robot is on its way through poses."""

    current_pose: PoseStamped = DEFAULT
    navigation_time: Duration = DEFAULT  # since the goal was accepted
    estimated_time_remaining: Duration = DEFAULT
    number_of_recoveries: int16 = DEFAULT
    distance_remaining: float32 = DEFAULT  # m, to the last pose
    number_of_poses_remaining: int16 = DEFAULT
    waypoint_statuses: list[WaypointStatus] = DEFAULT


class KiltedNavigatedThroughPoses(Result, name="nav2_msgs/action/KiltedNavigateThroughPoses_Result"):
    """The robot stands at the last pose."""

    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT
    waypoint_statuses: list[WaypointStatus] = DEFAULT


class KiltedNavigateThroughPoses(
    Goal[KiltedNavigatingThroughPoses, KiltedNavigatedThroughPoses],
    name="nav2_msgs/action/KiltedNavigateThroughPoses_Goal",
):
    """Drive through poses to the last one."""

    poses: PoseGoals = DEFAULT
    behavior_tree: str = DEFAULT  # Nav2's file of it; nothing else uses it


class KiltedFollowingWaypoints(Feedback, name="nav2_msgs/action/KiltedFollowWaypoints_Feedback"):
    """The robot drives to a waypoint."""

    current_waypoint: uint32 = DEFAULT  # its index


class KiltedFollowedWaypoints(Result, name="nav2_msgs/action/KiltedFollowWaypoints_Result"):
    """The robot has been at the waypoints, except for some."""

    missed_waypoints: list[WaypointStatus] = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class KiltedFollowWaypoints(
    Goal[KiltedFollowingWaypoints, KiltedFollowedWaypoints],
    name="nav2_msgs/action/KiltedFollowWaypoints_Goal",
):
    """Drive to one pose after the other."""

    number_of_loops: uint32 = DEFAULT  # how often all are driven to again
    goal_index: uint32 = 0  # of the first one
    poses: list[PoseStamped] = DEFAULT
