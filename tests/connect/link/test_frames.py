"""The robot's name before the names of the frames in its messages."""

from robbie_mp import Header
from robbie_mp.connect.link.frames import prefixed
from robbie_mp.messages import (
    JointState,
    LaserScan,
    Odometry,
    Path,
    PoseStamped,
    String,
    TFMessage,
    TransformStamped,
)
from robbie_mp.messages.frames import has_frames

ODOMETRY = Odometry(header=Header(frame_id="odom"), child_frame_id="base_link")


def test_every_frame_in_a_message_gets_the_prefix_once() -> None:
    named = prefixed(ODOMETRY, "red/")
    assert isinstance(named, Odometry)
    assert (named.header.frame_id, named.child_frame_id) == ("red/odom", "red/base_link")
    assert prefixed(named, "red/") == named
    path = prefixed(Path(poses=[PoseStamped(header=Header(frame_id="map"))] * 2), "red/")
    assert isinstance(path, Path)
    assert [one.header.frame_id for one in path.poses] == ["red/map", "red/map"]
    assert path.header.frame_id == ""
    link = TransformStamped(header=Header(frame_id="map"), child_frame_id="odom")
    assert "red/odom" in repr(prefixed(TFMessage(transforms=[link]), "red/"))


def test_what_names_no_frame_stays_as_it_is() -> None:
    assert not has_frames(String)
    assert all(has_frames(one) for one in (LaserScan, JointState, TFMessage, Path))
    text = String(data="base_link")
    assert prefixed(text, "red/") is text
