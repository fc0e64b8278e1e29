"""A run of the demo is recorded, and played into the robot without its devices: the map is the same."""

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.conversion import NewChannel, converted_log
from robbie_mp.logs.recording.format import ChannelKey, TopicNames
from robbie_mp.logs.recording.reader import LoggedMessage, open_log
from tests.robot._support.stock_robot import PROJECT, StockRobot

pytestmark = pytest.mark.timeout(500)
RESULTS = ("trajectory.txt", "map.pgm", "map.yaml")
STRIKE_AT = 97
KILLED = f"""
parents: [demo-playback]
modules:
  mapping: {{settings: {{checkpoint_share: 1.0}}}}
  assassin: {{class: "tests.robot._support.assassin:Assassin", settings: {{at: {STRIKE_AT}}}}}
"""


def results(folder: Path) -> dict[str, str]:
    """What mapping has written: where the robot was, and the map cell for cell."""
    return {name: (folder / name).read_bytes().hex() for name in RESULTS}


def counted(folder: Path) -> dict[str, Any]:
    counted: dict[str, Any] = json.loads((folder / "mapping.json").read_text())
    return counted


def for_mapping(log: Path) -> list[LoggedMessage]:
    """The messages of a log that mapping makes its map of, in order."""
    with open_log(log) as opened:
        return [message for message in opened.messages() if kind(message)]


def kind(message: LoggedMessage) -> str:
    channel = message.channel
    if channel.type_name == "nav_msgs/msg/Odometry" and channel.topic == "odom":
        return "odometry"
    return "scan" if channel.type_name == "sensor_msgs/msg/LaserScan" else ""


def frames(recording: Path) -> dict[str, str]:
    """The parent of each frame that a log's transforms place, as a tool for ROS 2 reads them."""
    found = {}
    for part in recording.glob("*.mcap"):
        with part.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, _, _, message in reader.iter_decoded_messages(topics=["/tf", "/tf_static"]):
                for transform in message.transforms:
                    found[transform.child_frame_id] = transform.header.frame_id
    return found


def write_log(path: Path, source: Path, messages: list[LoggedMessage]) -> Path:
    """Write messages of a log into a new one."""
    topics = TopicNames()
    with converted_log(path, source, Balance()) as log:
        for message in messages:
            channel = message.channel
            key = ChannelKey(channel.type_name, channel.version, channel.topic, channel.sender)
            new = NewChannel(topics.of(key), channel.type_name, channel.schema or "")
            log.add(new, key.metadata(), message.time_ns, message.data)
    return path


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """The project with one more profile, in which mapping is killed."""
    folder = tmp_path / "workspace"
    (folder / "profiles").mkdir(parents=True)
    for profile in (PROJECT / "profiles").glob("*.yaml"):
        (folder / "profiles" / profile.name).write_text(profile.read_text())
    (folder / "profiles" / "killed.yaml").write_text(KILLED)
    (folder / "hw").symlink_to(PROJECT / "hw")
    return folder


def test_recorded_run_gives_the_same_map_when_it_is_played(tmp_path: Path, workspace: Path) -> None:
    robot = StockRobot(tmp_path, workspace)
    code, modules, errors = robot.run(
        "demo-recorded", "--set", "exploration.time_limit_s=4", "--set", f"logger.folder={tmp_path}/logs"
    )
    assert code == 0, errors
    assert all(modules[name]["dropped"] == modules[name]["left"] for name in ("mapping", "logger"))
    live = results(robot.output)
    (recording,) = (tmp_path / "logs").iterdir()
    assert frames(recording) == {"laser": "base_link", "base_link": "odom", "odom": "map"}
    # What came while the robot was being stopped may be in the log, and not in the map.
    handled = counted(robot.output)
    messages = for_mapping(recording)[: handled["odometry_messages"] + handled["scans"]]
    assert sum(kind(message) == "odometry" for message in messages) == handled["odometry_messages"]
    log = write_log(tmp_path / "live.mcap", recording, messages)

    code, modules, errors = robot.play(log, "demo-playback", "--rate", "max")
    assert code == 0, errors
    assert results(robot.output) == live
    assert set(modules) == {"supervisor", "core", "mapping", "playback"}

    code, modules, errors = robot.play(log, "killed", "--rate", "max", "--lockstep")
    assert code == 0, errors
    assert modules["mapping"]["restarts"] == 1
    assert modules["mapping"]["lost"] == modules["mapping"]["dropped"] == 0
    killed = results(robot.output)
    shorter = write_log(tmp_path / "less.mcap", log, less(messages))
    code, _, errors = robot.play(shorter, "demo-playback", "--lockstep")
    assert code == 0, errors
    assert results(robot.output) == killed


def less(messages: list[LoggedMessage]) -> list[LoggedMessage]:
    """Leave out what mapping has handled between its last checkpoint, after a scan, and its death."""
    odometry = [index for index, message in enumerate(messages) if kind(message) == "odometry"]
    died = odometry[STRIKE_AT - 1]
    checkpoint = max(index for index in range(died) if kind(messages[index]) == "scan")
    assert checkpoint < died
    return messages[: checkpoint + 1] + messages[died + 1 :]
