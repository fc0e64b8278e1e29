"""Writes lines of CARMEN logs in each dialect, as the header of its logger explains them."""

from collections.abc import Sequence

Numbers = Sequence[float]

HEADER = """\
# CARMEN Logfile
# file format is one message per line
# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp
# message formats defined: PARAM SYNC ODOM RAWLASER1 ROBOTLASER1
# robot: pioneer-I
"""
HOST = "pharao"


def line(name: str, words: str, ipc_s: float, logger_s: float) -> str:
    """A record: name, contents, and the times."""
    return f"{name} {words} {ipc_s:f} {HOST} {logger_s:f}\n"


def several(values: Numbers, form: str = "%f") -> str:
    return " ".join(form % value for value in values)


def odometry(pose: Numbers, velocity: Numbers, ipc_s: float, logger_s: float) -> str:
    return line("ODOM", several([*pose, *velocity, 0.0]), ipc_s, logger_s)


def old_laser(
    name: str, ranges: Numbers, laser: Numbers, robot: Numbers, ipc_s: float, logger_s: float
) -> str:
    """FLASER or RLASER: no angles."""
    words = f"{len(ranges)} {several(ranges, '%.2f')} {several([*laser, *robot])}"
    return line(name, words, ipc_s, logger_s)


def old_raw_laser(name: str, ranges: Numbers, ipc_s: float, logger_s: float) -> str:
    """LASER, LASER3 or LASER4."""
    return line(name, f"{len(ranges)} {several(ranges, '%.2f')}", ipc_s, logger_s)


def sweep(
    config: Numbers, ranges: Numbers, remissions: Numbers | None, *, mode: int | None = 0, kind: int = 1
) -> str:
    """What RAWLASER and ROBOTLASER have in common.

    Args:
        config: start angle, field of view, angular resolution, maximum range, accuracy.
        ranges: in m.
        remissions: None: the first loggers did not write even their number.
        mode: of the remissions; None: the first loggers did not write it.
        kind: of the laser.
    """
    words = [str(kind), several(config)]
    words += [] if mode is None else [str(mode)]
    words += [str(len(ranges)), several(ranges, "%.3f")]
    words += [] if remissions is None else [str(len(remissions)), several(remissions)]
    return " ".join(filter(None, words))


def robot_laser(
    laser: int,
    swept: str,
    laser_pose: Numbers,
    robot_pose: Numbers,
    velocity: Numbers,
    ipc_s: float,
    logger_s: float,
) -> str:
    """ROBOTLASER1 or ROBOTLASER2."""
    safety = [0.4, 0.5, 1e6]
    words = f"{swept} {several([*laser_pose, *robot_pose, *velocity, *safety])}"
    return line(f"ROBOTLASER{laser}", words, ipc_s, logger_s)


def raw_laser(laser: int, swept: str, ipc_s: float, logger_s: float) -> str:
    """RAWLASER1 to RAWLASER4."""
    return line(f"RAWLASER{laser}", swept, ipc_s, logger_s)


def parameter(name: str, value: object) -> str:
    return f"PARAM {name} {value} 900.000000 {HOST} 900.000000\n"


def sync(tag: str) -> str:
    """A tag, with two times of the clock of the day."""
    return f"SYNC {tag} 1000.000000 {HOST} 1000.000000\n"


def true_pose(name: str, pose: Numbers, odometry_pose: Numbers, ipc_s: float, logger_s: float) -> str:
    """TRUEPOS or GLOBALPOS."""
    return line(name, several([*pose, *odometry_pose]), ipc_s, logger_s)


def imu(
    acceleration: Numbers,
    quaternion: Numbers,
    magnetic: Numbers,
    turns: Numbers,
    ipc_s: float,
    logger_s: float,
) -> str:
    return line("IMU", several([*acceleration, *quaternion, *magnetic, *turns]), ipc_s, logger_s)


def gga(
    receiver: int,
    latitude: str,
    longitude: str,
    quality: int,
    above_sea_m: float,
    geoid_m: float,
    ipc_s: float,
    logger_s: float,
) -> str:
    """NMEAGGA; latitude and longitude are `DDMM.MMMM N`."""
    words = f"{receiver} 120000.0 {latitude} {longitude} {quality} 8 1.1 {above_sea_m} 0.0 {geoid_m} 0.0 0"
    return line("NMEAGGA", words, ipc_s, logger_s)
