"""The stock messages by name."""

from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.stock import (
    geometry_msgs,
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
            geometry_msgs.PoseStamped,
            geometry_msgs.TwistStamped,
            nav_msgs.OccupancyGrid,
            nav_msgs.Odometry,
            nav_msgs.Path,
            playback_msgs.PlaybackControl,
            playback_msgs.PlaybackState,
            playback_msgs.TimeJump,
            profiler_msgs.SystemProfile,
            rcl_interfaces.Log,
            robbie_msgs.Bumper,
            robbie_msgs.CallRefusal,
            robbie_msgs.CallsAnswer,
            robbie_msgs.CallsQuestion,
            robbie_msgs.CancelGoal,
            robbie_msgs.DeviceState,
            robbie_msgs.DriveCommand,
            robbie_msgs.EmergencyStop,
            robbie_msgs.Frontiers,
            robbie_msgs.GoalCancel,
            robbie_msgs.GoalEnd,
            robbie_msgs.LocalizationState,
            robbie_msgs.Mark,
            robbie_msgs.ModuleState,
            robbie_msgs.NavigationState,
            robbie_msgs.PanTiltCommand,
            robbie_msgs.PointsOfInterest,
            robbie_msgs.SettingChange,
            robbie_msgs.SettingChanged,
            robbie_msgs.SimulatedWorld,
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
