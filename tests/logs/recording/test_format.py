"""The parts of a Robbie log that MCAP does not define."""

from pathlib import Path

import pytest

from robbie_mp.logs.recording.format import (
    PART_NAME,
    ChannelKey,
    RecordedCount,
    RunMetadata,
    TopicNames,
    counts_from_metadata,
    counts_metadata,
    part_path,
)
from robbie_mp.logs.recording.topic_names import ros_topic

SCAN = ChannelKey("sensor_msgs/msg/LaserScan", 1, "front", "laser")


def test_channel_without_a_topic_is_named_after_its_type() -> None:
    names = TopicNames()
    assert names.of(SCAN) == "/front"
    assert names.of(SCAN._replace(topic="")) == "/laser_scan"


def test_two_types_never_share_a_topic_and_two_senders_of_one_type_do() -> None:
    names = TopicNames()
    assert names.of(SCAN) == names.of(SCAN._replace(sender="other")) == "/front"
    assert names.of(SCAN._replace(type_name="a_msgs/msg/Echo")) == "/front/echo"
    assert names.of(SCAN._replace(type_name="b_msgs/msg/Echo")) == "/front/b_msgs/msg/Echo"


@pytest.mark.parametrize(
    ("type_name", "topic", "name"),
    [
        ("sensor_msgs/msg/Image", "camera", "camera"),
        ("sensor_msgs/msg/CameraInfo", "camera", "camera/camera_info"),
        ("robbie_msgs/msg/Tick", "camera", "camera/tick"),
        ("robbie_msgs/action/NavigateTo_Goal", "call", "call/navigate_to_goal"),
        ("sensor_msgs/msg/CameraInfo", "", "camera_info"),
        ("std_msgs/msg/String", "2nd floor/a-b", "_2nd_floor/a_b"),
    ],
)
def test_name_of_a_topic_depends_on_type_and_topic_alone(type_name: str, topic: str, name: str) -> None:
    assert ros_topic(type_name, topic) == name


def test_written_counts_are_read_back() -> None:
    counts = {SCAN: RecordedCount(17, 3), SCAN._replace(topic='"', sender=""): RecordedCount(0, 1)}
    assert counts_from_metadata(counts_metadata(counts.items())) == counts


@pytest.mark.parametrize("text", ["", "[1]", "{}", '[{"type": "a"}]', "7", '[{"type": 0, "version": null}]'])
def test_record_without_counts_is_a_value_error(text: str) -> None:
    try:
        assert counts_from_metadata({"channels": text}) == {}
    except ValueError:
        return
    assert text == "{}"


def test_written_run_metadata_is_read_back_and_missing_fields_are_empty() -> None:
    run = RunMetadata("ab", "demo", "lisa", "0.1", "3.11", 4, 99, 10**18, "system", "modules: {}\n")
    assert RunMetadata.from_metadata(run.as_metadata()) == run
    assert RunMetadata.from_metadata({"part": "x"}).part == 0


def test_parts_are_named_after_their_folder() -> None:
    path = part_path(Path("logs/monday"), 12)
    assert path == Path("logs/monday/monday_0012.mcap")
    found = PART_NAME.fullmatch(path.name)
    assert found is not None
    assert found.groupdict() == {"name": "monday", "number": "0012"}
