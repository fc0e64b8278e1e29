"""What sensors measure (ROS sensor_msgs)."""

from typing import ClassVar, Literal

from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, float64, int8, int32, uint8, uint16, uint32
from robbie_mp.messages.stock.geometry_msgs import Quaternion, Vector3
from robbie_mp.messages.stock.std_msgs import Header


class LaserScan(Message, name="sensor_msgs/msg/LaserScan", version=1):
    """One sweep of a planar laser range finder."""

    header: (
        Header  # stamp: of the first ray; frame_id: the scanner's, rays turn about its z axis from its x axis
    )
    angle_min: float32  # rad, of the first ray
    angle_max: float32  # rad, of the last ray
    angle_increment: float32  # rad between rays
    time_increment: float32  # s between rays
    scan_time: float32  # s between sweeps
    range_min: float32  # m, nearer ranges are no measurement
    range_max: float32  # m, farther ranges are no return
    ranges: Array[float32]  # (N,) m
    intensities: Array[float32]  # (N,) in the device's unit, or empty


class Image(Message, name="sensor_msgs/msg/Image", version=1):
    """An uncompressed camera image."""

    header: Header  # stamp: of the exposure; frame_id: the camera's optical frame, x right, y down, z forward
    height: uint32  # rows
    width: uint32  # columns
    encoding: str  # of a pixel, as in "rgb8", "bgr8", "mono8", "16UC1"
    is_bigendian: uint8  # 1 if the values of a pixel are
    step: uint32  # bytes in a row
    data: Array[uint8]  # (height * step,)


class CompressedImage(Message, name="sensor_msgs/msg/CompressedImage", version=1):
    """A compressed camera image."""

    header: Header
    format: str  # as in "jpeg", "png"
    data: Array[uint8]  # (N,) the compressed file


class PointField(Message, name="sensor_msgs/msg/PointField", version=1):
    """One value of each point of a point cloud."""

    INT8: ClassVar[uint8] = 1
    UINT8: ClassVar[uint8] = 2
    INT16: ClassVar[uint8] = 3
    UINT16: ClassVar[uint8] = 4
    INT32: ClassVar[uint8] = 5
    UINT32: ClassVar[uint8] = 6
    FLOAT32: ClassVar[uint8] = 7
    FLOAT64: ClassVar[uint8] = 8

    name: str  # as in "x", "y", "z", "intensity"
    offset: uint32  # bytes from the start of the point
    datatype: uint8  # one of the constants above
    count: uint32  # of elements


class PointCloud2(Message, name="sensor_msgs/msg/PointCloud2", version=1):
    """Points in space, with other values to each."""

    header: Header
    height: uint32  # rows; 1 if the points have no order
    width: uint32  # points in a row
    fields: list[PointField]  # what is in a point
    is_bigendian: bool
    point_step: uint32  # bytes of a point
    row_step: uint32  # bytes of a row
    data: Array[uint8]  # (height * row_step,)
    is_dense: bool  # no point is invalid (NaN)


class Imu(Message, name="sensor_msgs/msg/Imu", version=1):
    """What an inertial measurement unit measures. A covariance that begins with -1: there is no such data."""

    header: Header
    orientation: Quaternion
    orientation_covariance: Array[float64, Literal[9]]  # row-major 3 x 3, rad^2
    angular_velocity: Vector3  # rad/s
    angular_velocity_covariance: Array[float64, Literal[9]]  # row-major 3 x 3, (rad/s)^2
    linear_acceleration: Vector3  # m/s^2, gravity included
    linear_acceleration_covariance: Array[float64, Literal[9]]  # row-major 3 x 3, (m/s^2)^2


class BatteryState(Message, name="sensor_msgs/msg/BatteryState", version=1):
    """The state of a power supply. NaN: not measured."""

    POWER_SUPPLY_STATUS_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_STATUS_CHARGING: ClassVar[uint8] = 1
    POWER_SUPPLY_STATUS_DISCHARGING: ClassVar[uint8] = 2
    POWER_SUPPLY_STATUS_NOT_CHARGING: ClassVar[uint8] = 3
    POWER_SUPPLY_STATUS_FULL: ClassVar[uint8] = 4
    POWER_SUPPLY_HEALTH_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_HEALTH_GOOD: ClassVar[uint8] = 1
    POWER_SUPPLY_HEALTH_OVERHEAT: ClassVar[uint8] = 2
    POWER_SUPPLY_HEALTH_DEAD: ClassVar[uint8] = 3
    POWER_SUPPLY_HEALTH_OVERVOLTAGE: ClassVar[uint8] = 4
    POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: ClassVar[uint8] = 5
    POWER_SUPPLY_HEALTH_COLD: ClassVar[uint8] = 6
    POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: ClassVar[uint8] = 7
    POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: ClassVar[uint8] = 8
    POWER_SUPPLY_TECHNOLOGY_UNKNOWN: ClassVar[uint8] = 0
    POWER_SUPPLY_TECHNOLOGY_NIMH: ClassVar[uint8] = 1
    POWER_SUPPLY_TECHNOLOGY_LION: ClassVar[uint8] = 2
    POWER_SUPPLY_TECHNOLOGY_LIPO: ClassVar[uint8] = 3
    POWER_SUPPLY_TECHNOLOGY_LIFE: ClassVar[uint8] = 4
    POWER_SUPPLY_TECHNOLOGY_NICD: ClassVar[uint8] = 5
    POWER_SUPPLY_TECHNOLOGY_LIMN: ClassVar[uint8] = 6
    POWER_SUPPLY_TECHNOLOGY_TERNARY: ClassVar[uint8] = 7
    POWER_SUPPLY_TECHNOLOGY_VRLA: ClassVar[uint8] = 8

    header: Header
    voltage: float32  # V
    temperature: float32  # °C
    current: float32  # A, negative when discharging
    charge: float32  # Ah left
    capacity: float32  # Ah when last full
    design_capacity: float32  # Ah
    percentage: float32  # charge as a ratio, 0 to 1
    power_supply_status: uint8  # one of the constants above
    power_supply_health: uint8
    power_supply_technology: uint8
    present: bool
    cell_voltage: Array[float32]  # (cells,) V, or empty
    cell_temperature: Array[float32]  # (cells,) °C, or empty
    location: str  # slot of the battery
    serial_number: str


class JointState(Message, name="sensor_msgs/msg/JointState", version=1):
    """Where joints are and how they move. Each array has an element for each name, or none at all."""

    header: Header
    name: list[str]
    position: Array[float64]  # (joints,) rad or m
    velocity: Array[float64]  # (joints,) rad/s or m/s
    effort: Array[float64]  # (joints,) Nm or N


class Joy(Message, name="sensor_msgs/msg/Joy", version=1):
    """The sticks and buttons of a gamepad."""

    header: Header
    axes: Array[float32]  # (axes,) -1 to 1
    buttons: Array[int32]  # (buttons,) 1 pressed, 0 not


class NavSatStatus(Message, name="sensor_msgs/msg/NavSatStatus", version=1):
    """What a satellite fix rests on."""

    STATUS_UNKNOWN: ClassVar[int8] = -2
    STATUS_NO_FIX: ClassVar[int8] = -1
    STATUS_FIX: ClassVar[int8] = 0
    STATUS_SBAS_FIX: ClassVar[int8] = 1
    STATUS_GBAS_FIX: ClassVar[int8] = 2
    SERVICE_UNKNOWN: ClassVar[uint16] = 0
    SERVICE_GPS: ClassVar[uint16] = 1
    SERVICE_GLONASS: ClassVar[uint16] = 2
    SERVICE_COMPASS: ClassVar[uint16] = 4
    SERVICE_GALILEO: ClassVar[uint16] = 8

    status: int8 = -2  # one of the constants above
    service: uint16 = 0  # sum of the SERVICE constants


class NavSatFix(Message, name="sensor_msgs/msg/NavSatFix", version=1):
    """A position from a satellite navigation system (WGS 84)."""

    COVARIANCE_TYPE_UNKNOWN: ClassVar[uint8] = 0
    COVARIANCE_TYPE_APPROXIMATED: ClassVar[uint8] = 1
    COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[uint8] = 2
    COVARIANCE_TYPE_KNOWN: ClassVar[uint8] = 3

    header: Header  # frame_id: the antenna's
    status: NavSatStatus
    latitude: float64  # degrees, north positive
    longitude: float64  # degrees, east positive
    altitude: float64  # m above the ellipsoid
    position_covariance: Array[float64, Literal[9]]  # row-major 3 x 3 of east, north, up, m^2
    position_covariance_type: uint8  # one of the constants above
