"""The readers under test, with valid inputs for each."""

import functools
import io
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from PIL import Image

from robbie_mp.base.balance import Balance
from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.recording.carmen_import import import_carmen
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.info import describe
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.repair import repair, unwatched
from robbie_mp.logs.recording.rosbag_import import import_rosbag
from robbie_mp.messages import (
    Header,
    LaserScan,
    Message,
    String,
    TFMessage,
    TransformStamped,
    message_type_from_schema,
    schema_text,
    stock_registry,
)
from robbie_mp.run.profile.load import load_profile
from robbie_mp.scene import SceneFileError, SceneGraph, SceneNotes, read_scene
from robbie_mp.scene.urdf import describe_urdf
from robbie_robots.hw.framing import DamagedFrame
from robbie_robots.hw.gnss import nmea, ubx
from robbie_robots.hw.gnss.receiver import NmeaReceiver, UbxReceiver
from robbie_robots.hw.simulation.urdf_solids import UrdfShapeError, read_urdf_solids
from robbie_robots.hw.video.calibration import CalibrationError, read_calibration
from robbie_robots.hw.video.huffman import with_huffman_tables
from robbie_robots.hw.video.jpeg_check import whole_jpeg
from robbie_robots.workers.maps.map_annotations import AnnotationFileError, read_annotations
from robbie_robots.workers.maps.map_file import describe_map, read_map
from robbie_robots.workers.maps.map_yaml import MapFileError
from tools.fuzz.readers.campaign import Files, ReaderUnderTest

ROOT = Path(__file__).parents[3]
START_NS = 1_700_000_000_000_000_000
WIDTH, HEIGHT = 64, 48
DATA = "data"


# -- logs ----------------------------------------------------------------------------------------------


def _messages(count: int) -> Iterator[tuple[str, Message]]:
    for number in range(count):
        yield "scan", LaserScan(header=Header(frame_id="laser"), ranges=np.full(12, number, np.float32))
        yield "text", String(data=f"number {number}")


def _log(compression: CompressionType, **options: Any) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, compression=compression, chunk_size=600, **options)
    writer.start("ros2", "robbie-mp fuzz")
    channels: dict[str, int] = {}
    for number, (topic, message) in enumerate(_messages(4)):
        kind = type(message)
        if topic not in channels:
            schema = writer.register_schema(kind.type_name, "ros2msg", schema_text(kind).encode())
            about = {"robbie_topic": topic, "robbie_version": str(kind.version), "robbie_sender": "base"}
            channels[topic] = writer.register_channel(f"/{topic}", "cdr", schema, about)
        time_ns = START_NS + number * 10**8
        writer.add_message(channels[topic], time_ns, message.encode(), time_ns, number)
    writer.add_metadata("robbie_run", {"run_id": "0123abcd", "profile": "demo", "host": "h", "part": "0"})
    writer.add_attachment(START_NS, START_NS, "note.txt", "text/plain", b"hello")
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def _logs() -> list[Files]:
    kinds = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
    return [{"log.mcap": _log(kind)} for kind in kinds] + [
        {"log.mcap": _log(CompressionType.NONE, use_chunking=False)}
    ]


def _read_log(folder: Path) -> None:
    _read_file(folder / "log.mcap")


def _read_file(path: Path) -> None:
    decoder = LogDecoder()
    with open_log(path) as log:
        describe(log)
        for logged in log.messages():
            with suppress(RobbieError):  # a message that is refused does not end a log
                decoder.decode(logged)


def _repair(folder: Path) -> None:
    repair(folder / "log.mcap", folder / "repaired.mcap", unwatched)


CARMEN = b"""PARAM robot_frontlaser_offset 0.15 nohost 0
ODOM 1.5 -2.5 0.5 0.3 -0.1 0 976052857.33 nohost 0.25
FLASER 4 1.0 2.0 81.83 0.5 1 2 3 1.5 -2.5 0.5 976052857.30 nohost 0.5
ROBOTLASER1 0 -1.57 3.14 1.57 20 0.01 0 3 1.0 2.0 3.0 0 1 2 0.5 1 2 0.5 0 0 0.3 0.5 0 976052857.5 nohost 0.6
RAWLASER1 0 -1.57 3.14 1.57 20 0.01 0 3 1.0 2.0 3.0 0 976052857.5 nohost 0.6
"""


def _import(make: Callable[..., object], source: str, folder: Path) -> None:
    make(folder / source, folder / "new.mcap", Balance(), progress=unwatched)
    _read_file(folder / "new.mcap")


def _bag1() -> list[Files]:
    from rosbags.rosbag1 import Writer as Writer1  # noqa: PLC0415 - an extra
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    types = get_typestore(Stores.ROS1_NOETIC)
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "a.bag"
        with Writer1(path) as writer:
            _fill_bag(writer, types, types.serialize_ros1, {"seq": 7})
        return [{"a.bag": path.read_bytes()}]


def _bag2(storage: str) -> list[Files]:
    from rosbags.rosbag2 import StoragePlugin, Writer as Writer2  # noqa: I001, PLC0415 - an extra
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    types = get_typestore(Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "bag"
        with Writer2(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
            _fill_bag(writer, types, types.serialize_cdr, {})
        return [{f"bag/{file.name}": file.read_bytes() for file in path.iterdir()}]


def _fill_bag(writer: Any, types: Any, encode: Callable[[Any, str], Any], seq: dict[str, int]) -> None:
    names = types.types
    stamp = names["builtin_interfaces/msg/Time"](sec=5, nanosec=6)
    header = names["std_msgs/msg/Header"](stamp=stamp, frame_id="/laser", **seq)
    point = names["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    stamped = names["geometry_msgs/msg/PointStamped"](header, point)
    text = names["std_msgs/msg/String"](data="text")
    for topic, kind, message in (
        ("/point", "geometry_msgs/msg/PointStamped", stamped),
        ("/text", "std_msgs/msg/String", text),
    ):
        connection = writer.add_connection(topic, kind, typestore=types)
        for number in range(5):
            writer.write(connection, START_NS + number, encode(message, kind))


# -- maps, robots, profiles ----------------------------------------------------------------------------

MAP = b"image: map.%b\nmode: %b\n" + (
    b"resolution: 0.05\norigin: [-1.5, 2.0, %b]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def _maps() -> list[Files]:
    cells = np.random.default_rng(1).choice(np.array([0, 100, 205, 254, 255], np.uint8), (20, 30))
    images = {
        b"pgm": b"P5\n# a map\n30 20\n255\n" + cells.tobytes(),
        b"png": _png(Image.fromarray(cells)),
        b"PNG": _png(Image.fromarray(cells.astype(np.uint16) * 257)),
        b"Png": _png(Image.fromarray(np.dstack([cells] * 4), "RGBA")),
    }
    plain = b"P2\n30 20\n100\n" + b" ".join(b"%d" % (cell * 100 // 255) for cell in cells.ravel())
    return [
        {"map.yaml": MAP % (suffix, mode, yaw), f"map.{suffix.decode()}": image}
        for suffix, image in (*images.items(), (b"pgm", plain))
        for mode, yaw in ((b"trinary", b"0"), (b"scale", b"0.3"), (b"raw", b"0.0"))
    ]


def _png(image: Image.Image) -> bytes:
    file = io.BytesIO()
    image.save(file, "PNG")
    return file.getvalue()


def _read_map(folder: Path) -> None:
    describe_map(folder / "map.yaml")
    read_map(folder / "map.yaml")


ANNOTATIONS = b"""{"revision": 3, "no_go": {"stairs": [[0, 0], [1, 0], [1, 1.5]]},
"places": {"kitchen": [1.0, 2.0, 0.5]}}"""
ODD_URDF = b"""<?xml version="1.0"?>
<robot name="r" version="1.2">
<link name="a"><visual><geometry><mesh filename="package://r/a.stl"/></geometry></visual></link>
<link name="b"/><link name="c"/><link name="d"/><link name="e"/>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<origin xyz="1 2 3" quat_xyzw="0 0 0 1"/><limit lower="-1" upper="1" effort="-1" velocity="-1"/></joint>
<joint name="j2" type="continuous"><parent link="b"/><child link="c"/>
<mimic joint="j1" multiplier="0.5" offset="1"/></joint>
<joint name="j3" type="prismatic"><parent link="c"/><child link="d"/>
<mimic joint="j2"/><limit lower="0" upper="1"/></joint>
<joint name="j4" type="planar"><parent link="d"/><child link="e"/><origin rpy="0 1 0"/></joint></robot>
"""
SCENE_TOKENS = (b"mimic", b"*a", b"&a", b"<<", b"{")
URDF_TOKENS = (
    b"mimic",
    b"<joint",
    b'joint="j1"',
    b"floating",
    b"fixed",
    b"quat_xyzw",
    b"<!DOCTYPE r [",
    b"&lt;",
)


def _urdfs() -> list[Files]:
    shapes = (ROOT / "hw/robots/home.urdf").read_bytes().partition(b"<joint")[0]
    return [{"robot.urdf": text} for text in (ODD_URDF, shapes + b"</robot>")]


def _read_urdf(folder: Path) -> None:
    graph = SceneGraph(read_scene(folder / "robot.urdf", SceneNotes()))
    for name in graph.joints:
        graph.set_joint(name, 0, 1.0)
    describe_urdf(folder / "robot.urdf")


def _read_solids(folder: Path) -> None:
    read_urdf_solids(folder / "robot.urdf")


def _scenes() -> list[Files]:
    robot = (ROOT / "hw/robots/rescue.yaml").read_bytes()
    world = (
        b"nodes: {world: }\ninclude:\n  - {file: robot.yaml, prefix: red/, parent: world, rpy: [0, 0, 1]}\n"
    )
    return [{"scene.yaml": world, "robot.yaml": robot}]


def _read_scene(folder: Path) -> None:
    SceneGraph(read_scene(folder / "scene.yaml", SceneNotes()))


def _profiles() -> list[Files]:
    texts = [(ROOT / "profiles" / f"{name}.yaml").read_bytes() for name in ("demo", "rescue")]
    return [
        {"profiles/robot.yaml": text, "profiles/demo.yaml": texts[0], "pyproject.toml": b""} for text in texts
    ]


def _read_profile(folder: Path) -> None:
    load_profile("robot", folder)


CALIBRATION = b"""image_width: 640
image_height: 480
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [60, 0, 31.5, 0, 61, 23.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [59, 0, 31, 0, 0, 60, 23, 0, 0, 0, 1, 0]}
"""


# -- devices -------------------------------------------------------------------------------------------


def _nmea() -> list[Files]:
    lines = [
        nmea.sentence(f"GNGGA,184353.07,1929.045,S,02410.506,E,{quality},04,2.6,100.00,M,-33.9,M,,0000")
        for quality in range(10)
    ]
    return [{DATA: b"".join(lines)}]


def _read_nmea(folder: Path) -> None:
    NmeaReceiver("nowhere")._take((folder / DATA).read_bytes())


def _ubx() -> list[Files]:
    payload = bytearray(92)
    payload[20:22] = b"\x03\x01"
    return [{DATA: ubx.message(1, 7, bytes(payload)) * 5}]


def _read_ubx(folder: Path) -> None:
    UbxReceiver("nowhere")._take((folder / DATA).read_bytes())


def _jpegs() -> list[Files]:
    pixels = Image.fromarray(np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8))
    images = []
    for options in ({}, {"progressive": True}, {"restart_marker_blocks": 1}):
        file = io.BytesIO()
        pixels.save(file, "JPEG", **options)
        images.append({DATA: file.getvalue()})
    return images


def _read_jpeg(folder: Path) -> None:
    with_huffman_tables(whole_jpeg((folder / DATA).read_bytes(), WIDTH, HEIGHT))


# -- messages ------------------------------------------------------------------------------------------


def _types() -> list[type[Message]]:
    registry = stock_registry()
    return sorted(registry, key=lambda kind: kind.type_name)


def _schemas() -> list[Files]:
    return [{"name": kind.type_name.encode(), DATA: schema_text(kind).encode()} for kind in _types()]


def _read_schema(folder: Path) -> None:
    name = (folder / "name").read_bytes().decode("utf-8", "replace")
    kind = message_type_from_schema(name, (folder / DATA).read_bytes().decode("utf-8", "replace"))
    kind.decode(kind().encode())


def _encoded() -> list[Files]:
    transform = TransformStamped(header=Header(frame_id="map"), child_frame_id="odom")
    filled = [TFMessage(transforms=[transform] * 3), *(message for _, message in _messages(1))]
    every = [*filled, *(kind() for kind in _types())]
    return [{type(one).type_name.replace("/", "."): one.encode()} for one in every]


def _read_encoded(folder: Path) -> None:
    (file,) = folder.iterdir()
    kind = stock_registry().get(file.name.replace(".", "/"))
    message = kind.decode(file.read_bytes())
    kind.decode(message.encode())


def _files(name: str, *contents: bytes) -> Callable[[], list[Files]]:
    return lambda: [{name: content} for content in contents]


def subjects() -> dict[str, ReaderUnderTest]:
    """Return all readers by name."""
    return {
        "log": ReaderUnderTest(_logs, _read_log),
        "recording repair": ReaderUnderTest(_logs, _repair),
        "ros1-bag": ReaderUnderTest(_bag1, functools.partial(_import, import_rosbag, "a.bag")),
        "ros2-bag-sqlite": ReaderUnderTest(
            functools.partial(_bag2, "SQLITE3"), functools.partial(_import, import_rosbag, "bag")
        ),
        "ros2-bag-mcap": ReaderUnderTest(
            functools.partial(_bag2, "MCAP"), functools.partial(_import, import_rosbag, "bag")
        ),
        "carmen": ReaderUnderTest(
            _files("a.clf", CARMEN),
            functools.partial(_import, import_carmen, "a.clf"),
            tokens=(b"FLASER", b"ROBOTLASER1", b"RAWLASER1", b"ODOM", b"PARAM"),
        ),
        "map": ReaderUnderTest(
            _maps,
            _read_map,
            (MapFileError,),
            (b"scale", b"raw", b"negate", b"P2", b"P5", b"65535"),
        ),
        "map-annotations": ReaderUnderTest(
            _files("a.json", ANNOTATIONS),
            lambda folder: read_annotations(folder / "a.json"),
            (AnnotationFileError,),
        ),
        "urdf": ReaderUnderTest(_urdfs, _read_urdf, (SceneFileError,), URDF_TOKENS),
        "urdf-shapes": ReaderUnderTest(_urdfs, _read_solids, (UrdfShapeError,), URDF_TOKENS),
        "scene": ReaderUnderTest(
            _scenes, _read_scene, (SceneFileError,), (b"mimic", b"*a", b"&a", b"<<", b"{")
        ),
        "profile": ReaderUnderTest(_profiles, _read_profile, tokens=(b"${a}", b"*a", b"&a", b"parent: demo")),
        "calibration": ReaderUnderTest(
            _files("front.yaml", CALIBRATION),
            lambda folder: read_calibration(folder / "front.yaml"),
            (CalibrationError, OSError),
        ),
        "nmea": ReaderUnderTest(_nmea, _read_nmea, ()),
        "ubx": ReaderUnderTest(_ubx, _read_ubx, ()),
        "jpeg": ReaderUnderTest(_jpegs, _read_jpeg, (DamagedFrame,)),
        "schema": ReaderUnderTest(_schemas, _read_schema, tokens=(b"string", b"[]", b"<=3", b"[3]", b"MSG:")),
        "cdr": ReaderUnderTest(_encoded, _read_encoded),
    }
