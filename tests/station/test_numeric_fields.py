"""Paths to numbers in messages."""

import numpy as np
import pytest

from robbie_mp.messages import Image, LaserScan, Odometry, Path, Point, Pose, PoseStamped, TFMessage
from robbie_mp.messages.stock.registry import stock_registry
from robbie_mp.station.panels.numeric_fields import NoSuchNumber, number_reader, numeric_paths


def test_every_offered_path_can_be_read_from_every_stock_type() -> None:
    for message_type in stock_registry():
        for path in numeric_paths(message_type):
            value = number_reader(message_type, path)(message_type())
            assert value is None or isinstance(value, float)


def test_paths_lead_through_messages_lists_and_arrays() -> None:
    way = Path(poses=[PoseStamped(pose=Pose(position=Point(x=float(x)))) for x in range(3)])
    assert number_reader(Path, "poses[2].pose.position.x")(way) == 2.0
    scan = LaserScan(ranges=np.array([1.5, 2.5], np.float32))
    assert number_reader(LaserScan, "ranges[1]")(scan) == 2.5
    assert number_reader(LaserScan, "ranges[2]")(scan) is None


@pytest.mark.parametrize(
    ("message_type", "path", "says"),
    [
        (Odometry, "pose.pose.positon.x", "did you mean 'position'"),
        (Odometry, "pose", "no number"),
        (Odometry, "child_frame_id", "no number"),
        (Odometry, "pose.covariance[36]", "only 36"),
        (Odometry, "pose.covariance", "no number"),
        (Odometry, "", "no number"),
        (Odometry, "__class__", "no field"),
        (Odometry, "pose[0]", "nothing like"),
        (TFMessage, "transforms.x", "nothing like"),
        (Image, "data[", "expected a path"),
        (Image, "data[-1]", "expected a path"),
    ],
)
def test_invalid_paths_are_refused_with_the_reason(message_type: type, path: str, says: str) -> None:
    with pytest.raises(NoSuchNumber, match=says):
        number_reader(message_type, path)
