"""Measurements of sensors (ROS sensor_msgs)."""

import math
from typing import ClassVar, Literal

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import (
    MAX_MAGNITUDE,
    MAX_POSITION_M,
    Flaw,
    beyond,
    elements_beyond,
    outside,
    unlike_lengths,
    wrong_size,
)
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, float64, int8, int32, uint8, uint16, uint32
from robbie_mp.messages.stock.geometry_msgs import Quaternion, Vector3
from robbie_mp.messages.stock.std_msgs import Header

MAX_ANGLE_RAD = 1e3
MAX_SCAN_S = 1e3
MAX_TURNS_RAD = 4.0 * math.pi + 0.1
"""The most that a sweep covers, in rad."""


class LaserScan(Message, name="sensor_msgs/msg/LaserScan", version=1):
    """One sweep of a planar laser range finder.

    Angles are about the z axis of the frame, counter-clockwise, 0 along the x axis.
    """

    header: Header = DEFAULT  # stamp: of the first ray; frame_id: the scanner's
    angle_min: float32 = DEFAULT  # rad, of the first ray
    angle_max: float32 = DEFAULT  # rad, of the last ray
    angle_increment: float32 = DEFAULT  # rad between rays
    time_increment: float32 = DEFAULT  # s between rays
    scan_time: float32 = DEFAULT  # s between sweeps
    range_min: float32 = DEFAULT  # m, nearer ranges are no measurement
    range_max: float32 = DEFAULT  # m, farther ranges are no return
    ranges: Array[float32] = DEFAULT  # (N,) m
    intensities: Array[float32] = DEFAULT  # (N,) in the device's unit, or empty

    def flaw(self) -> Flaw | None:
        """Return a geometry that beams cannot have. Ranges may be anything: NaN and infinity have meanings.

        Without an increment, all beams must have the same direction, as where nothing is known of them.
        """
        angles = beyond(self, MAX_ANGLE_RAD, "angle_min", "angle_max", "angle_increment")
        times = outside(self, 0.0, MAX_SCAN_S, "scan_time") or beyond(self, MAX_SCAN_S, "time_increment")
        limits = outside(self, 0.0, MAX_POSITION_M, "range_min") or outside(
            self, self.range_min, math.inf, "range_max"
        )
        if (flaw := angles or times or limits) is not None:
            return flaw
        if self.angle_increment == 0.0 and self.angle_min != self.angle_max and len(self.ranges) > 1:
            return Flaw("angle_increment", 0.0, "the angle between two beams")
        if abs(self.angle_increment) * len(self.ranges) > MAX_TURNS_RAD:
            return Flaw(
                "angle_increment", self.angle_increment, f"at most two turns for {len(self.ranges)} beams"
            )
        return unlike_lengths(self, "ranges", "intensities", or_empty=True)


PIXEL_BYTES = (
    dict.fromkeys(("mono8", "8UC1", "8SC1"), 1)
    | dict.fromkeys((f"bayer_{order}8" for order in ("rggb", "bggr", "gbrg", "grbg")), 1)
    | dict.fromkeys(("mono16", "16UC1", "16SC1", "8UC2", "yuv422", "yuv422_yuy2"), 2)
    | dict.fromkeys((f"bayer_{order}16" for order in ("rggb", "bggr", "gbrg", "grbg")), 2)
    | dict.fromkeys(("rgb8", "bgr8", "8UC3"), 3)
    | dict.fromkeys(("rgba8", "bgra8", "8UC4", "32FC1", "32SC1"), 4)
    | dict.fromkeys(("rgb16", "bgr16"), 6)
    | dict.fromkeys(("rgba16", "bgra16", "64FC1"), 8)
)
"""Bytes of a pixel of the encodings of ROS whose rows lie one after another."""


class Image(Message, name="sensor_msgs/msg/Image", version=1):
    """An uncompressed camera image."""

    header: Header = DEFAULT  # stamp: of the exposure; frame_id: the camera's, x right, y down, z forward
    height: uint32 = DEFAULT  # rows
    width: uint32 = DEFAULT  # columns
    encoding: str = DEFAULT  # of a pixel, as in "rgb8", "bgr8", "mono8", "16UC1"
    is_bigendian: uint8 = DEFAULT  # 1 if the values of a pixel are
    step: uint32 = DEFAULT  # bytes in a row
    data: Array[uint8] = DEFAULT  # (height * step,)

    def flaw(self) -> Flaw | None:
        """Return a size that does not fit the data. Of unknown encodings, only the data may be missing."""
        if not len(self.data) and not self.height * self.width:
            return None
        pixel = PIXEL_BYTES.get(self.encoding)
        if pixel is None:
            return None
        if self.step < self.width * pixel:
            return Flaw("step", self.step, f"at least {self.width * pixel} bytes, width times {pixel}")
        return wrong_size(self, "data", self.height * self.step, "height times step")


class CompressedImage(Message, name="sensor_msgs/msg/CompressedImage", version=1):
    """A compressed camera image."""

    header: Header = DEFAULT
    format: str = DEFAULT  # as in "jpeg", "png"
    data: Array[uint8] = DEFAULT  # (N,) the compressed file


class RegionOfInterest(Message, name="sensor_msgs/msg/RegionOfInterest", version=1):
    """A part of an image; all zero: the whole image."""

    x_offset: uint32 = DEFAULT  # leftmost column
    y_offset: uint32 = DEFAULT  # topmost row
    height: uint32 = DEFAULT
    width: uint32 = DEFAULT
    do_rectify: bool = DEFAULT  # a rectified region is to be made of the raw one


class CameraInfo(Message, name="sensor_msgs/msg/CameraInfo", version=1):
    """How a camera projects points of its optical frame (x right, y down, z forward) onto pixels."""

    header: Header = DEFAULT  # stamp and frame_id: those of the image
    height: uint32 = DEFAULT  # rows
    width: uint32 = DEFAULT  # columns
    distortion_model: str = DEFAULT  # as in "plumb_bob"
    d: Array[float64] = DEFAULT  # (N,) of the distortion model; empty or zero: no distortion
    k: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3: fx 0 cx, 0 fy cy, 0 0 1, in pixels
    r: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3: rectification
    p: Array[float64, Literal[12]] = DEFAULT  # row-major 3 x 4: projection of rectified images
    binning_x: uint32 = DEFAULT
    binning_y: uint32 = DEFAULT
    roi: RegionOfInterest = DEFAULT

    @property
    def is_calibrated(self) -> bool:
        """Whether `k` is known: a camera that is not calibrated sends it with all 0."""
        return bool(self.k.any())

    def flaw(self) -> Flaw | None:
        """Return numbers that are not finite. A `k` that is all 0 says that the camera is not calibrated."""
        if (flaw := elements_beyond(self, MAX_MAGNITUDE, "d", "k", "r", "p")) is not None:
            return flaw
        fx, fy = self.k[0].item(), self.k[4].item()
        if not (fx > 0.0 and fy > 0.0) and self.k.any():
            return Flaw("k", self.k.tolist(), "focal lengths greater than 0, or all 0")
        return None


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

    name: str = DEFAULT  # as in "x", "y", "z", "intensity"
    offset: uint32 = DEFAULT  # bytes from the start of the point
    datatype: uint8 = DEFAULT  # one of the constants above
    count: uint32 = DEFAULT  # of elements


VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}
"""Bytes of a value, by its `PointField.datatype`."""


class PointCloud2(Message, name="sensor_msgs/msg/PointCloud2", version=1):
    """Points in space, each with further values."""

    header: Header = DEFAULT
    height: uint32 = DEFAULT  # rows; 1 if the points have no order
    width: uint32 = DEFAULT  # points in a row
    fields: list[PointField] = DEFAULT  # what is in a point
    is_bigendian: bool = DEFAULT
    point_step: uint32 = DEFAULT  # bytes of a point
    row_step: uint32 = DEFAULT  # bytes of a row
    data: Array[uint8] = DEFAULT  # (height * row_step,)
    is_dense: bool = DEFAULT  # no point is invalid (NaN)

    def flaw(self) -> Flaw | None:
        """Return a size that does not fit the data, or a value outside the point."""
        points = self.width * self.height
        if points and not self.point_step:
            return Flaw("point_step", 0, "the bytes of a point")
        for index, field in enumerate(self.fields):
            size = VALUE_BYTES.get(field.datatype)
            if size is None:
                return Flaw(f"fields[{index}].datatype", field.datatype, f"1 to {len(VALUE_BYTES)}")
            if points and field.offset + size * field.count > self.point_step:
                return Flaw(f"fields[{index}].offset", field.offset, f"to end within {self.point_step} bytes")
        if self.row_step < self.width * self.point_step:
            return Flaw("row_step", self.row_step, f"at least {self.width * self.point_step} bytes")
        return wrong_size(self, "data", self.height * self.row_step, "height times row_step")


class Imu(Message, name="sensor_msgs/msg/Imu", version=1):
    """Data of an inertial measurement unit. A covariance that begins with -1: there is no such data."""

    header: Header = DEFAULT
    orientation: Quaternion = DEFAULT
    orientation_covariance: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3, rad^2
    angular_velocity: Vector3 = DEFAULT  # rad/s
    angular_velocity_covariance: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3, (rad/s)^2
    linear_acceleration: Vector3 = DEFAULT  # m/s^2, gravity included
    linear_acceleration_covariance: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3, (m/s^2)^2


MAX_CHARGE = 1.1
"""Some batteries say a little more than full."""


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

    header: Header = DEFAULT
    voltage: float32 = DEFAULT  # V
    temperature: float32 = DEFAULT  # °C
    current: float32 = DEFAULT  # A, negative when discharging
    charge: float32 = DEFAULT  # Ah left
    capacity: float32 = DEFAULT  # Ah when last full
    design_capacity: float32 = DEFAULT  # Ah
    percentage: float32 = DEFAULT  # charge as a ratio, 0 to 1
    power_supply_status: uint8 = DEFAULT  # one of the constants above
    power_supply_health: uint8 = DEFAULT
    power_supply_technology: uint8 = DEFAULT
    present: bool = DEFAULT
    cell_voltage: Array[float32] = DEFAULT  # (cells,) V, or empty
    cell_temperature: Array[float32] = DEFAULT  # (cells,) °C, or empty
    location: str = DEFAULT  # slot of the battery
    serial_number: str = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return a charge that no battery has, or infinity where NaN stands for what is not measured."""
        numbers = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
        return outside(self, 0.0, MAX_CHARGE, "percentage", nan=True) or outside(
            self, -MAX_MAGNITUDE, MAX_MAGNITUDE, *numbers, nan=True
        )


class JointState(Message, name="sensor_msgs/msg/JointState", version=1):
    """Where joints are and how they move. Each array has an element for each name, or none at all."""

    header: Header = DEFAULT
    name: list[str] = DEFAULT
    position: Array[float64] = DEFAULT  # (joints,) rad or m
    velocity: Array[float64] = DEFAULT  # (joints,) rad/s or m/s
    effort: Array[float64] = DEFAULT  # (joints,) Nm or N

    def flaw(self) -> Flaw | None:
        """Return whether there are more or fewer values than joints, or a position that is not finite.

        Velocity and effort may be NaN: not every joint measures them.
        """
        return unlike_lengths(
            self, "name", "position", "velocity", "effort", or_empty=True
        ) or elements_beyond(self, MAX_MAGNITUDE, "position")


MAX_AXIS = 1e3


class Joy(Message, name="sensor_msgs/msg/Joy", version=1):
    """The sticks and buttons of a gamepad."""

    header: Header = DEFAULT
    axes: Array[float32] = DEFAULT  # (axes,) -1 to 1
    buttons: Array[int32] = DEFAULT  # (buttons,) 1 pressed, 0 not

    def flaw(self) -> Flaw | None:
        """Return an axis that is not finite."""
        return elements_beyond(self, MAX_AXIS, "axes")


class NavSatStatus(Message, name="sensor_msgs/msg/NavSatStatus", version=1):
    """The status and source of a satellite fix."""

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
    service: uint16 = DEFAULT  # sum of the SERVICE constants


class NavSatFix(Message, name="sensor_msgs/msg/NavSatFix", version=1):
    """A position from a satellite navigation system (WGS 84)."""

    header: Header = DEFAULT  # frame_id: the antenna's
    status: NavSatStatus = DEFAULT
    latitude: float64 = DEFAULT  # degrees, north positive
    longitude: float64 = DEFAULT  # degrees, east positive
    altitude: float64 = DEFAULT  # m above the ellipsoid
    position_covariance: Array[float64, Literal[9]] = DEFAULT  # row-major 3 x 3 of east, north, up, m^2

    COVARIANCE_TYPE_UNKNOWN: ClassVar[uint8] = 0
    COVARIANCE_TYPE_APPROXIMATED: ClassVar[uint8] = 1
    COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[uint8] = 2
    COVARIANCE_TYPE_KNOWN: ClassVar[uint8] = 3
    position_covariance_type: uint8 = DEFAULT  # one of the constants above

    def flaw(self) -> Flaw | None:
        """Return a place that is none, if there is a fix. The altitude may be NaN."""
        if self.status.status < NavSatStatus.STATUS_FIX:
            return None
        return (
            outside(self, -90.0, 90.0, "latitude")
            or outside(self, -180.0, 180.0, "longitude")
            or outside(self, -MAX_POSITION_M, MAX_POSITION_M, "altitude", nan=True)
        )
