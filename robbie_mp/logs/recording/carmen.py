"""Read a robot's drive from a CARMEN log, the text format of many public laser data sets.

The format is that of the Carnegie Mellon Robot Navigation Toolkit (Montemerlo, Roy and Thrun, IROS 2003): a
line per record, `ODOM` and `FLASER` for wheel odometry and the front laser.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp.logs.recording.errors import LogError

MAX_LINE_CHARACTERS = 16 << 20
"""Longer than a line with a million beams."""
LASER_OFFSET = "robot_frontlaser_offset"
"""Parameter: distance of the laser in front of the robot's centre, in m."""


class BrokenLine(LogError, ValueError):
    """A line of a log that cannot be read."""


@dataclass(frozen=True)
class OdometryRecord:
    """Robot pose and velocity from wheel odometry: m, rad, m/s, rad/s, in the odometry frame.

    Attributes:
        ipc_time_s: When it was measured; may jitter, even backwards.
        logger_time_s: When it was recorded, since the start of the log.
    """

    x_m: float
    y_m: float
    theta_rad: float
    linear_m_s: float
    angular_rad_s: float
    ipc_time_s: float
    logger_time_s: float


@dataclass(frozen=True)
class LaserRecord:
    """A sweep of the front laser, counter-clockwise.

    Attributes:
        ranges_m: `(N,) float32`; a range at the sensor's limit (some 80 m) means no return.
        angle_min_rad: Bearing of the first beam in the laser's frame.
        angle_increment_rad: From one beam to the next.
        robot_pose: Odometry's pose of the robot at the time (x m, y m, theta rad).
        ipc_time_s: When it was measured; may jitter, even backwards.
        logger_time_s: When it was recorded, since the start of the log.
    """

    ranges_m: NDArray[np.float32]
    angle_min_rad: float
    angle_increment_rad: float
    robot_pose: tuple[float, float, float]
    ipc_time_s: float
    logger_time_s: float


Record = OdometryRecord | LaserRecord


@dataclass
class CarmenLog:
    """A log file; iterate over it for its records in the order they were recorded.

    Attributes:
        path: The file.
        skip_broken: Skip and count lines that cannot be read, rather than raise.
        broken_lines: How many lines the last reading skipped.
        parameters: `PARAM` lines read so far, such as `robot_frontlaser_offset`.
        bytes_read: How far the last reading has got.
    """

    path: Path
    skip_broken: bool = False
    broken_lines: int = 0
    parameters: dict[str, str] = field(default_factory=dict)
    bytes_read: int = 0

    def __iter__(self) -> Iterator[Record]:
        """Read the records.

        Raises:
            BrokenLine: A line cannot be read, and `skip_broken` is not set.
            OSError: The file cannot be read.
        """
        self.broken_lines = self.bytes_read = 0
        with Path(self.path).open(encoding="ascii", errors="replace") as lines:
            for number, line in enumerate(iter(lambda: lines.readline(MAX_LINE_CHARACTERS), ""), start=1):
                self.bytes_read += len(line)
                if len(line) == MAX_LINE_CHARACTERS:
                    raise BrokenLine(
                        f"{self.path}:{number}: the longest line may have {MAX_LINE_CHARACTERS - 1} "
                        "characters; is this a CARMEN log?"
                    )
                try:
                    record = self._read(line)
                except (ValueError, IndexError) as error:
                    if not self.skip_broken:
                        raise BrokenLine(f"{self.path}:{number}: {error}") from error
                    self.broken_lines += 1
                    continue
                if record is not None:
                    yield record

    def check(self) -> dict[str, int]:
        """Read the whole file and return how many records of each kind it has.

        Raises:
            BrokenLine: A line cannot be read, and `skip_broken` is not set.
        """
        counts = {"odometry": 0, "laser": 0}
        for record in self:
            counts["laser" if isinstance(record, LaserRecord) else "odometry"] += 1
        return counts

    def _read(self, line: str) -> Record | None:
        fields = line.split()
        if not fields:
            return None
        if fields[0] == "PARAM" and len(fields) >= 3:
            if fields[1] == LASER_OFFSET:
                _numbers(fields[2:3])
            self.parameters[fields[1]] = fields[2]
        reader = _READERS.get(fields[0])
        return reader(fields) if reader else None


def beam_angles(beams: int) -> tuple[float, float]:
    """Return the first bearing and the increment (rad) of a `FLASER` line, which states neither.

    The field of view is 180 degrees from -90 degrees on. A SICK scanner measures at both ends of it: 181 or
    361 beams, N - 1 steps. Loggers that kept an even number left out the last beam, so the steps are the
    same: 180 beams one degree apart, 360 half a degree. Dividing by N - 1 there would stretch each sweep by
    one step.
    """
    steps = beams if beams % 2 == 0 else beams - 1
    return -math.pi / 2, math.pi / steps


def _odometry(fields: list[str]) -> OdometryRecord:
    _expect(fields, 10)
    x, y, theta, linear, angular, _, ipc_time = _numbers(fields[1:8])
    return OdometryRecord(x, y, theta, linear, angular, ipc_time, _numbers(fields[9:10])[0])


def _laser(fields: list[str]) -> LaserRecord:
    beams = _beams(fields)
    _expect(fields, beams + 11)
    ranges = _numbers(fields[2 : 2 + beams])
    if min(ranges) < 0:
        raise ValueError(f"FLASER has a negative range, {min(ranges)}")
    _, _, _, x, y, theta, ipc_time = _numbers(fields[2 + beams : 9 + beams])
    logger_time = _numbers(fields[10 + beams : 11 + beams])[0]
    return LaserRecord(
        np.array(ranges, np.float32), *beam_angles(beams), (x, y, theta), ipc_time, logger_time
    )


def _beams(fields: list[str]) -> int:
    text = fields[1] if len(fields) > 1 else ""
    if not (text.isascii() and text.isdigit()) or len(text) > 6 or int(text) < 2:
        raise ValueError(f"FLASER must be followed by its number of beams (2 or more), not by {text!r}")
    return int(text)


def _expect(fields: list[str], count: int) -> None:
    if len(fields) != count:
        raise ValueError(
            f"{fields[0]} should have {count - 1} fields after its name, this has {len(fields) - 1}"
        )


def _numbers(texts: list[str]) -> list[float]:
    numbers = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number") from None
        if not math.isfinite(number):
            raise ValueError(f"{text!r} is not a finite number")
        numbers.append(number)
    return numbers


_READERS: dict[str, Callable[[list[str]], Record]] = {"ODOM": _odometry, "FLASER": _laser}
