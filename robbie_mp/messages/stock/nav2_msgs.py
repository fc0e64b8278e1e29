"""Costmaps, and actions of Nav2 (ROS nav2_msgs of Jazzy)."""

from enum import IntEnum

from robbie_mp.messages.calls import Feedback, Goal, Result
from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_CELL_M, MIN_CELL_M, Flaw, outside, wrong_size
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, int16, uint8, uint16, uint32
from robbie_mp.messages.stock.builtin_interfaces import Duration, Time
from robbie_mp.messages.stock.geometry_msgs import Pose, PoseStamped
from robbie_mp.messages.stock.std_msgs import Header


class Cost(IntEnum):
    """Costs of cells with a meaning of their own, as in nav2_costmap_2d."""

    FREE = 0
    AVOIDED = 252
    """The most: from 1 to this, paths may lead there, but avoid it."""
    TOO_NEAR = 253
    """For the robot's centre: an obstacle is beside it."""
    OBSTACLE = 254
    UNKNOWN = 255


class CostmapMetaData(Message, name="nav2_msgs/msg/CostmapMetaData", version=1):
    """The values of cells of a costmap."""

    map_load_time: Time = DEFAULT
    update_time: Time = DEFAULT
    layer: str = DEFAULT  # of which layer the costs are
    resolution: float32 = DEFAULT  # m, edge of a cell
    size_x: uint32 = DEFAULT  # cells along x
    size_y: uint32 = DEFAULT  # cells along y
    origin: Pose = DEFAULT  # of the corner of cell (0, 0), in the frame of the map

    def flaw(self) -> Flaw | None:
        """Return a size of cells that is none, unless there are no cells."""
        least = 0.0 if self.size_x * self.size_y == 0 else MIN_CELL_M
        return outside(self, least, MAX_CELL_M, "resolution")


class Costmap(Message, name="nav2_msgs/msg/Costmap", version=1):
    """Where a robot may be, and which places it prefers to avoid."""

    header: Header = DEFAULT
    metadata: CostmapMetaData = DEFAULT
    data: Array[uint8] = DEFAULT  # (size_y * size_x,) row-major, as `Cost`

    def flaw(self) -> Flaw | None:
        """Return whether there are more or fewer cells than its size says."""
        size = self.metadata.size_x * self.metadata.size_y
        return wrong_size(self, "data", size, "metadata.size_x times metadata.size_y")


class NavigatingToPose(Feedback, name="nav2_msgs/action/NavigateToPose_Feedback", version=1):
    """How far the robot is on its way to a pose."""

    current_pose: PoseStamped = DEFAULT
    navigation_time: Duration = DEFAULT  # since the goal was accepted
    estimated_time_remaining: Duration = DEFAULT
    number_of_recoveries: int16 = DEFAULT
    distance_remaining: float32 = DEFAULT  # m, along the path


class NavigatedToPose(Result, name="nav2_msgs/action/NavigateToPose_Result", version=1):
    """The robot stands at the pose."""

    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class NavigateToPose(
    Goal[NavigatingToPose, NavigatedToPose], name="nav2_msgs/action/NavigateToPose_Goal", version=1
):
    """Drive to a pose."""

    pose: PoseStamped = DEFAULT
    behavior_tree: str = DEFAULT  # Nav2's file of it; nothing else uses it


class NavigatingThroughPoses(Feedback, name="nav2_msgs/action/NavigateThroughPoses_Feedback", version=1):
    """How far the robot is on its way through poses."""

    current_pose: PoseStamped = DEFAULT
    navigation_time: Duration = DEFAULT  # since the goal was accepted
    estimated_time_remaining: Duration = DEFAULT
    number_of_recoveries: int16 = DEFAULT
    distance_remaining: float32 = DEFAULT  # m, to the last pose
    number_of_poses_remaining: int16 = DEFAULT


class NavigatedThroughPoses(Result, name="nav2_msgs/action/NavigateThroughPoses_Result", version=1):
    """The robot stands at the last pose."""

    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class NavigateThroughPoses(
    Goal[NavigatingThroughPoses, NavigatedThroughPoses],
    name="nav2_msgs/action/NavigateThroughPoses_Goal",
    version=1,
):
    """Drive through poses to the last one."""

    poses: list[PoseStamped] = DEFAULT
    behavior_tree: str = DEFAULT  # Nav2's file of it; nothing else uses it


class MissedWaypoint(Message, name="nav2_msgs/msg/MissedWaypoint", version=1):
    """A waypoint that the robot has not reached."""

    index: uint32 = DEFAULT
    goal: PoseStamped = DEFAULT
    error_code: uint16 = DEFAULT


class FollowingWaypoints(Feedback, name="nav2_msgs/action/FollowWaypoints_Feedback", version=1):
    """The robot drives to a waypoint."""

    current_waypoint: uint32 = DEFAULT  # its index


class FollowedWaypoints(Result, name="nav2_msgs/action/FollowWaypoints_Result", version=1):
    """The robot has been at the waypoints, except for some."""

    missed_waypoints: list[MissedWaypoint] = DEFAULT
    error_code: uint16 = DEFAULT
    error_msg: str = DEFAULT


class FollowWaypoints(
    Goal[FollowingWaypoints, FollowedWaypoints], name="nav2_msgs/action/FollowWaypoints_Goal", version=1
):
    """Drive to one pose after the other."""

    number_of_loops: uint32 = DEFAULT  # how often all are driven to again
    goal_index: uint32 = 0  # of the first one
    poses: list[PoseStamped] = DEFAULT
