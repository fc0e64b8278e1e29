"""Conversion of messages to text, and of typed text to messages."""

import json
import math

import numpy as np
import pytest
import yaml

from robbie_mp.attached.views.message_text import (
    FieldPath,
    NoSuchField,
    flat,
    message_of_yaml,
    to_csv,
    to_json,
    to_yaml,
)
from robbie_mp.messages import FieldError, LaserScan, Odometry, Point, TFMessage, Transform, TransformStamped


def scan(size: int) -> LaserScan:
    return LaserScan(ranges=np.arange(size, dtype=np.float32), range_max=math.inf)


def test_field_is_found_in_messages_and_arrays() -> None:
    odometry = Odometry()
    assert FieldPath(Odometry, "pose.pose.position").value(odometry) == {"x": 0.0, "y": 0.0, "z": 0.0}
    assert FieldPath(LaserScan, "ranges[2]").value(scan(5)) == 2.0
    assert FieldPath(LaserScan, "ranges[5]").value(scan(5)) is None
    frames = TFMessage(transforms=[TransformStamped(child_frame_id="laser", transform=Transform())])
    assert FieldPath(TFMessage, "transforms[0].child_frame_id").value(frames) == "laser"


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("rangs", "no field 'rangs'; did you mean 'ranges'"),
        ("header.stamp.secs", "builtin_interfaces/msg/Time has no field 'secs'"),
        ("range_max[0]", "range_max is a float32, no array"),
        ("ranges.x", r"a float32\[\] has no field 'x'"),
        ("ranges[-1]", "is no field; write it as"),
    ],
)
def test_missing_field_is_reported_by_name(path: str, said: str) -> None:
    with pytest.raises(NoSuchField, match=said):
        FieldPath(LaserScan, path)


def test_yaml_is_valid_and_abbreviates_long_arrays() -> None:
    whole = FieldPath(LaserScan, "").value(scan(20))
    assert yaml.safe_load(to_yaml(whole))["ranges"] == list(map(float, range(20)))
    short = to_yaml(FieldPath(LaserScan, "").value(scan(20), full=False))
    assert "ranges: [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, … 12 more …, 19.0]" in short
    assert yaml.safe_load(short)["header"]["frame_id"] == ""


def test_json_contains_no_infinity() -> None:
    assert json.loads(to_json(FieldPath(LaserScan, "").value(scan(1))))["range_max"] is None


def test_csv_has_a_column_for_each_plain_field() -> None:
    row = dict(flat(FieldPath(LaserScan, "").value(scan(3))))
    assert row["header.stamp.sec"] == 0
    assert row["ranges"] == "[0.0, 1.0, 2.0]"
    assert to_csv(["a,b", 'say "x"', 3]) == '"a,b","say ""x""",3'


def test_yaml_input_becomes_a_message() -> None:
    odometry = message_of_yaml(Odometry, "{pose: {pose: {position: {x: 1, y: 2.5}}}, child_frame_id: base}")
    assert isinstance(odometry, Odometry)
    assert odometry.pose.pose.position == Point(x=1.0, y=2.5, z=0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "{pose: {pose: {position: {x: far}}}}",
            "^pose.pose.position: geometry_msgs/msg/Point.x: expected float64",
        ),
        ("{pose: {pose: {positon: {}}}}", "^pose.pose: .* has no field 'positon'; did you mean 'position'"),
        ("{child_frame_id: 3}", "^nav_msgs/msg/Odometry.child_frame_id: expected a str"),
        ("[1, 2]", "expected a map of its fields, as in '{field: 1}', got"),
    ],
)
def test_invalid_field_is_reported_with_its_path(text: str, said: str) -> None:
    with pytest.raises(FieldError, match=said):
        message_of_yaml(Odometry, text)
