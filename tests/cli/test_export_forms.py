"""`robbie export` as trajectories, PLY and CSV with units, read again by the rules of these formats."""

import csv
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import Header, Time
from robbie_mp.cli import main
from robbie_mp.messages import (
    LaserScan,
    Odometry,
    Point,
    PointCloud2,
    PointField,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Twist,
    Vector3,
    stock_registry,
)
from robbie_mp.messages.units import units
from tests.logs.recording._support.logs import START_NS, LogFile, scan, write_log

HALF = 0.5**0.5
QUARTER_TURN = Quaternion(x=0.0, y=0.0, z=HALF, w=HALF)
"""About z."""
PLY_KINDS = {"float": "f", "double": "d", "uchar": "B", "ushort": "H", "int": "i"}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def header(frame: str = "map", nanosec: int = 5) -> Header:
    return Header(stamp=Time(sec=1_700_000_001, nanosec=nanosec), frame_id=frame)


def stamped(pose: Pose) -> PoseStamped:
    return PoseStamped(header=header(), pose=pose)


def test_trajectory_of_tum_has_time_position_and_quaternion() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(stamped(Pose(position=Point(x=1.5, y=-2.0, z=3.0), orientation=QUARTER_TURN)), "pose")
        log.add(Odometry(), "odom", time_ns=START_NS)  # without a stamp: the time of its publication
    assert main(["export", "a.mcap", "out", "--trajectory", "tum"]) == 0
    lines = Path("out/pose.tum").read_text().splitlines()
    assert lines[0].startswith("#")
    assert lines[1].split()[0] == "1700000001.000000005"
    rows = np.loadtxt("out/pose.tum", comments="#", ndmin=2)
    assert rows[0, 1:] == pytest.approx([1.5, -2, 3, 0, 0, HALF, HALF])
    assert Path("out/odom.tum").read_text().splitlines()[1] == "1700000000.000000000 0 0 0 0 0 0 1"


def test_trajectory_of_kitti_is_three_rows_of_the_pose_matrix() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(stamped(Pose(position=Point(x=1.5, y=-2.0, z=3.0), orientation=QUARTER_TURN)), "pose")
    assert main(["export", "a.mcap", "out", "--trajectory", "kitti"]) == 0
    matrix = np.loadtxt("out/pose.kitti").reshape(3, 4)
    expected = [[0, -1, 0, 1.5], [1, 0, 0, -2], [0, 0, 1, 3]]  # x ahead becomes y
    assert matrix == pytest.approx(np.array(expected), abs=1e-9)


def test_each_pair_of_frames_of_transforms_is_a_trajectory() -> None:
    def moved(child: str, x: float) -> TransformStamped:
        place = Transform(translation=Vector3(x=x), rotation=Quaternion(w=1.0))
        return TransformStamped(header=header("map"), child_frame_id=child, transform=place)

    with LogFile(Path("a.mcap")) as log:
        log.add(TFMessage(transforms=[moved("base", 1.0), moved("arm", 2.0)]), "tf")
        log.add(TFMessage(transforms=[moved("base", 3.0)]), "tf")
    assert main(["export", "a.mcap", "out", "--trajectory", "tum"]) == 0
    assert sorted(path.name for path in Path("out").iterdir()) == ["tf-map-arm.tum", "tf-map-base.tum"]
    assert np.loadtxt("out/tf-map-base.tum", comments="#")[:, 1].tolist() == [1, 3]


def test_what_is_no_pose_is_left_out_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(stamped(Pose(orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))), "pose")
        log.add(stamped(Pose(position=Point(x=float("nan")), orientation=QUARTER_TURN)), "pose")
        log.add(stamped(Pose(orientation=QUARTER_TURN)), "pose")
    assert main(["export", "a.mcap", "out", "--trajectory", "tum"]) == 1
    said = capsys.readouterr()
    assert said.out == "out: read 3 messages: 1 used, 2 left out\n"
    assert "left out 1: messages of 'pose': a rotation that is no quaternion" in said.err
    assert "left out 1: messages of 'pose': a position that is not finite" in said.err
    assert len(Path("out/pose.tum").read_text().splitlines()) == 2


def read_ply(path: Path) -> tuple[list[str], list[tuple[Any, ...]]]:
    """The names of the properties and the vertices of a PLY file, by the rules of its header."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    (count,) = [int(line.split()[2]) for line in lines if line.startswith("element vertex")]
    properties = [line.split()[1:] for line in lines if line.startswith("property")]
    point = struct.Struct("<" + "".join(PLY_KINDS[kind] for kind, _ in properties))
    assert len(body) == count * point.size
    return [name for _, name in properties], list(point.iter_unpack(body))


def cloud(*, is_bigendian: bool) -> PointCloud2:
    """Two points in a row with a gap in each point and behind the row."""
    order = ">" if is_bigendian else "<"
    point = struct.Struct(f"{order}fffxxxxIH")
    data = point.pack(1, 2, 3, 0x00FF8040, 7) + point.pack(-1, 0.5, 0, 0x00010203, 9) + b"gap"
    names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("rgb", 16, 7), ("ring", 20, 4)]
    return PointCloud2(
        header=header("lidar front"),
        height=1,
        width=2,
        fields=[PointField(name=name, offset=at, datatype=kind, count=1) for name, at, kind in names],
        is_bigendian=is_bigendian,
        point_step=point.size,
        row_step=2 * point.size + 3,
        data=np.frombuffer(data, np.uint8),
    )


@pytest.mark.parametrize("is_bigendian", [False, True])
def test_cloud_as_ply_keeps_types_and_unpacks_colours(is_bigendian: bool) -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(cloud(is_bigendian=is_bigendian), "points")
    assert main(["export", "a.mcap", "out", "--ply"]) == 0
    names, points = read_ply(Path("out/points/1700000001.000000005.ply"))
    assert names == ["x", "y", "z", "red", "green", "blue", "ring"]
    assert points == [(1, 2, 3, 255, 128, 64, 7), (-1, 0.5, 0, 1, 2, 3, 9)]


def test_scan_as_ply_has_the_beams_with_a_return() -> None:
    ranges = np.array([1, np.inf, 2, np.nan, 0.01, 99], np.float32)
    sweep = LaserScan(
        header=header("laser"), angle_min=0.0, angle_increment=np.pi / 4, range_min=0.1, range_max=30.0,
        ranges=ranges, intensities=np.arange(6, dtype=np.float32),
    )  # fmt: skip
    with LogFile(Path("a.mcap")) as log:
        log.add(sweep, "scan")
        log.add(PointCloud2(height=1, width=9, point_step=4, row_step=36), "points")
    assert main(["export", "a.mcap", "out", "--ply"]) == 1  # the cloud has no data
    names, points = read_ply(Path("out/scan/1700000001.000000005.ply"))
    assert names == ["x", "y", "z", "intensity"]
    assert np.array(points) == pytest.approx(np.array([[1, 0, 0, 0], [0, 2, 0, 2]]), abs=1e-6)


def test_heading_of_csv_has_the_unit_that_the_definition_states() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(Twist(linear=Vector3(x=1.0)), "twist")
        schema = "float32 speed  # of the belt [m/s]\nfloat32 level # 3 [0, 1]\nstring name # [m]\n"
        log.add_bytes(log.channel("team_msgs/msg/Belt", schema, 1, "belt", ""), b"\0\1\0\0" + bytes(13), 1)
    assert main(["export", "a.mcap", "out"]) == 0
    with Path("out/twist.csv").open() as file:
        heading = next(csv.reader(file))
    assert heading[2:4] == ["linear.x [m/s]", "linear.y [m/s]"] and heading[5] == "angular.x [rad/s]"
    with Path("out/belt.csv").open() as file:
        assert next(csv.reader(file))[2:] == ["speed [m/s]", "level", "name"]


def test_units_are_those_beside_the_fields_and_none_is_invented() -> None:
    found = units(LaserScan, "", stock_registry())
    assert found["ranges"] == "m" and found["angle_increment"] == "rad" and found["scan_time"] == "s"
    assert not {"intensities", "header.frame_id", "header.stamp.nanosec"} & set(found)


@pytest.mark.parametrize(
    "form",
    [[], ["--npz"], ["--parquet"], ["--ply"], ["--trajectory", "tum"], ["--rosbag2"]],
    ids=" ".join,
)
def test_strict_export_of_a_damaged_log_leaves_nothing(
    form: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(Path("a.mcap"), 30)
    Path("cut.mcap").write_bytes(log.read_bytes()[:-6000])
    Path("mine").mkdir()
    Path("mine/notes.txt").touch()
    out = "out" if "--rosbag2" in form else "mine"
    assert main(["export", "cut.mcap", out, *form, "--strict"]) == 1
    assert "left out: what is damaged: cut.mcap: byte" in capsys.readouterr().err
    assert [path.name for path in Path("mine").iterdir()] == ["notes.txt"]
    assert not Path("out").exists()
    assert main(["export", "cut.mcap", out, *form]) == 1
    assert main(["export", "a.mcap", "whole", *form, "--strict"]) == 0


def test_failed_export_leaves_no_folder_that_it_made() -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(scan(1), "first")
        log.add_bytes(log.channel("team_msgs/msg/Odd", "wstring x", 1, "odd", ""), b"", 1)
    assert main(["export", "a.mcap", "deep/in/it", "--strict"]) == 1
    assert not Path("deep").exists()


@pytest.mark.parametrize("form", [[], ["--npz"], ["--parquet"]], ids=" ".join)
def test_message_of_an_impossible_time_is_left_out(
    form: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with LogFile(Path("a.mcap")) as log:
        for time_ns in (1 << 63, 7):
            log.add(scan(1), "it", time_ns=time_ns)
    assert main(["export", "a.mcap", "out", *form]) == 1
    told = capsys.readouterr()
    assert "whose time is after the year 2262" in told.err and "1 used, 1 left out" in told.out
