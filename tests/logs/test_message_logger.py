"""The message logger in a run: contents of the log, reported losses, and logs after kills."""

import os
import signal
import subprocess
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import psutil
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from robbie_mp import SettingError
from robbie_mp.logs.message_logger import MessageLogger
from robbie_mp.logs.recording.errors import NotALog
from robbie_mp.logs.recording.format import ChannelKey, RecordedCount, RunMetadata, counts_from_metadata
from robbie_mp.logs.recording.info import describe
from robbie_mp.logs.recording.reader import Log, open_log
from robbie_mp.messages import LaserScan, Odometry
from robbie_mp.module.settings import check_settings
from robbie_mp.run.supervisor.run import DEGRADED
from tests._support.robot import COMMAND, Ended, Robot, is_running, kill, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

MODULES = '''
from robbie_mp.messages import LaserScan, Odometry
from robbie_mp import Module


class Source(Module):
    """Publishes numbered scans, as many odometries, and as many of what nobody wants."""

    period_s = 0.005

    def setup(self):
        self.number = self.odometries = 0

    def tick(self):
        number = float(self.number)
        # Each may be refused while a core is down for long, or gets no processor.
        if self.publish(LaserScan(angle_min=number, ranges=[number, 0.5, 1.5]), topic="front"):
            self.number += 1
            self.publish(LaserScan(angle_min=number), topic="rear")
            self.odometries += self.publish(Odometry(child_frame_id=str(number)))

    def teardown(self):
        (self.output_directory / "wanted").write_text(str(self.number + self.odometries))


class Listener(Module):
    """Wants everything that the source says."""

    def setup(self):
        self.subscribe(LaserScan, lambda _: None)
        self.subscribe(Odometry, lambda _: None)
'''
PROFILE = """
modules:
  logger:
    class: robbie_mp.logs.message_logger:MessageLogger
    settings: {settings}
    queue: {{messages: {queue}}}
    handler_deadline_s: 0  # a test stops it for as long as the source needs to fill its queue
    restart: {{backoff_s: 0.01}}
    stop_grace_s: 60
  listener: {{class: "source:Listener"}}
  source: {{class: "source:Source"}}
"""
QUEUE = 20
WAITING = QUEUE + 64
"""Maximum number of messages that wait for the logger; the share of a topic may differ by as many."""
FRONT = ChannelKey(LaserScan.type_name, 1, "front", "source")
ODOMETRY = ChannelKey(Odometry.type_name, 1, "", "source")


def start(robot: Robot, settings: str, queue: int) -> "subprocess.Popen[str]":
    (robot.folder / "source.py").write_text(MODULES)
    robot.write_profile(PROFILE.format(settings=settings, queue=queue))
    return robot.start()


def published_for_the_logger(robot: Robot) -> int:
    """Return how many messages that the logger wants were published in a run that has ended."""
    return int((robot.output / "wanted").read_text())


def parts(robot: Robot) -> list[Path]:
    return sorted(robot.output.glob("*/*.mcap"))


def opened(path: Path) -> Log:
    """Open a log that is just being written; a part that has just been made is empty for a moment."""
    while True:
        with suppress(NotALog):
            return open_log(path)


def recorded(robot: Robot) -> list[int]:
    """Numbers of the scans in front that are in whole chunks of the log."""
    if not parts(robot):
        return []
    with opened(parts(robot)[0].parent) as log:
        front = [channel for channel in log.channels if channel.topic == "front"]
        return [round(LaserScan.decode(m.data).angle_min) for m in log.messages(channels=front)]


def test_queue_losses_are_counted_by_topic_and_all_else_is_in_the_log(robot: Robot) -> None:
    settings = "{types: [LaserScan, nav_msgs/*, no_msgs/msg/Type], exclude: [re*], sync_s: 0.02}"
    process = start(robot, settings, queue=QUEUE)
    robot.until(lambda modules: modules["logger"]["handled"] > 100)
    taken = taken_by_robbie_record(robot)
    missed = dropped_until_now(robot)
    logger = robot.top()["logger"]["pid"]
    os.kill(logger, signal.SIGSTOP)
    robot.until(lambda modules: sum(s["dropped"] for s in modules["logger"]["subscriptions"]) > 5 * WAITING)
    os.kill(logger, signal.SIGCONT)
    handled = robot.top()["logger"]["handled"]
    robot.until(lambda modules: modules["logger"]["handled"] > handled + 100)
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert ended.exit_code in (0, DEGRADED), ended.stderr  # on a busy machine it drops to the end
    published = published_for_the_logger(robot)
    (path,) = parts(robot)
    with open_log(path) as log:
        assert log.is_complete
        (run,) = log.metadata("robbie_run")
        counts = counts_from_metadata(log.metadata("robbie_counts")[-1])
        in_log = {(c.topic, c.sender): number for c, number in log.counts.items()}
    assert RunMetadata.from_metadata(run).profile == "robot"
    assert "robbie_mp.logs.message_logger:MessageLogger" in run["profile_yaml"]
    # On a loaded machine some are dropped before the first one arrives, and their sender is not known.
    assert {key._replace(sender="source") for key in counts} == {FRONT, ODOMETRY}
    for key in (FRONT, ODOMETRY):
        assert counts[key].recorded == in_log[key.topic, key.sender]
    missing = sum(count.dropped for count in counts.values())
    assert sum(counts[key].recorded for key in counts) + missing == pytest.approx(
        published, abs=missing // 10
    )
    check_with_other_readers(path, counts)
    with open_log(path) as log:
        in_both = taken & {(message.sequence, message.data) for message in log.messages()}
    assert in_both
    assert len(taken - in_both) <= missed
    log_text = robot.log("logger")
    assert "nothing has been recorded in this run for type 'no_msgs/msg/Type', topic '*'" in log_text
    assert "messages are missing: sensor_msgs/msg/LaserScan on topic 'front'" in log_text


def dropped_until_now(robot: Robot) -> int:
    """Return how many of the messages published until now the logger will never get.

    On a loaded machine it loses some to its short queue.
    """
    handled = robot.top()["logger"]["handled"]
    figures = robot.until(lambda modules: modules["logger"]["handled"] > handled + WAITING)
    return sum(subscription["dropped"] for subscription in figures["logger"]["subscriptions"])


def taken_by_robbie_record(robot: Robot) -> set[tuple[int, bytes]]:
    """Record what passes with the command for a while; return what it has recorded."""
    folder = robot.folder / "recorded"
    command = [*COMMAND, "record", "front", "Nothing", "-o", str(folder)]
    process = subprocess.Popen(
        command, cwd=robot.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    wait_until(lambda: any(path.stat().st_size > 2000 for path in folder.glob("*")))
    process.send_signal(signal.SIGINT)
    said, noted = process.communicate(timeout=60)
    assert process.returncode == 0, noted
    assert "nothing was recorded for 'Nothing'" in noted
    with open_log(folder) as log:
        assert log.is_complete
        assert [(channel.topic, channel.sender) for channel in log.channels] == [("front", "source")]
        messages = {(message.sequence, message.data) for message in log.messages()}
    assert str(len(messages)) in said
    refused = robot.command("record", "-o", str(folder))
    assert (refused.returncode, "exists already" in refused.stderr) == (1, True)
    return messages


def check_with_other_readers(path: Path, counts: dict[ChannelKey, RecordedCount]) -> None:
    """See that the mcap library and rosbags find what we find, field by field."""
    with open_log(path) as log:
        ours = list(log.messages())
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        theirs = list(reader.iter_decoded_messages(log_time_order=False))
        summary = reader.get_summary()
    assert summary is not None
    statistics = summary.statistics
    assert statistics is not None
    assert statistics.message_count == len(theirs) == len(ours) == sum(c.recorded for c in counts.values())
    for own, (_, _, record, decoded) in zip(ours, theirs, strict=True):
        assert (own.sequence, own.time_ns) == (record.sequence, record.log_time)
        if own.channel.type_name == LaserScan.type_name:
            scan = LaserScan.decode(own.data)
            assert (scan.angle_min, scan.ranges.tolist()) == (decoded.angle_min, list(decoded.ranges))
        else:
            assert Odometry.decode(own.data).child_frame_id == decoded.child_frame_id
    sequences = [message.sequence for message in ours]
    assert sequences == sorted(set(sequences))
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
        data = {bytes(raw) for _, _, raw in bag.messages()}
    assert data == {message.data for message in ours}


def wait_for_more(robot: Robot) -> None:
    """Wait until the last part of the log has messages that it did not have."""
    enough = len(recorded(robot)) + 100
    wait_until(lambda: len(recorded(robot)) > enough)


def test_kills_of_core_logger_and_supervisor_lose_no_synced_message(robot: Robot) -> None:
    process = start(robot, "{sync_s: 0.05, compression: none}", queue=100_000)
    robot.until(lambda modules: len(recorded(robot)) > 50)

    kill(robot.top()["core"]["pid"])
    robot.until(lambda modules: modules["core"]["restarts"] == 1 and modules["core"]["state"] == "RUNNING")
    wait_for_more(robot)
    before = recorded(robot)
    assert before == list(range(before[0], before[-1] + 1))  # the core's death cost nothing

    assert robot.command("module", "restart", "logger").returncode == 0
    wait_until(lambda: len(parts(robot)) == 2)
    wait_for_more(robot)
    before = recorded(robot)
    assert before == list(range(before[0], before[-1] + 1))  # what waited for it was written, too

    kill(robot.top()["logger"]["pid"])
    wait_until(lambda: len(parts(robot)) == 3)
    wait_for_more(robot)
    after = recorded(robot)
    assert after[: len(before)] == before
    gaps = [number for one, number in pairwise(after) if number != one + 1]
    assert len(gaps) <= 1  # what was in memory; what waited in the core's queue is there
    assert after == sorted(after)

    pids = [module["pid"] for module in robot.top().values() if module["pid"]]
    kill(process.pid)
    process.wait(60)
    wait_until(lambda: not any(is_running(pid) for pid in pids if psutil.pid_exists(pid)))
    at_the_end = recorded(robot)
    assert at_the_end[: len(after)] == after
    with open_log(parts(robot)[0].parent) as log:
        assert [part.is_complete for part in log.parts] == [True, False, False]
        assert all(part.contents.message_count for part in log.parts)
    assert robot.command("clean").returncode == 0


@pytest.mark.parametrize("sync_s", [0.05, 3600.0])
def test_what_killed_loggers_had_in_memory_is_counted(robot: Robot, sync_s: float) -> None:
    # All that is published, since the core counts exactly only what it drops of all topics together.
    process = start(robot, f"{{types: [LaserScan, Odometry], sync_s: {sync_s}}}", queue=100_000)
    for kills in (1, 2):
        handled = robot.until(lambda modules: modules["logger"]["state"] == "RUNNING")["logger"]["handled"]
        enough = handled + 100
        figures = robot.until(lambda modules: modules["logger"]["handled"] > enough)  # noqa: B023
        kill(figures["logger"]["pid"])
        robot.until(lambda modules: modules["logger"]["restarts"] == kills)  # noqa: B023
    handled = robot.top()["logger"]["handled"]
    robot.until(lambda modules: modules["logger"]["handled"] > handled + 100)
    if sync_s > 1:
        robot.until(lambda modules: "killed logger" in modules["logger"]["status"])
    ended = Ended.in_order(process)
    published = ended.modules["source"]["published"]
    with open_log(parts(robot)[0].parent) as log:
        channels = describe(log).channels
    recorded_messages, missing = (
        sum(getattr(one, name) or 0 for one in channels) for name in ("messages", "dropped")
    )
    # A logger that was killed right after it had counted a message makes one too many.
    assert 0 <= recorded_messages + missing - published <= kills
    if sync_s > 1:  # otherwise a logger may be killed just after it has written everything
        assert missing >= 100
        assert "they were in the memory of a logger that was killed" in robot.log("logger")


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"budget_bytes": 1000, "split_bytes": 600}, "at most half that size"),
        ({"budget_bytes": 1000, "split_bytes": 0}, "at most half that size"),
        ({"folder": "/dev/null/logs"}, "/dev/null is not a folder"),
        ({"compression": "gzip"}, "zstd"),
    ],
)
def test_impossible_recording_is_refused_before_the_run_starts(
    settings: dict[str, object], complaint: str
) -> None:
    with pytest.raises(SettingError, match=complaint):
        MessageLogger.check(check_settings(MessageLogger, settings))
    MessageLogger.check(check_settings(MessageLogger, {"folder": "/tmp/not/there/yet"}))
