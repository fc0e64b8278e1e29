"""Playback of a CARMEN log: from the system's point of view a robot that drives."""

import time
from pathlib import Path

from hw.carmen_log import BrokenLine, CarmenLog, LaserRecord, OdometryRecord, Record
from robbie_mp.messages import (
    Header,
    LaserScan,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from robbie_mp.module import Module, setting
from robbie_mp.settings import REQUIRED, SettingError

LASER_OFFSET = "robot_frontlaser_offset"
NO_RETURN_M = 81.0  # CARMEN's way to say it
BURST_S = 0.02  # a tick longer than this would make the module slow to stop


class CarmenPlayback(Module):
    """Publishes a log's odometry and scans, and ends when everybody has handled the last one.

    As fast as nothing is lost: no more than `outstanding_limit` messages are on their way at any time.
    """

    file: Path = setting(REQUIRED, "the log", must_exist=True)
    rate: float | None = setting(None, "times real time; null: as fast as nothing is lost", minimum=0.001)
    skip_broken: bool = setting(False, "leave out lines that cannot be read, and count them")
    outstanding_limit: int = setting(200, "messages that may be waiting or in work", minimum=1, maximum=4000)
    period_s: float = setting(0.02, "time between looks at the clock", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the whole log once, so that a broken line is an error before anything starts."""
        file, skip = settings["file"], settings["skip_broken"]
        assert isinstance(file, Path)
        try:
            CarmenLog(file, skip_broken=bool(skip)).check()
        except (BrokenLine, OSError) as error:
            advice = "; set skip_broken to leave such lines out" if isinstance(error, BrokenLine) else ""
            raise SettingError(f"{error}{advice}", "file") from error

    def setup(self) -> None:
        """Open the log."""
        self.carmen_log = CarmenLog(self.file, skip_broken=self.skip_broken)
        self.records = iter(self.carmen_log)
        self.next_record = next(self.records, None)
        self.started_s: float | None = None
        self.first_s = self.next_record.logger_time_s if self.next_record else 0.0
        self.count = {"odometry": 0, "scans": 0}

    def tick(self) -> None:
        """Publish what is due; end after the last message was handled."""
        now_s = self.clock.monotonic_ns() / 1e9
        if self.started_s is None:
            self.started_s = now_s
            self.publish(laser_place(self.carmen_log.parameters), topic="tf_static")
        self._publish_due(now_s)
        self.status = f"{self.count['odometry']} odometry, {self.count['scans']} scans{self._skipped()}"
        if self.next_record is None and self.outstanding == 0:
            self.log.info("the log has ended: %s", self.status)
            self.stop()

    def _publish_due(self, now_s: float) -> None:
        burst_ends_s = time.monotonic() + BURST_S
        while self.next_record is not None and self._is_due(self.next_record, now_s):
            if self.outstanding >= self.outstanding_limit:
                self.wake_after_freed(self.outstanding_limit // 2)
                return
            if not self._publish(self.next_record):
                return  # refused: the same record again at the next tick
            self.next_record = next(self.records, None)
            if time.monotonic() > burst_ends_s:
                return

    def _is_due(self, record: Record, now_s: float) -> bool:
        if self.rate is None or self.started_s is None:
            return True
        return record.logger_time_s - self.first_s <= (now_s - self.started_s) * self.rate

    def _publish(self, record: Record) -> bool:
        if isinstance(record, OdometryRecord):
            published = self.publish(odometry_message(record), topic="odom")
            self.count["odometry"] += published
        else:
            published = self.publish(scan_message(record))
            self.count["scans"] += published
        return published

    def _skipped(self) -> str:
        broken = self.carmen_log.broken_lines
        return f", {broken} broken lines skipped" if broken else ""

    def teardown(self) -> None:
        """Say what was left out."""
        if self.carmen_log.broken_lines:
            self.log.warning("%d broken lines of %s were skipped", self.carmen_log.broken_lines, self.file)


def odometry_message(record: OdometryRecord) -> Odometry:
    """Make a message of an ODOM line; its stamp is the sensor's own."""
    return Odometry(
        header=Header(stamp=stamp(record.ipc_time_s), frame_id="odom"),
        child_frame_id="base_link",
        pose=PoseWithCovariance(
            pose=Pose(
                position=Point(x=record.x_m, y=record.y_m), orientation=Quaternion.from_yaw(record.theta_rad)
            )
        ),
        twist=TwistWithCovariance(
            twist=Twist(linear=Vector3(x=record.linear_m_s), angular=Vector3(z=record.angular_rad_s))
        ),
    )


def scan_message(record: LaserRecord) -> LaserScan:
    """Make a message of a FLASER line; its stamp is the sensor's own."""
    last = len(record.ranges_m) - 1
    return LaserScan(
        header=Header(stamp=stamp(record.ipc_time_s), frame_id="laser"),
        angle_min=record.angle_min_rad,
        angle_max=record.angle_min_rad + last * record.angle_increment_rad,
        angle_increment=record.angle_increment_rad,
        range_max=NO_RETURN_M,
        ranges=record.ranges_m,
    )


def laser_place(parameters: dict[str, str]) -> TFMessage:
    """Say where the laser sits on the robot, as the log's parameters have it."""
    offset_m = float(parameters.get(LASER_OFFSET, "0"))
    place = Transform(translation=Vector3(x=offset_m), rotation=Quaternion.from_yaw(0.0))
    header = Header(frame_id="base_link")
    return TFMessage(transforms=[TransformStamped(header=header, child_frame_id="laser", transform=place)])


def stamp(seconds: float) -> Time:
    """Make a stamp of seconds since the epoch."""
    return Time.from_nanoseconds(round(seconds * 1e6) * 1000)
