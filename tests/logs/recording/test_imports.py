"""Logs of other formats are converted to ours, with the same messages, types and times."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from robbie_mp.base.balance import Balance, LeftOut
from robbie_mp.logs.recording.carmen_import import import_carmen
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.errors import BagUnreadable, LogNotWritten, LogUnreadable
from robbie_mp.logs.recording.reader import LoggedMessage, open_log
from robbie_mp.logs.recording.rosbag_import import import_rosbag
from robbie_mp.messages import CameraInfo, LaserScan, Odometry, TFMessage, schema_text, stock_registry
from tests.logs.recording._support.logs import START_NS

CARMEN = """\
PARAM robot_frontlaser_offset 0.15 nohost 0
ODOM 1.5 -2.5 0.5 0.3 -0.1 0 976052857.33 nohost 0.25
FLASER 4 1.0 2.0 81.83 0.5 1 2 3 1.5 -2.5 0.5 976052857.30 nohost 0.5
FLASER broken
ODOM 1.6 -2.5 0.5 0 0 0 976052857.10 nohost 0.75
"""
BROKEN = (
    "broken FLASER lines; the first is line 4: FLASER must state its number of beams as field 1, not 'broken'"
)
CUSTOM = "float32 level\nstring[] names\nstd_msgs/Header header"


def unwatched(_done: int, _all: int) -> None:
    pass


def read(path: Path) -> list[LoggedMessage]:
    with open_log(path) as log:
        assert log.is_complete
        return list(log.messages())


def test_carmen_log_becomes_odometry_scans_and_the_lasers_mounting_pose(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text(CARMEN)
    balance = Balance()
    import_carmen(tmp_path / "a.clf", tmp_path / "a.mcap", balance, progress=unwatched)
    assert (balance.used, balance.left_out) == (4, {BROKEN: 1})
    logged = read(tmp_path / "a.mcap")
    place, odometry, scan, last = map(LogDecoder().decode, logged)
    assert isinstance(place, TFMessage) and isinstance(scan, LaserScan) and isinstance(odometry, Odometry)
    assert place.transforms[0].transform.translation.x == 0.15
    assert [one.channel.topic for one in logged] == ["tf_static", "odom", "", "odom"]
    assert isinstance(last, Odometry) and last.pose.pose.position.x == 1.6
    assert scan.ranges.tolist() == np.array([1.0, 2.0, 81.83, 0.5], np.float32).tolist()
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (976052857, 300_000_000)
    first_ns = 976052857_330_000_000
    assert [one.time_ns - first_ns for one in logged] == [0, 0, 250_000_000, 500_000_000]


def test_strict_import_refuses_a_broken_line_and_leaves_no_log(tmp_path: Path) -> None:
    (tmp_path / "a.clf").write_text(CARMEN)
    balance = Balance(is_strict=True)
    with pytest.raises(LeftOut, match="broken FLASER lines; the first is line 4: "):
        import_carmen(tmp_path / "a.clf", tmp_path / "a.mcap", balance, progress=unwatched)
    assert not (tmp_path / "a.mcap").exists()


def test_unreadable_input_and_unwritable_output_are_reported(tmp_path: Path) -> None:
    source, target = tmp_path / "a.clf", tmp_path / "a.mcap"
    with pytest.raises(LogUnreadable, match="No such file"):
        import_carmen(source, target, Balance(), progress=unwatched)
    source.write_text(CARMEN)
    target.write_text("precious")
    with pytest.raises(LogNotWritten, match="File exists"):
        import_carmen(source, target, Balance(), progress=unwatched)
    assert target.read_text() == "precious"


def example_messages(types: Typestore, *, is_ros1: bool) -> list[tuple[str, str, Any]]:
    """Topic, type and message: one of ours, one of nobody's, one with ROS 1's name."""
    names = types.types
    time = names["builtin_interfaces/msg/Time"](sec=5, nanosec=6)
    seq = {"seq": 7} if is_ros1 else {}
    header = names["std_msgs/msg/Header"](stamp=time, frame_id="/laser" if is_ros1 else "laser", **seq)
    ranges = np.array([1, 2.5], np.float32)
    scan = names["sensor_msgs/msg/LaserScan"](
        header, -1.0, 1.0, 0.5, 0.0, 0.1, 0.0, 30.0, ranges, np.array([], np.float32)
    )
    custom = names["team_msgs/msg/Custom"](level=0.5, names=["a", "bc"], header=header)
    vector = names["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    turn = names["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    transform = names["geometry_msgs/msg/TransformStamped"](
        header, "child", names["geometry_msgs/msg/Transform"](vector, turn)
    )
    tf_type = "tf/msg/tfMessage" if is_ros1 else "tf2_msgs/msg/TFMessage"
    return [
        ("/scan", "sensor_msgs/msg/LaserScan", scan),
        ("/team/custom", "team_msgs/msg/Custom", custom),
        ("/tf", tf_type, names[tf_type]([transform])),
    ]


def write_bag(folder: Path, form: str) -> Path:
    is_ros1 = form == "ROS 1"
    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    types.register(get_types_from_msg(CUSTOM, "team_msgs/msg/Custom"))
    if is_ros1:
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage"))
        path = folder / "a.bag"
        writer: Any = Writer1(path)
    else:
        path = folder / "bag"
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin[form])
    with writer:
        for number, (topic, kind, message) in enumerate(example_messages(types, is_ros1=is_ros1)):
            connection = writer.add_connection(topic, kind, typestore=types)
            encode = types.serialize_ros1 if is_ros1 else types.serialize_cdr
            writer.write(connection, START_NS + number, encode(message, kind))
    return path


@pytest.mark.parametrize("form", ["ROS 1", "SQLITE3", "MCAP"])
def test_bag_becomes_a_log_with_the_same_messages_and_times(tmp_path: Path, form: str) -> None:
    balance = Balance()
    import_rosbag(write_bag(tmp_path, form), tmp_path / "a.mcap", balance, progress=unwatched)
    assert (balance.used, balance.left_out) == (3, {})
    logged = read(tmp_path / "a.mcap")
    messages: list[Any] = list(map(LogDecoder().decode, logged))
    assert [one.time_ns - START_NS for one in logged] == [0, 1, 2]
    assert [one.channel.topic for one in logged] == ["scan", "team/custom", "tf"]
    scan, custom, tf = messages
    assert isinstance(scan, LaserScan) and isinstance(tf, TFMessage)
    assert logged[0].channel.schema == schema_text(LaserScan)
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec, scan.header.frame_id) == (5, 6, "laser")
    assert (scan.ranges.tolist(), scan.range_max) == ([1.0, 2.5], 30.0)
    assert (custom.level, custom.names, custom.header.frame_id) == (0.5, ["a", "bc"], "laser")
    assert tf.transforms[0].transform.translation.y == 2.0 and tf.transforms[0].child_frame_id == "child"


def test_type_with_another_layout_keeps_its_definition(tmp_path: Path) -> None:
    types = get_typestore(Stores.EMPTY)
    kind = "geometry_msgs/msg/Point"
    types.register(get_types_from_msg("float32 x", kind))
    with Writer2(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/p", kind, typestore=types)
        writer.write(connection, START_NS, types.serialize_cdr(types.types[kind](1.5), kind))
    import_rosbag(tmp_path / "bag", tmp_path / "a.mcap", Balance(), progress=unwatched)
    (logged,) = read(tmp_path / "a.mcap")
    assert logged.channel.schema == "float32 x\n" and len(logged.data) == 8


def test_messages_that_contradict_their_definition_are_skipped_and_counted(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    kind = "std_msgs/msg/String"
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/s", kind, typestore=types)
        writer.write(connection, 1, b"\xff\0\0\0too short")
        writer.write(connection, 2, bytes(types.serialize_ros1(types.types[kind]("well"), kind)))
    balance = Balance()
    import_rosbag(tmp_path / "a.bag", tmp_path / "a.mcap", balance, progress=unwatched)
    assert balance.used == 1 and balance.left_out == {f"messages of /s that are no {kind}": 1}


@pytest.mark.parametrize("content", [None, b"", b"#ROSBAG V2.0\ngarbage"])
def test_file_that_is_not_a_bag_is_reported(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(BagUnreadable, match=r"a\.bag cannot be read as a bag of ROS"):
        import_rosbag(tmp_path / "a.bag", tmp_path / "a.mcap", Balance(), progress=unwatched)
    assert not (tmp_path / "a.mcap").exists()


BASE_BYTES = {"bool": 1, "char": 1, "byte": 1, "octet": 1, "string": 4, "float32": 4, "float64": 8}
BASE_BYTES |= {f"{sign}int{bits}": bits // 8 for bits in (8, 16, 32, 64) for sign in ("", "u")}


def empty_size(types: Typestore, kind: str) -> int:
    """Bytes of a message in which everything is 0 or empty, in the encoding of ROS 1."""
    return sum(field_size(types, node) for _, node in types.fielddefs[kind][1])


def field_size(types: Typestore, node: Any) -> int:
    what, about = node
    match what:
        case Nodetype.BASE:
            return BASE_BYTES[about[0]]
        case Nodetype.NAME:
            return empty_size(types, about)
        case Nodetype.ARRAY:
            return int(about[1]) * field_size(types, about[0])
    return 4


def test_every_ros_1_type_that_we_have_gets_our_schema(tmp_path: Path) -> None:
    """Of all types of ROS Noetic; its CameraInfo has D, K, R and P, which ROS 2 has renamed."""
    noetic, ours = get_typestore(Stores.ROS1_NOETIC), stock_registry()
    kinds = [kind for kind in noetic.fielddefs if kind in ours]
    assert "sensor_msgs/msg/CameraInfo" in kinds and len(kinds) > 30
    with Writer1(tmp_path / "a.bag") as writer:
        for kind in kinds:
            connection = writer.add_connection(f"/{kind}", kind, typestore=noetic)
            writer.write(connection, START_NS, bytes(empty_size(noetic, kind)))
    balance = Balance()
    import_rosbag(tmp_path / "a.bag", tmp_path / "a.mcap", balance, progress=unwatched)
    assert (balance.used, balance.left_out) == (len(kinds), {})
    for one in read(tmp_path / "a.mcap"):
        assert one.channel.schema == schema_text(ours.get(one.channel.type_name))
        assert type(LogDecoder().decode(one)) is ours.get(one.channel.type_name)


def test_matrices_of_a_ros_1_camera_keep_their_places(tmp_path: Path) -> None:
    noetic, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/CameraInfo"
    data = bytearray(empty_size(noetic, kind))
    matrices = struct.Struct("<I30d")
    matrices.pack_into(data, 16 + 8 + 4, 0, *range(30))  # after the header, the size, and the model's name
    with Writer1(tmp_path / "a.bag") as writer:
        writer.write(writer.add_connection("/info", kind, typestore=noetic), START_NS, bytes(data))
    import_rosbag(tmp_path / "a.bag", tmp_path / "a.mcap", Balance(), progress=unwatched)
    info = LogDecoder().decode(*read(tmp_path / "a.mcap"))
    assert isinstance(info, CameraInfo)
    assert [*info.d, *info.k, *info.r, *info.p] == list(range(30))


def test_byte_of_ros1_keeps_its_sign(tmp_path: Path) -> None:
    types = get_typestore(Stores.EMPTY)
    kind = "team_msgs/msg/Old"
    types.register(get_types_from_msg("byte LEAST=-1\nbyte level\nbyte[] levels\nchar letter", kind))
    with Writer1(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/old", kind, typestore=types)
        message = types.types[kind](level=-2, levels=np.array([-3, 4], np.int8), letter=200)
        writer.write(connection, START_NS, types.serialize_ros1(message, kind))
    balance = Balance()
    import_rosbag(tmp_path / "a.bag", tmp_path / "a.mcap", balance, progress=unwatched)
    (logged,) = read(tmp_path / "a.mcap")
    decoded: Any = LogDecoder().decode(logged)
    assert (decoded.LEAST, decoded.level, decoded.levels.tolist()) == (-1, -2, [-3, 4])
    assert decoded.letter == 200 and balance.left_out == {}
