"""What we serialise for ROS 1, rosbags and ROS's own genpy read, byte for byte; MD5 sums are equal, too."""

import base64
import json
import random
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from robbie_mp.connect.ros1.conversion import ConversionError, ros1_type
from robbie_mp.messages import (
    CameraInfo,
    Header,
    JointState,
    LaserScan,
    Message,
    OccupancyGrid,
    Path,
    PointCloud2,
    PointField,
    PoseStamped,
    TFMessage,
    Time,
    TransformStamped,
    message_type_from_schema,
    schema_text,
    stock_registry,
)
from tests.connect.ros1._support.ros import needs_ros1, system_python
from tests.messages._support.codec_fuzz import VARIABLE
from tests.messages._support.rosbags_bridge import jazzy, name_for_rosbags, store_with
from tests.messages._support.strategies import PATIENT, messages

STOCK = list(stock_registry())
NOETIC = get_typestore(Stores.ROS1_NOETIC)
NOETIC.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)  # rosbags does not have it
IN_ROS1 = [
    each for each in STOCK if each.type_name in NOETIC.fielddefs and not each.type_name.startswith("builtin")
]
RICH = (
    LaserScan(header=Header(stamp=Time(sec=5, nanosec=6), frame_id="läser"), ranges=np.array([1.0, np.nan])),
    Path(poses=[PoseStamped(header=Header(frame_id="a" * i)) for i in range(9)]),
    TFMessage(transforms=[TransformStamped(child_frame_id="b" * i) for i in range(9)]),
    PointCloud2(
        fields=[PointField(name="x" * i, count=i) for i in range(9)], data=np.arange(3, dtype=np.uint8)
    ),
    JointState(name=["", "left", "right"], position=np.arange(3.0), effort=np.ones(1)),
    CameraInfo(d=np.ones(1), k=np.arange(9.0), distortion_model="plumb_bob"),
    OccupancyGrid(data=np.array([-1, 0, 100])),
    VARIABLE(text="abc", few=np.ones(2), words=["a", "ä"], few_words=["b"]),
)
READ_BY_GENPY = """
import base64, io, json, sys
import genpy.message

found = {}
for name, data in json.load(sys.stdin):
    message_class = genpy.message.get_message_class(name)
    if message_class is not None:
        room = io.BytesIO()
        message_class().deserialize(base64.b64decode(data)).serialize(room)
        found[name] = message_class._md5sum, base64.b64encode(room.getvalue()).decode()
print(json.dumps(found))
"""


@cache
def all_types() -> Typestore:
    """ROS's types and ours, as ROS 2 has them: rosbags converts with these."""
    store = jazzy()
    for each in (*STOCK, VARIABLE):
        if name_for_rosbags(each.type_name) not in store.fielddefs:
            made = store_with(each.type_name, schema_text(each)).fielddefs
            store.register({name: one for name, one in made.items() if name not in store.fielddefs})
    return store


def check_with_rosbags(message: Message) -> None:
    kind, encoded = ros1_type(type(message)), message.encode()
    serialised = kind.to_ros1(encoded)
    assert serialised == bytes(all_types().cdr_to_ros1(encoded, name_for_rosbags(message.type_name)))
    assert kind.from_ros1(serialised) == encoded


def test_the_types_of_ros1_are_among_the_stock_types() -> None:
    names = {each.__name__ for each in IN_ROS1}
    assert {"LaserScan", "OccupancyGrid", "Path", "TFMessage", "Image", "Twist", "Odometry"} <= names
    assert len(IN_ROS1) >= 30


@pytest.mark.parametrize("message_type", IN_ROS1, ids=lambda each: each.type_name)
def test_a_type_has_the_md5_sum_that_it_has_in_ros1(message_type: type[Message]) -> None:
    assert ros1_type(message_type).md5 == NOETIC.generate_msgdef(message_type.type_name, ros_version=1)[1]


@pytest.mark.parametrize("message_type", STOCK, ids=lambda each: each.type_name)
def test_a_definition_has_the_md5_sum_that_is_given_with_it(message_type: type[Message]) -> None:
    kind = ros1_type(message_type)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(kind.definition, kind.name))
    package, name = kind.name.split("/")
    assert store.generate_msgdef(f"{package}/msg/{name}", ros_version=1)[1] == kind.md5


@pytest.mark.parametrize("message", RICH, ids=lambda each: type(each).__name__)
def test_a_message_is_serialised_as_by_rosbags(message: Message) -> None:
    check_with_rosbags(message)


@pytest.mark.slow
@pytest.mark.parametrize("message_type", STOCK, ids=lambda each: each.type_name)
@given(data=st.data())
@settings(PATIENT, max_examples=8)
def test_any_message_is_serialised_as_by_rosbags(message_type: type[Message], data: st.DataObject) -> None:
    check_with_rosbags(data.draw(messages(message_type)))


@pytest.mark.slow
@needs_ros1
def test_genpy_of_ros1_reads_every_stock_type_that_it_has() -> None:
    given = {ros1_type(type(one)).name: one for one in (*(each() for each in IN_ROS1), *RICH)}
    sent = {name: ros1_type(type(one)).to_ros1(one.encode(), 7) for name, one in given.items()}
    text = json.dumps([(name, base64.b64encode(data).decode()) for name, data in sent.items()])
    found = json.loads(system_python(READ_BY_GENPY, text))
    assert len(found) == len(IN_ROS1)
    for name, (md5, data) in found.items():
        assert base64.b64decode(data) == sent[name]
        assert md5 == ros1_type(type(given[name])).md5


def test_a_sequence_number_goes_into_the_header_of_the_message_and_not_into_inner_ones() -> None:
    path = ros1_type(Path).to_ros1(RICH[1].encode(), 7)
    read: Any = NOETIC.deserialize_ros1(path, Path.type_name)
    assert [read.header.seq, *(pose.header.seq for pose in read.poses)] == [7] + [0] * 9
    header: Any = NOETIC.deserialize_ros1(ros1_type(Header).to_ros1(Header().encode(), 7), Header.type_name)
    assert header.seq == 7


def test_an_empty_message_is_empty_in_ros1() -> None:
    nothing = ros1_type(message_type_from_schema("std_msgs/msg/Empty", ""))
    assert nothing.to_ros1(nothing.message_type().encode()) == b""
    assert nothing.from_ros1(b"") == nothing.message_type().encode()
    assert nothing.md5 == "d41d8cd98f00b204e9800998ecf8427e"


@pytest.mark.parametrize("message", RICH, ids=lambda each: type(each).__name__)
def test_damaged_bytes_are_refused_or_a_message(message: Message) -> None:
    kind, chance = ros1_type(type(message)), random.Random(1)
    encoded, serialised = message.encode(), ros1_type(type(message)).to_ros1(message.encode())
    for convert, data in ((kind.to_ros1, encoded), (kind.from_ros1, serialised)):
        refused = 0
        for _ in range(150):
            try:
                convert(changed(chance, data))
            except ConversionError:
                refused += 1
        assert refused > 10


def changed(chance: random.Random, data: bytes) -> bytes:
    """Bytes with one of them changed, or cut."""
    room = bytearray(data)
    room[chance.randrange(len(room))] = chance.choice((0, 1, 2, 0x80, 0xFF))
    return bytes(room[: chance.randrange(len(room))] if chance.random() < 0.3 else room)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"\5\0\0\0abc", "ends too early"),
        (b"\3\0\0\0a\0c", "NUL within"),
        (b"\1\0\0\0\xff", "not UTF-8"),
        (b"\1\0\0\0ab", "behind the last field"),
        (b"\1", "unpack"),
    ],
)
def test_a_text_that_is_none_is_refused_with_the_reason(data: bytes, reason: str) -> None:
    text = next(each for each in STOCK if each.__name__ == "String")
    with pytest.raises(ConversionError, match=reason) as caught:
        ros1_type(text).from_ros1(data)
    assert "std_msgs/" in str(caught.value)


def test_a_list_of_nothing_cannot_be_longer_than_its_message() -> None:
    schema = "test_msgs/Nothing[] nothings\n" + "=" * 80 + "\nMSG: test_msgs/Nothing\n"
    kind = ros1_type(message_type_from_schema("test_msgs/msg/Nothings", schema))
    with pytest.raises(ConversionError, match="longer than the message"):
        kind.from_ros1(b"\xff\xff\xff\x7f")
