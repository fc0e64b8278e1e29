"""Playback of a CARMEN log in place of the robot's devices."""

import time
from pathlib import Path

from robbie_mp import REQUIRED, Module, SettingError, setting
from robbie_mp.logs.recording.carmen import BrokenLine, CarmenLog, OdometryRecord, Record
from robbie_mp.logs.recording.carmen_import import laser_place, odometry_message, scan_message

MAX_BURST_S = 0.02  # a longer tick would make the module slow to stop


class CarmenPlayback(Module):
    """Publishes a log's odometry and scans, and ends when all subscribers have handled the last message.

    At most `outstanding_limit` messages are outstanding at any time, so none is lost.
    """

    file: Path = setting(REQUIRED, "the log", must_exist=True)
    rate: float | None = setting(
        None, "speed as a multiple of real time; null: as fast as possible without loss", minimum=0.001
    )
    skip_broken: bool = setting(False, "skip and count unreadable lines")
    outstanding_limit: int = setting(
        200, "maximum number of messages waiting or being handled", minimum=1, maximum=4000
    )
    period_s: float = setting(0.02, "time between checks of the clock", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the whole log once, so that a broken line is reported before anything starts."""
        file, skip = settings["file"], settings["skip_broken"]
        assert isinstance(file, Path)
        try:
            CarmenLog(file, skip_broken=bool(skip)).check()
        except (BrokenLine, OSError) as error:
            advice = "; set skip_broken to skip such lines" if isinstance(error, BrokenLine) else ""
            raise SettingError(f"{error}{advice}", "file") from error

    def setup(self) -> None:
        """Open the log."""
        self.carmen_log = CarmenLog(self.file, skip_broken=self.skip_broken)
        self.records = iter(self.carmen_log)
        self.next_record = next(self.records, None)
        self.started_s: float | None = None
        self.first_s = self.next_record.logger_time_s if self.next_record else 0.0
        self.count = {"odometry": 0, "scans": 0}
        self.kept = 0
        """Latched messages: the core keeps them, so they stay outstanding."""

    def tick(self) -> None:
        """Publish what is due; end after the last message has been handled."""
        now_s = self.clock.monotonic_ns() / 1e9
        if self.started_s is None:
            self.started_s = now_s
            self.kept += self.publish(
                laser_place(self.carmen_log.parameters), topic="tf_static", latched=True
            )
        self._publish_due(now_s)
        self.status = f"{self.count['odometry']} odometry, {self.count['scans']} scans{self._skipped()}"
        if self.next_record is None and self.outstanding <= self.kept:
            self.log.info("the log ended: %s", self.status)
            self.stop()

    def _publish_due(self, now_s: float) -> None:
        burst_ends_s = time.monotonic() + MAX_BURST_S
        while self.next_record is not None and self._is_due(self.next_record, now_s):
            if self.outstanding >= self.outstanding_limit:
                self.wake_after_freed(self.outstanding_limit // 2)
                return
            if not self._publish(self.next_record):
                return  # refused: retry the same record at the next tick
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
        """Log how many lines were skipped."""
        if self.carmen_log.broken_lines:
            self.log.warning("%d broken lines of %s were skipped", self.carmen_log.broken_lines, self.file)
