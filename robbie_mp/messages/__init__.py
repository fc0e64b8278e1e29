"""Messages: declared as classes, encoded as ROS 2 does (CDR), described by ros2msg schemas.

How to declare one, versions, loans and limits: docs/messages.md.
"""

from robbie_mp.messages.errors import (
    BufferTooSmall,
    DeclarationError,
    DecodeError,
    DuplicateType,
    FieldError,
    FieldTypeError,
    FieldValueError,
    MessageError,
    SchemaError,
    UnknownType,
    VersionError,
)
from robbie_mp.messages.field_types import DEFAULT, FixedLength, MaxLength
from robbie_mp.messages.loans import Layout, lay_out
from robbie_mp.messages.message import Message, replace
from robbie_mp.messages.plain import as_dict, from_dict
from robbie_mp.messages.primitives import (
    Array,
    bool_,
    byte,
    char,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    uint8,
    uint16,
    uint32,
    uint64,
)
from robbie_mp.messages.registry import TypeRegistry
from robbie_mp.messages.schema import nested_types, schema_text
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.builtin_interfaces import Duration, Time
from robbie_mp.messages.stock.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    TwistStamped,
    TwistWithCovariance,
    Vector3,
)
from robbie_mp.messages.stock.nav_msgs import MapMetaData, OccupancyGrid, Odometry, Path
from robbie_mp.messages.stock.profiler_msgs import ChannelProfile, ModuleProfile, SystemProfile
from robbie_mp.messages.stock.rcl_interfaces import Log
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.messages.stock.robbie_msgs import DriveCommand, ModuleState, SettingChange, SettingChanged
from robbie_mp.messages.stock.sensor_msgs import (
    BatteryState,
    CompressedImage,
    Image,
    Imu,
    JointState,
    Joy,
    LaserScan,
    NavSatFix,
    NavSatStatus,
    PointCloud2,
    PointField,
)
from robbie_mp.messages.stock.std_msgs import Header
from robbie_mp.messages.stock.tf2_msgs import TFMessage
from robbie_mp.messages.versions import Upgrade, decode_version

__all__ = [
    "DEFAULT",
    "Array",
    "BatteryState",
    "BufferTooSmall",
    "ChannelProfile",
    "CompressedImage",
    "DeclarationError",
    "DecodeError",
    "DriveCommand",
    "DuplicateType",
    "Duration",
    "FieldError",
    "FieldTypeError",
    "FieldValueError",
    "FixedLength",
    "Header",
    "Image",
    "Imu",
    "JointState",
    "Joy",
    "LaserScan",
    "Layout",
    "Log",
    "MapMetaData",
    "MaxLength",
    "Message",
    "MessageError",
    "ModuleProfile",
    "ModuleState",
    "NavSatFix",
    "NavSatStatus",
    "OccupancyGrid",
    "Odometry",
    "Path",
    "Point",
    "PointCloud2",
    "PointField",
    "Pose",
    "PoseStamped",
    "PoseWithCovariance",
    "Quaternion",
    "SchemaError",
    "SettingChange",
    "SettingChanged",
    "SystemProfile",
    "TFMessage",
    "Time",
    "Transform",
    "TransformStamped",
    "Twist",
    "TwistStamped",
    "TwistWithCovariance",
    "TypeRegistry",
    "UnknownType",
    "Upgrade",
    "Vector3",
    "VersionError",
    "as_dict",
    "bool_",
    "byte",
    "char",
    "decode_version",
    "float32",
    "float64",
    "from_dict",
    "int8",
    "int16",
    "int32",
    "int64",
    "lay_out",
    "message_type_from_schema",
    "nested_types",
    "replace",
    "schema_text",
    "stock_registry",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
]
