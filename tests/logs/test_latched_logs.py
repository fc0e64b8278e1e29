"""Logs of a run with latched topics: recorded late, by a killed logger, and played in lockstep."""

import os
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from robbie_mp.logs.recording.errors import NotALog
from robbie_mp.logs.recording.info import describe
from robbie_mp.logs.recording.reader import open_log
from tests._support.robot import Ended, Robot, wait_until

pytestmark = pytest.mark.timeout(300)
MODULES = '''
from robbie_mp import Module
from robbie_mp.messages import DriveCommand, Odometry, TimeJump


class Mapper(Module):
    """Publishes one map, and then commands for ever."""

    period_s = 0.02
    number = 0

    def tick(self):
        self.number += 1
        if self.number == 1:
            self.publish(Odometry(child_frame_id="the map"), topic="map", latched=True)
        self.publish(DriveCommand(linear_m_per_s=self.number / 1000))


class Reader(Module):
    """Says what it gets, in order."""

    def setup(self):
        self.heard = []
        self.subscribe(Odometry, lambda map: self.hear(map.child_frame_id), topic="map")
        self.subscribe(TimeJump, lambda jump: self.hear(jump.reason))
        self.subscribe(DriveCommand, lambda _command: self.hear("command"))

    def hear(self, word):
        if word not in self.heard[-1:]:
            self.heard.append(word)
        self.status = str(self.heard)
'''
LOGGER = """
modules:
  logger:
    class: robbie_mp.logs.message_logger:MessageLogger
    settings: {folder: logs, sync_s: 0.02}
    restart: {backoff_s: 0.01}
    stop_grace_s: 60
  mapper: {class: "team:Mapper"}
"""
PLAYER = """
parents: [robbie:playback]
modules:
  reader: {class: "team:Reader", restart: {backoff_s: 0.01}}
"""


@pytest.fixture
def recorded(robot: Robot) -> Robot:
    """A robot that has been recorded by a logger that was killed, and by `robbie record`, which came late."""
    (robot.folder / "team.py").write_text(MODULES)
    robot.write_profile(LOGGER)
    process = robot.start()
    figures = robot.until(lambda modules: modules["logger"]["handled"] > 20)
    wait_until(lambda: any(map(has_map, parts(robot))))
    os.kill(figures["logger"]["pid"], signal.SIGKILL)
    robot.until(lambda modules: modules["logger"]["restarts"] == 1 and modules["logger"]["handled"] > 50)
    late = robot.command("record", "--duration", "0.5", "-o", "late")
    assert late.returncode == 0, late.stderr
    Ended.in_order(process)
    return robot


def has_map(part: Path) -> bool:
    """Whether the map is in a part of a log, which may just be written."""
    with suppress(NotALog), open_log(part) as log:
        return any(one.messages for one in describe(log).channels if one.channel.topic == "map")
    return False


def parts(robot: Robot) -> list[Path]:
    return sorted(robot.folder.glob("logs/*/*.mcap"))


@pytest.mark.slow
def test_log_begins_with_what_was_newest_and_plays_as_latched_in_lockstep(recorded: Robot) -> None:
    first, second = parts(recorded)
    with open_log(first) as log:
        assert [one.messages for one in describe(log).channels if one.channel.topic == "map"] == [1]
    with open_log(second.parent) as log:
        (told,) = [one for one in describe(log).channels if one.channel.topic == "map"]
        assert (told.messages, told.carried) == (1, 1), "the map is recorded once, and carried into part 2"
        sequences = [message.sequence for message in log.messages()]
        assert sequences == sorted(set(sequences))
    for path in (second, recorded.folder / "late"):
        with open_log(path) as log:
            (given,) = log.newest_latched(log.start_ns)
            assert given.time_ns < log.start_ns
            assert all(message.channel.topic != "map" for message in log.messages())
            middle_s = (log.end_ns - log.start_ns) / 2e9  # a busy machine's log is shorter

    recorded.write_profile(PLAYER)
    options = ("--lockstep", "--paused", "--rate", "max")
    process = recorded.start(*options, command=("play", str(recorded.folder / "late")))
    figures = recorded.until(lambda modules: says(modules, "['the map']"))
    os.kill(figures["reader"]["pid"], signal.SIGKILL)
    recorded.until(lambda modules: modules["reader"]["restarts"] == 1 and says(modules, "['the map']"))
    assert recorded.command("playback", "seek", str(middle_s)).returncode == 0
    again = "['the map', 'seek', 'the map'"
    recorded.until(lambda modules: says(modules, again + "]"))
    assert recorded.command("playback", "resume").returncode == 0
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    assert says(ended.modules, again + ", 'command']")


def says(modules: dict[str, dict[str, object]], status: str) -> bool:
    return "reader" in modules and status in str(modules["reader"]["status"])
