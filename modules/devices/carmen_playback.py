"""Playback of a CARMEN log in place of the robot's devices."""

import time
from collections import Counter
from pathlib import Path

from robbie_mp import REQUIRED, Message, Module, SettingError, setting
from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.carmen import CarmenLog, DriveMessage
from robbie_mp.logs.recording.carmen_messages import PLACE_TOPIC
from robbie_mp.logs.recording.errors import NotALog
from robbie_mp.messages import LaserScan, Odometry, TFMessage

MAX_BURST_S = 0.02  # a longer tick would make the module slow to stop


class CarmenPlayback(Module):
    """Publishes what a log's records say, and ends when all subscribers have handled the last message.

    At most `outstanding_limit` messages are outstanding at any time, so none is lost.
    """

    file: Path = setting(REQUIRED, "the log", must_exist=True)
    rate: float | None = setting(
        None, "speed as a multiple of real time; null: as fast as possible without loss", minimum=0.001
    )
    outstanding_limit: int = setting(
        200, "maximum number of messages waiting or being handled", minimum=1, maximum=4000
    )
    period_s: float = setting(0.02, "time between checks of the clock", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the whole log once, so that what is no log is reported before anything starts."""
        file = settings["file"]
        assert isinstance(file, Path)
        try:
            CarmenLog(file).check()
        except (NotALog, OSError) as error:
            raise SettingError(str(error), "file") from error

    def setup(self) -> None:
        """Open the log."""
        self.balance = Balance()
        self.messages = CarmenLog(self.file, self.balance).messages()
        self.next_message = next(self.messages, None)
        self.started_s: float | None = None
        self.first_s = self.next_message.logger_time_s if self.next_message else 0.0
        self.count: Counter[type[Message]] = Counter()

    def tick(self) -> None:
        """Publish what is due; end after the last message has been handled."""
        now_s = self.monotonic_s()
        if self.started_s is None:
            self.started_s = now_s
        self._publish_due(now_s)
        self.status = f"{self.count[Odometry]} odometry, {self.count[LaserScan]} scans{self._left_out()}"
        # The core keeps the latched places of the lasers, so they stay outstanding.
        if self.next_message is None and self.outstanding <= (self.count[TFMessage] > 0):
            self.log.info("the log ended: %s", self.status)
            self.stop()

    def _publish_due(self, now_s: float) -> None:
        burst_ends_s = time.monotonic() + MAX_BURST_S
        while self.next_message is not None and self._is_due(self.next_message, now_s):
            if self.outstanding >= self.outstanding_limit:
                self.wake_after_freed(self.outstanding_limit // 2)
                return
            if not self._publish(self.next_message):
                return  # refused: retry the same message at the next tick
            self.next_message = next(self.messages, None)
            if time.monotonic() > burst_ends_s:
                return

    def _is_due(self, message: DriveMessage, now_s: float) -> bool:
        if self.rate is None or self.started_s is None:
            return True
        return message.logger_time_s - self.first_s <= (now_s - self.started_s) * self.rate

    def _publish(self, message: DriveMessage) -> bool:
        published = self.publish(message.message, topic=message.topic, latched=message.topic == PLACE_TOPIC)
        self.count[type(message.message)] += published
        return published

    def _left_out(self) -> str:
        lost = sum(self.balance.left_out.values())
        return f", {lost} lines left out" if lost else ""

    def teardown(self) -> None:
        """Log what was left out."""
        for reason, count in self.balance.left_out.items():
            self.log.warning("left out %d of %s: %s", count, self.file, reason)
