"""Frames that have other names on the other side of a bridge."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.connect.bridge.frames import MAX_FRAMES, ForeignFrame, FrameMap
from robbie_mp.connect.bridge.mapping import MappingError
from robbie_mp.messages import (
    DecodeError,
    Header,
    Image,
    Message,
    Odometry,
    Path,
    PoseStamped,
    String,
    TFMessage,
    TransformStamped,
)

RED = FrameMap({"map": "map", "*": "red/{frame}"})
names = st.from_regex(r"[a-z_][a-z0-9_/]{0,8}", fullmatch=True)


def there(message: Message, frames: FrameMap = RED) -> Message:
    """The message as the other side gets it."""
    return type(message).decode(frames.outward(type(message))(message.encode()))


def test_frames_are_renamed_at_any_depth_and_back() -> None:
    messages: list[Message] = [
        Odometry(header=Header(frame_id="odom"), child_frame_id="base_link"),
        TFMessage(
            transforms=[
                TransformStamped(header=Header(frame_id="map"), child_frame_id="odom"),
                TransformStamped(header=Header(frame_id="odom"), child_frame_id="base_link"),
            ]
        ),
        Path(header=Header(frame_id="map"), poses=[PoseStamped(header=Header(frame_id="odom"))]),
        Image(header=Header(frame_id="camera"), height=2, width=3, data=np.arange(6, dtype=np.uint8)),
    ]
    for message in messages:
        sent = RED.outward(type(message))(message.encode())
        assert bytes(RED.inward(type(message))(sent)) == message.encode()
    odometry, transforms, path, image = map(there, messages)
    assert isinstance(odometry, Odometry)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("red/odom", "red/base_link")
    assert isinstance(transforms, TFMessage)
    assert [one.header.frame_id for one in transforms.transforms] == ["map", "red/odom"]
    assert isinstance(path, Path)
    assert path.poses[0].header.frame_id == "red/odom"
    assert isinstance(image, Image)
    assert image.header.frame_id == "red/camera"
    assert image.data.tolist() == [0, 1, 2, 3, 4, 5]


def test_message_whose_frame_keeps_its_name_is_passed_on_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = FrameMap({"odom": "red/odom"})
    image, text = Image(header=Header(frame_id="camera")).encode(), String(data="odom").encode()
    rename = frames.outward(Image)
    monkeypatch.setattr(rename, "_type", None)  # so that decoding it would fail
    assert rename(image) is image
    assert frames.outward(String)(text) is text
    assert FrameMap({}).outward(TFMessage)(image) is image


def test_frames_come_in_without_the_slash_of_ros_1() -> None:
    given = [
        Odometry(header=Header(frame_id="/odom"), child_frame_id="base_link"),
        TFMessage(transforms=[TransformStamped(header=Header(frame_id="map"), child_frame_id="//odom")]),
        Image(header=Header(frame_id="/camera"), height=1, width=1, data=np.zeros(1, np.uint8)),
        Path(header=Header(frame_id="map"), poses=[PoseStamped(header=Header(frame_id="/odom"))]),
    ]
    odometry, transforms, image, path = (
        type(one).decode(FrameMap({}).inward(type(one))(one.encode())) for one in given
    )
    assert isinstance(odometry, Odometry) and isinstance(transforms, TFMessage)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert transforms.transforms[0].child_frame_id == "odom"
    assert isinstance(image, Image) and image.header.frame_id == "camera"
    assert isinstance(path, Path) and path.poses[0].header.frame_id == "odom"
    assert RED.name_here("/red/odom") == "odom"


@given(st.lists(st.text("ab/é\n", max_size=20), max_size=4))
def test_messages_without_slashes_come_in_as_they_are(frames: list[str]) -> None:
    given = TFMessage(transforms=[TransformStamped(header=Header(frame_id=frame)) for frame in frames])
    data = given.encode()
    came = FrameMap({}).inward(TFMessage)(data)
    assert (came is data) == (not any(frame.startswith("/") for frame in frames))
    assert [one.header.frame_id for one in TFMessage.decode(came).transforms] == [
        frame.lstrip("/") for frame in frames
    ]


def test_frame_that_means_another_one_here_is_refused() -> None:
    renamed = FrameMap({"map": "red/map"})
    assert renamed.name_here("red/map") == "map"
    assert renamed.name_here("camera") == "camera"
    for frames, name in ((renamed, "map"), (RED, "base_link"), (RED, "red/map"), (RED, "red/")):
        with pytest.raises(ForeignFrame, match="no frame"):
            frames.name_here(name)


def test_wrong_bytes_are_no_message() -> None:
    for message_type in (Image, TFMessage):
        with pytest.raises(DecodeError):
            RED.inward(message_type)(b"\0\1\0\0\xff\xff\xff\xff")


@given(st.dictionaries(names, names, max_size=4), st.booleans(), names)
def test_every_frame_has_one_name_and_comes_back(exact: dict[str, str], others: bool, name: str) -> None:
    try:
        frames = FrameMap(exact | ({"*": "r/{frame}_x"} if others else {}))
    except MappingError:
        return
    assert frames.name_there("") == frames.name_here("") == ""
    if others or name in exact:
        assert frames.name_here(frames.name_there(name)) == name


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ({"map": "a", "odom": "a"}, "two frames have the same name"),
        ({"map": ""}, "not a name of a frame"),
        ({"map": "a b"}, "not a name of a frame"),
        ({"*": "red"}, "expected a name with {frame}"),
        ({"map": "red/odom", "*": "red/{frame}"}, "'odom' is called 'red/odom', too"),
        ({f"a{number}": f"b{number}" for number in range(MAX_FRAMES + 1)}, "at most"),
    ],
)
def test_wrong_settings_are_explained(frames: dict[str, str], reason: str) -> None:
    with pytest.raises(MappingError, match=reason):
        FrameMap(frames)
