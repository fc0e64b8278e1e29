"""The rosbags library as an independent codec."""

import math
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from robbie_mp.messages import Message
from robbie_mp.messages.message import fields_of

# Fields as in https://github.com/ros-perception/vision_msgs, branch ros2 (4.1.1); rosbags does not have them.
VISION_MSGS = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "Detection2D": (
        "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id"
    ),
    "Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
}
# Fields as in https://github.com/ros-navigation/navigation2, branch jazzy.
NAV2_MSGS = {
    "CostmapMetaData": (
        "builtin_interfaces/Time map_load_time\nbuiltin_interfaces/Time update_time\nstring layer\n"
        "float32 resolution\nuint32 size_x\nuint32 size_y\ngeometry_msgs/Pose origin"
    ),
    "Costmap": "std_msgs/Header header\nnav2_msgs/CostmapMetaData metadata\nuint8[] data",
    "MissedWaypoint": "uint32 index\ngeometry_msgs/PoseStamped goal\nuint16 error_code",
}
NAV2_ACTIONS = {
    "NavigateToPose_Goal": "geometry_msgs/PoseStamped pose\nstring behavior_tree",
    "NavigateToPose_Result": "uint16 error_code\nstring error_msg",
    "NavigateToPose_Feedback": (
        "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
        "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
        "float32 distance_remaining"
    ),
    "NavigateThroughPoses_Goal": "geometry_msgs/PoseStamped[] poses\nstring behavior_tree",
    "NavigateThroughPoses_Result": "uint16 error_code\nstring error_msg",
    "NavigateThroughPoses_Feedback": (
        "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
        "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
        "float32 distance_remaining\nint16 number_of_poses_remaining"
    ),
    "FollowWaypoints_Goal": (
        "uint32 number_of_loops\nuint32 goal_index 0\ngeometry_msgs/PoseStamped[] poses"
    ),
    "FollowWaypoints_Result": (
        "nav2_msgs/MissedWaypoint[] missed_waypoints\nuint16 error_code\nstring error_msg"
    ),
    "FollowWaypoints_Feedback": "uint32 current_waypoint",
}
"""Likewise. In ours, the number of the call comes first."""


def jazzy() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, fields in NAV2_MSGS.items():
        store.register(get_types_from_msg(fields, f"nav2_msgs/msg/{name}"))
    for name, fields in NAV2_ACTIONS.items():
        store.register(get_types_from_msg(f"uint64 call\n{fields}", f"nav2_msgs/action/{name}"))
    for name, fields in VISION_MSGS.items():
        store.register(get_types_from_msg(fields, f"vision_msgs/msg/{name}"))
    return store


def store_with(type_name: str, schema: str) -> Typestore:
    """A type store that knows the types of a ros2msg text."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema, name_for_rosbags(type_name)))
    return store


def name_for_rosbags(type_name: str) -> str:
    """Return the name of a type in a type store: rosbags misreads those of services."""
    return type_name.replace("/srv/", "/msg/")


def to_rosbags(store: Typestore, message: Message) -> Any:
    """The same message as an object of rosbags."""
    return store.types[name_for_rosbags(message.type_name)](
        **{
            field.schema_name: _value(store, getattr(message, field.name))
            for field in fields_of(type(message))
        }
    )


def _value(store: Typestore, value: Any) -> Any:
    if isinstance(value, Message):
        return to_rosbags(store, value)
    if isinstance(value, list):
        return [_value(store, item) for item in value]
    return value


def assert_same(ours: Any, theirs: Any) -> None:
    """Field by field; NaN equals NaN."""
    if isinstance(ours, Message):
        for field in fields_of(type(ours)):
            assert_same(getattr(ours, field.name), getattr(theirs, field.schema_name))
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        for mine, its in zip(ours, theirs, strict=True):
            assert_same(mine, its)
    elif isinstance(ours, np.ndarray):
        np.testing.assert_array_equal(
            ours, np.frombuffer(theirs, np.uint8) if isinstance(theirs, bytes) else theirs
        )
    else:
        assert ours == theirs or (math.isnan(ours) and math.isnan(theirs))
