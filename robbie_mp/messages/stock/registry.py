"""The stock messages by name."""

from functools import cache, lru_cache

from robbie_mp.messages.errors import UnknownType
from robbie_mp.messages.message import Message
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.stock import (
    foxglove_msgs,
    geometry_msgs,
    link_msgs,
    nav2_msgs,
    nav_msgs,
    playback_msgs,
    profiler_msgs,
    rcl_interfaces,
    robbie_msgs,
    scene_msgs,
    sensor_msgs,
    std_msgs,
    tf2_msgs,
    vision_msgs,
)


def stock_registry() -> TypeRegistry:
    """Return a new registry that knows all stock messages."""
    return TypeRegistry(
        (
            foxglove_msgs.RawAudio,
            geometry_msgs.PoseStamped,
            geometry_msgs.PoseWithCovarianceStamped,
            geometry_msgs.TwistStamped,
            link_msgs.LinkRefusal,
            link_msgs.LinkState,
            link_msgs.LinkTypes,
            link_msgs.OperatorRequest,
            link_msgs.OperatorState,
            link_msgs.RobotSummary,
            link_msgs.ToolReply,
            link_msgs.ToolRequest,
            nav2_msgs.Costmap,
            nav2_msgs.FollowedWaypoints,
            nav2_msgs.FollowingWaypoints,
            nav2_msgs.FollowWaypoints,
            nav2_msgs.NavigatedThroughPoses,
            nav2_msgs.NavigatedToPose,
            nav2_msgs.NavigateThroughPoses,
            nav2_msgs.NavigateToPose,
            nav2_msgs.NavigatingThroughPoses,
            nav2_msgs.NavigatingToPose,
            nav_msgs.OccupancyGrid,
            nav_msgs.Odometry,
            nav_msgs.Path,
            playback_msgs.PlaybackControl,
            playback_msgs.PlaybackState,
            playback_msgs.TimeJump,
            profiler_msgs.SystemProfile,
            rcl_interfaces.Log,
            robbie_msgs.AnnotateMap,
            robbie_msgs.Bumper,
            robbie_msgs.CallRefusal,
            robbie_msgs.CallsAnswer,
            robbie_msgs.CallsQuestion,
            robbie_msgs.CancelNavigation,
            robbie_msgs.Clip,
            robbie_msgs.ControlSet,
            robbie_msgs.ControlState,
            robbie_msgs.DeviceState,
            robbie_msgs.DriveCommand,
            robbie_msgs.EmergencyStop,
            robbie_msgs.ForgetRecognition,
            robbie_msgs.Frontiers,
            robbie_msgs.GoalCancel,
            robbie_msgs.GoalEnd,
            robbie_msgs.JointCommand,
            robbie_msgs.JointLimits,
            robbie_msgs.LightSet,
            robbie_msgs.LightsState,
            robbie_msgs.LocalizationState,
            robbie_msgs.MapAnnotated,
            robbie_msgs.MapAnnotationUndone,
            robbie_msgs.MapAnnotations,
            robbie_msgs.MappingState,
            robbie_msgs.Mark,
            robbie_msgs.ModuleState,
            robbie_msgs.NavigateTo,
            robbie_msgs.NavigationCancelled,
            robbie_msgs.NavigationFeedback,
            robbie_msgs.NavigationResult,
            robbie_msgs.PanTiltCommand,
            robbie_msgs.PathPlanned,
            robbie_msgs.PlanPath,
            robbie_msgs.PointsOfInterest,
            robbie_msgs.RecognitionForgotten,
            robbie_msgs.RecognitionTaught,
            robbie_msgs.SetLight,
            robbie_msgs.SetControl,
            robbie_msgs.SettingChange,
            robbie_msgs.SettingChanged,
            robbie_msgs.SimulatedWorld,
            robbie_msgs.TaughtNames,
            robbie_msgs.TeachRecognition,
            robbie_msgs.UndoMapAnnotation,
            scene_msgs.SceneGraphState,
            sensor_msgs.BatteryState,
            sensor_msgs.CameraInfo,
            sensor_msgs.CompressedImage,
            sensor_msgs.Image,
            sensor_msgs.Imu,
            sensor_msgs.JointState,
            sensor_msgs.Joy,
            sensor_msgs.LaserScan,
            sensor_msgs.NavSatFix,
            sensor_msgs.PointCloud2,
            std_msgs.String,
            tf2_msgs.TFMessage,
            vision_msgs.Detection2DArray,
        )
    )


_known = cache(stock_registry)


def is_stock(message_type: type[Message]) -> bool:
    """Whether a class is that of a stock message."""
    return message_type.__module__.startswith(f"{__package__}.")  # a registry would take 1 to 4 ms to build


@lru_cache(64)
def class_with_rules(type_name: str, version: int) -> type[Message] | None:
    """Return the class of a stock type that some messages break; None for all other types and versions."""
    try:
        found = _known().get(type_name)
    except UnknownType:
        return None
    return found if found.version == version and found.has_rules else None
