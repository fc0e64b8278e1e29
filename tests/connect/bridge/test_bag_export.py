"""A log becomes a bag of ROS 2, which rosbags opens, and a log again."""

from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from robbie_mp.cli import main
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import (
    Header,
    Image,
    LaserScan,
    OccupancyGrid,
    Odometry,
    PoseStamped,
    TFMessage,
    TransformStamped,
    stock_registry,
)
from tests.logs.recording._support.logs import START_NS, LogFile, scan, write_log

PROFILE = """
modules:
  laser: {class: "hw:Laser"}
  ros:
    class: robbie_mp.connect.ros2.module:Ros2Bridge
    settings:
      namespace: red
      send:
        LaserScan laser/front: scan best_effort depth=5
        Image *: /camera/{topic}
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def write_robots_log(path: Path) -> None:
    with LogFile(path) as log:
        log.writer.add_metadata("robbie_run", {"run_id": "12ab", "profile_yaml": PROFILE})
        log.add(scan(1), "laser/front", "laser", time_ns=START_NS)
        log.add(Image(header=Header(frame_id="camera")), "front", "camera", time_ns=START_NS + 1)
        log.add(scan(2), "laser/back-2", "laser", time_ns=START_NS + 2)
        log.add(Odometry(), "", "base", time_ns=START_NS + 3)
        log.add(PoseStamped(), "laser/back-2", "other", time_ns=START_NS + 4)
        for sender in ("arm", "head"):
            transform = TransformStamped(child_frame_id=sender)
            log.add(TFMessage(transforms=[transform]), "tf_static", sender, time_ns=START_NS + 5)


def names_in(bag: Path) -> dict[str, tuple[str, int]]:
    with AnyReader([bag]) as reader:
        return {one.topic: (one.msgtype, one.msgcount) for one in reader.connections}


def test_names_are_those_of_the_robots_bridge(capsys: pytest.CaptureFixture[str]) -> None:
    write_robots_log(Path("a.mcap"))
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 0
    assert (
        capsys.readouterr().out
        == "bag: read 7 messages: 7 used, 0 left out\nnames as the module ros sends them to ROS 2\n"
    )
    assert names_in(Path("bag")) == {
        "/red/scan": ("sensor_msgs/msg/LaserScan", 1),
        "/camera/front": ("sensor_msgs/msg/Image", 1),
        "/laser/back_2": ("sensor_msgs/msg/LaserScan", 1),
        "/odometry": ("nav_msgs/msg/Odometry", 1),
        "/laser/back_2/pose_stamped": ("geometry_msgs/msg/PoseStamped", 1),
        "/tf_static": ("tf2_msgs/msg/TFMessage", 2),
    }
    with AnyReader([Path("bag")]) as reader:
        ext: dict[str, Any] = {one.topic: one.ext for one in reader.connections}
        quality = {name: one.offered_qos_profiles[0] for name, one in ext.items()}
    assert (quality["/red/scan"].reliability, quality["/red/scan"].depth) == (QosReliability.BEST_EFFORT, 5)
    assert (
        quality["/tf_static"].durability is QosDurability.TRANSIENT_LOCAL and quality["/tf_static"].depth > 1
    )
    assert quality["/odometry"].durability is QosDurability.VOLATILE


@pytest.mark.slow
def test_every_stock_type_is_read_by_rosbags_with_the_definition_in_the_bag() -> None:
    kinds = [kind for kind in stock_registry() if "/msg/" in kind.type_name]
    with LogFile(Path("a.mcap")) as log:
        for kind in kinds:
            log.add(kind(), "", "m")
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 0
    found = {}
    with AnyReader([Path("bag")]) as reader:
        for connection, time_ns, data in reader.messages():
            decoded = reader.deserialize(data, connection.msgtype)
            assert bytes(reader.typestore.serialize_cdr(decoded, connection.msgtype)) == bytes(data)
            assert time_ns == START_NS
            found[connection.msgtype] = bytes(data)
    assert found == {kind.type_name: kind().encode() for kind in kinds}


@pytest.mark.parametrize("command", ["import-rosbag", "none"])
def test_bag_becomes_the_same_log_again(command: str) -> None:
    write_robots_log(Path("a.mcap"))
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 0
    if command == "none":  # the bag itself is such a log, with the senders
        assert main(["diff", "a.mcap", "bag"]) == 0
    else:
        assert main([command, "bag", "b.mcap"]) == 0
        assert main(["diff", "a.mcap", "b.mcap", "--ignore-sender"]) == 0
        with open_log(Path("b.mcap")) as log:
            assert [one.topic for one in log.channels if one.is_latched] == ["tf_static"]
            assert "" in {one.topic for one in log.channels}


def test_log_of_a_bag_becomes_the_same_bag_again() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(scan(1), "scan", time_ns=START_NS)
        map_ = log.writer.register_channel("/map", "cdr", log._schemas[LaserScan.type_name], {
            "offered_qos_profiles": "- durability: transient_local"})  # fmt: skip
        log.add_bytes(map_, scan(2).encode(), START_NS + 7)
    assert main(["export", "a.mcap", "one", "--rosbag2"]) == 0
    assert main(["import-rosbag", "one", "b.mcap"]) == 0
    assert main(["export", "b.mcap", "two", "--rosbag2"]) == 0
    with AnyReader([Path("one")]) as one, AnyReader([Path("two")]) as two:
        first = [(c.topic, c.msgtype, c.ext, time, bytes(data)) for c, time, data in one.messages()]
        again = [(c.topic, c.msgtype, c.ext, time, bytes(data)) for c, time, data in two.messages()]
    assert first == again and len(first) == 2


def test_bag_begins_with_what_was_latched_before_the_log() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(OccupancyGrid(), "map", "mapper", time_ns=START_NS)
        log.add(TFMessage(), "tf_static", "arm", time_ns=START_NS)
        log.add(scan(1), "scan", time_ns=START_NS + 10**9)
    assert main(["recording", "cut", "a.mcap", "--from", "0.5", "-o", "b.mcap"]) == 0
    assert main(["export", "b.mcap", "bag", "--rosbag2"]) == 0
    assert names_in(Path("bag")).keys() == {"/tf_static", "/scan"}


def test_what_cannot_be_in_a_bag_is_counted(capsys: pytest.CaptureFixture[str]) -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(scan(1), "scan")
        nothing = log.writer.register_channel("/picture", "jpeg", 0, {})
        log.add_bytes(nothing, b"x", START_NS + 1)
        request = log.channel("robbie_msgs/srv/Do_Request", "bool x", 1, "", "a")
        log.add_bytes(request, b"\0\1\0\0\1", START_NS + 2)
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 1
    error = capsys.readouterr().err
    assert "left out 1: messages of 'picture', whose encoding is 'jpeg', not CDR" in error
    assert "left out 1: messages of type robbie_msgs/srv/Do_Request" in error
    assert names_in(Path("bag")).keys() == {"/scan"}


def test_balance_of_a_bag_is_what_the_log_holds(capsys: pytest.CaptureFixture[str]) -> None:
    with LogFile(Path("a.mcap")) as log:
        for number in range(20):
            log.add(scan(number), "scan", time_ns=START_NS + number)
        for number in range(10):
            log.writer.add_message(99, START_NS + number, b"", START_NS + number)
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 1
    shown = capsys.readouterr()
    assert "bag: read 30 messages: 20 used, 10 left out" in shown.out
    assert "left out 10: messages whose channel the file does not describe" in shown.err
    assert main(["import-rosbag", "a.mcap", "b.mcap"]) == 1
    assert "b.mcap: read 30 messages: 20 used, 10 left out" in capsys.readouterr().out


def test_folder_that_exists_is_refused_and_kept(capsys: pytest.CaptureFixture[str]) -> None:
    write_log(Path("a.mcap"))
    Path("bag").mkdir()
    Path("bag/precious").write_text("x")
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 2
    assert "bag cannot be written: File exists" in capsys.readouterr().err
    assert [one.name for one in Path("bag").iterdir()] == ["precious"]


@pytest.mark.parametrize(
    "profile",
    [
        "[",
        "[" * 500,
        "modules: !!int ''",
        "modules: 3",
        "modules: {ros: {class: x, settings: 2}}",
        PROFILE.replace("namespace: red", "namespace: 'a b'"),
        PROFILE.replace("namespace: red", "send: [1]"),
    ],
)
def test_profile_that_cannot_be_read_gives_no_names(profile: str) -> None:
    with LogFile(Path("a.mcap")) as log:
        log.writer.add_metadata("robbie_run", {"profile_yaml": profile})
        log.add(scan(1), "laser/front")
    assert main(["export", "a.mcap", "bag", "--rosbag2"]) == 0
    assert len(names_in(Path("bag"))) == 1
