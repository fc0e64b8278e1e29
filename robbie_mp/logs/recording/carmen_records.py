"""The records of CARMEN logs, a line of text each.

The format is that of the Carnegie Mellon Robot Navigation Toolkit (Montemerlo, Roy and Thrun, IROS 2003), as
its logger writes it and explains in the header of each log. It has two dialects: `FLASER` and `RLASER`, which
state no angles, and since 2004 `RAWLASER` and `ROBOTLASER`, which do. All lines end with the time at which
something was measured, the host, and the time since the start of the log at which it was recorded.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Pose2 = tuple[float, float, float]
"""x in m, y in m, heading in rad."""
FRONT, REAR = 1, 2
"""CARMEN's numbers of the lasers that its robot has; there may be more."""
NO_RETURN_M = 81.0
"""The limit of the scanners of the older dialect, which report 81.83 m and more where nothing returned."""
MAX_TIME_S = 2.0**31 - 1
"""Stamps have 31 bits for the seconds."""
MAX_NUMBER = 1e30
"""Messages have 32-bit floats."""
MAX_BEAMS_DIGITS = 6


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A record.

    Attributes:
        ipc_time_s: when it was measured; may jitter, even backwards.
        logger_time_s: when it was recorded, since the start of the log.
    """

    ipc_time_s: float
    logger_time_s: float


@dataclass(frozen=True, kw_only=True)
class OdometryRecord(Recorded):
    """Robot pose and velocity from wheel odometry: m, rad, m/s, rad/s, in the odometry frame."""

    x_m: float
    y_m: float
    theta_rad: float
    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


def _nothing() -> NDArray[np.float32]:
    return np.zeros(0, np.float32)


@dataclass(frozen=True, kw_only=True)
class RawLaserRecord(Recorded):
    """A sweep of a laser, counter-clockwise.

    Attributes:
        laser: CARMEN's number of it.
        ranges_m: `(N,) float32`; a range at the sensor's limit means no return.
        angle_min_rad: bearing of the first beam in the laser's frame.
        angle_increment_rad: from one beam to the next.
        range_max_m: the sensor's limit.
        remissions: `(N,) float32` in the sensor's unit, or empty.
    """

    laser: int
    ranges_m: NDArray[np.float32]
    angle_min_rad: float
    angle_increment_rad: float
    range_max_m: float = NO_RETURN_M
    remissions: NDArray[np.float32] = field(default_factory=_nothing)


@dataclass(frozen=True, kw_only=True)
class LaserRecord(RawLaserRecord):
    """A sweep of a laser, with the pose of the robot.

    Attributes:
        robot_pose: odometry's pose of the robot at the time.
        velocity: of the robot, m/s and rad/s; 0 where the line does not state it.
        laser_pose: pose of the laser in the robot's frame.
        states_place: whether `laser_pose` is certain. The first poses in lines of the older dialect may also
            be corrected poses of the robot.
    """

    robot_pose: Pose2
    velocity: tuple[float, float] = (0.0, 0.0)
    laser_pose: Pose2
    states_place: bool

    @property
    def odometry(self) -> OdometryRecord:
        """What the line says of the robot."""
        x, y, theta = self.robot_pose
        linear, angular = self.velocity
        return OdometryRecord(
            x_m=x,
            y_m=y,
            theta_rad=theta,
            linear_m_s=linear,
            angular_rad_s=angular,
            ipc_time_s=self.ipc_time_s,
            logger_time_s=self.logger_time_s,
        )


@dataclass(frozen=True, kw_only=True)
class PoseRecord(Recorded):
    """The pose of the robot on the map: the true one in a simulation, or an estimate (`is_true`)."""

    pose: Pose2
    is_true: bool


@dataclass(frozen=True, kw_only=True)
class ImuRecord(Recorded):
    """Acceleration in m/s^2, orientation as quaternion (w, x, y, z), turn rates in rad/s."""

    acceleration: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    turn_rates: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class FixRecord(Recorded):
    """A position from satellites.

    Attributes:
        receiver: number of the receiver.
        latitude_deg, longitude_deg: WGS 84, positive to the north and to the east.
        quality: as in a GGA sentence of NMEA 0183; 0: there is no fix.
        height_m: above the ellipsoid.
    """

    receiver: int
    latitude_deg: float
    longitude_deg: float
    quality: int
    height_m: float


Record = OdometryRecord | RawLaserRecord | PoseRecord | ImuRecord | FixRecord


def reader_of(kind: str) -> Callable[[list[str]], Record] | None:
    """Return the function that reads the words of a line of a kind; None if no record is made of it.

    The function raises ValueError if the line cannot be read.
    """
    return _READERS.get(kind) or next((reader for name, reader in _NUMBERED if name.fullmatch(kind)), None)


def beam_angles(beams: int) -> tuple[float, float]:
    """Return the first bearing and the increment (rad) of a line of the older dialect, which states neither.

    The field of view is 180 degrees from -90 degrees on. A SICK scanner measures at both ends of it: 181 or
    361 beams, N - 1 steps. Loggers that kept an even number left out the last beam, so the steps are the
    same: 180 beams one degree apart, 360 half a degree. Dividing by N - 1 there would stretch each sweep by
    one step. With 401 or 400 beams it measures 100 degrees; the first bearing then is -50 degrees.
    """
    if beams < 2:
        raise ValueError("one beam alone has no angle between beams; at least 2 are needed")
    if beams in {400, 401}:
        return -math.radians(50), math.radians(0.25)
    steps = beams if beams % 2 == 0 else beams - 1
    return -math.pi / 2, math.pi / steps


def relative(base: Pose2, pose: Pose2) -> Pose2:
    """Return a pose in the frame of another one."""
    east, north, turn = pose[0] - base[0], pose[1] - base[1], pose[2] - base[2]
    cos, sin = math.cos(base[2]), math.sin(base[2])
    return cos * east + sin * north, cos * north - sin * east, math.remainder(turn, math.tau)


def numbers(texts: list[str]) -> list[float]:
    """Convert words to finite numbers.

    Raises:
        ValueError: a word is none.
    """
    found = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            raise ValueError(f"{text[:40]!r} is not a number") from None
        if not math.isfinite(number):
            raise ValueError(f"{text[:40]!r} is not a finite number")
        if abs(number) > MAX_NUMBER:
            raise ValueError(f"{text[:40]!r} is too large")
        found.append(number)
    return found


def _odometry(words: list[str]) -> OdometryRecord:
    _expect(words, 10)
    x, y, theta, linear, angular, _ = numbers(words[1:7])
    return OdometryRecord(
        x_m=x, y_m=y, theta_rad=theta, linear_m_s=linear, angular_rad_s=angular, **_times(words)
    )


def _pose(words: list[str]) -> PoseRecord:
    _expect(words, 10)
    x, y, theta, *_odometry_pose = numbers(words[1:7])
    return PoseRecord(pose=(x, y, theta), is_true=words[0] == "TRUEPOS", **_times(words))


def _old_laser(words: list[str]) -> LaserRecord:
    beams = _beams(words)
    _expect(words, beams + 11)
    x, y, theta, *robot = numbers(words[2 + beams : 8 + beams])
    pose = (robot[0], robot[1], robot[2])
    return LaserRecord(
        laser=FRONT if words[0] == "FLASER" else REAR,
        robot_pose=pose,
        laser_pose=relative(pose, (x, y, theta)),
        states_place=False,
        **_old_sweep(words, beams),
    )


def _old_raw_laser(words: list[str]) -> RawLaserRecord:
    beams = _beams(words)
    _expect(words, beams + 5)
    return RawLaserRecord(laser=int(words[0][5:] or FRONT), **_old_sweep(words, beams))


def _old_sweep(words: list[str], beams: int) -> dict[str, Any]:
    first, step = beam_angles(beams)
    angles = {"angle_min_rad": first, "angle_increment_rad": step}
    return {"ranges_m": _ranges(words, 2, beams), **angles, **_times(words)}


def _new_laser(words: list[str]) -> LaserRecord:
    sweep, rest = _new_sweep(words, 11)
    poses = numbers(words[rest : rest + 8])
    robot = (poses[3], poses[4], poses[5])
    place = relative(robot, (poses[0], poses[1], poses[2]))
    return LaserRecord(
        **sweep, robot_pose=robot, laser_pose=place, states_place=True, velocity=(poses[6], poses[7])
    )


def _new_raw_laser(words: list[str]) -> RawLaserRecord:
    return RawLaserRecord(**_new_sweep(words, 0)[0])


def _new_sweep(words: list[str], more: int) -> tuple[dict[str, Any], int]:
    """Read a sweep with its angles; return it and the place of what follows.

    Args:
        words: the line.
        more: number of words between the sweep and the times.
    """
    at, has_remissions = _new_layout(words, more)
    start, view, step, limit = numbers(words[2:6])
    beams = _beams(words, at)
    ranges = _ranges(words, at + 1, beams)
    after = at + 1 + beams
    remissions = int(words[after]) if has_remissions else 0
    if remissions not in (0, beams):
        raise ValueError(f"{words[0]} has {remissions} remissions for {beams} beams")
    values = numbers(words[after + 1 : after + 1 + remissions])
    return {
        "laser": int(words[0][-1]),
        "ranges_m": ranges,
        "angle_min_rad": start,
        "angle_increment_rad": step or view / max(1, beams - 1),
        "range_max_m": limit,
        "remissions": np.array(values, np.float32),
        **_times(words),
    }, after + has_remissions + remissions


def _new_layout(words: list[str], more: int) -> tuple[int, bool]:
    """Return where the number of beams is, and whether remissions follow the ranges.

    The first loggers of the newer dialect wrote no mode of the remissions before the beams, or none at all.
    """
    for at in (8, 7):
        beams = words[at] if at < len(words) else ""
        after = at + 1 + int(beams) if _is_count(beams) else len(words)
        remissions = words[after] if after < len(words) else ""
        is_counted = remissions == "0" or _is_count(remissions)
        if is_counted and len(words) == after + 1 + int(remissions) + more + 3:
            return at, True
        if len(words) == after + more + 3:
            return at, False
    raise ValueError(f"{words[0]} has {len(words) - 1} fields, which do not fit its number of beams")


def _imu(words: list[str]) -> ImuRecord:
    _expect(words, 17)
    ax, ay, az, w, x, y, z, _, _, _, gx, gy, gz = numbers(words[1:14])
    return ImuRecord(
        acceleration=(ax, ay, az), orientation=(w, x, y, z), turn_rates=(gx, gy, gz), **_times(words)
    )


def _fix(words: list[str]) -> FixRecord:
    _expect(words, 18)
    receiver, quality = numbers([words[1], words[7]])
    above_sea_m, _unit, geoid_m = numbers(words[10:13])
    return FixRecord(
        receiver=int(receiver),
        latitude_deg=_degrees(words[3], words[4], "NS", 90),
        longitude_deg=_degrees(words[5], words[6], "EW", 180),
        quality=int(quality),
        height_m=above_sea_m + geoid_m,
        **_times(words),
    )


def _degrees(text: str, side: str, sides: str, most: int) -> float:
    """Convert degrees and minutes (DDMM.MMMM) to degrees."""
    (value,) = numbers([text])
    degrees, minutes = divmod(value, 100)
    angle = degrees + minutes / 60
    if value < 0 or minutes >= 60 or angle > most or side not in tuple(sides):
        raise ValueError(f"{text[:40]!r} {side[:40]!r} are no degrees and minutes up to {most} degrees")
    return angle if side == sides[0] else -angle


def _ranges(words: list[str], at: int, beams: int) -> NDArray[np.float32]:
    ranges = numbers(words[at : at + beams])
    if min(ranges) < 0:
        raise ValueError(f"{words[0]} has a negative range, {min(ranges)}")
    return np.array(ranges, np.float32)


def _beams(words: list[str], at: int = 1) -> int:
    text = words[at] if at < len(words) else ""
    if not _is_count(text):
        raise ValueError(f"{words[0]} must state its number of beams as field {at}, not {text[:40]!r}")
    return int(text)


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= MAX_BEAMS_DIGITS and int(text) > 0


def _expect(words: list[str], count: int) -> None:
    if len(words) != count:
        raise ValueError(
            f"{words[0]} should have {count - 1} fields after its name, this has {len(words) - 1}"
        )


def _times(words: list[str]) -> dict[str, float]:
    ipc_s, logger_s = numbers([words[-3], words[-1]])
    for time_s in (ipc_s, logger_s):
        if not 0 <= time_s <= MAX_TIME_S:
            raise ValueError(f"{time_s:g} is no time in s")
    return {"ipc_time_s": ipc_s, "logger_time_s": logger_s}


_READERS: dict[str, Callable[[list[str]], Record]] = {
    "ODOM": _odometry,
    "FLASER": _old_laser,
    "RLASER": _old_laser,
    "TRUEPOS": _pose,
    "GLOBALPOS": _pose,
    "IMU": _imu,
    "NMEAGGA": _fix,
}
_NUMBERED: list[tuple[re.Pattern[str], Callable[[list[str]], Record]]] = [
    (re.compile("ROBOTLASER[1-9]"), _new_laser),
    (re.compile("RAWLASER[1-9]"), _new_raw_laser),
    (re.compile("LASER[1-9]?"), _old_raw_laser),
]
