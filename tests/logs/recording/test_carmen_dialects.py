"""CARMEN logs are read in all dialects, with the angles, places and remissions that their lines state."""

import bz2
import gzip
import lzma
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.base.balance import Balance
from robbie_mp.logs.recording.carmen import CarmenLog, DriveMessage, describe_carmen
from robbie_mp.logs.recording.errors import LogUnreadable, NotALog
from robbie_mp.messages import Imu, LaserScan, NavSatFix, NavSatStatus, Odometry, PoseStamped, TFMessage
from tests._support.places import PROJECT
from tests.logs.recording._support import carmen

FOREIGN = PROJECT.parent / "shared/data/foreign/carmen_robotlaser1.clf"
CONFIG = [-1.5, 3.0, 0.75, 50.0, 0.01]
RANGES = [1.0, 2.5, 3.25, 49.0, 50.0]
ORIGIN = [0.0, 0.0, 0.0]
PIECES = [b"", b"-", b" ", b"\n", b"\0", b"e300", b"nan", b"999999", b"\xff", b"#", b"ODOM "]
numbers = st.floats(-1e3, 1e3).map(lambda value: round(value, 5))
poses = st.tuples(numbers, numbers, st.floats(-3.1, 3.1).map(lambda value: round(value, 5)))


def read(folder: Path, text: str | bytes) -> tuple[list[DriveMessage], Balance]:
    path = folder / "drive.clf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    balance = Balance()
    return list(CarmenLog(path, balance).messages()), balance


def only(messages: list[DriveMessage], topic: str) -> list[Any]:
    return [one.message for one in messages if one.topic == topic]


def places(message: TFMessage) -> dict[str, list[float]]:
    return {
        one.child_frame_id: [
            one.transform.translation.x,
            one.transform.translation.y,
            one.transform.rotation.yaw,
        ]
        for one in message.transforms
    }


@pytest.mark.parametrize("mode", [0, None])
@pytest.mark.parametrize("remissions", [[0.5, 1.5, 2.5, 3.5, 4.5], [], None])
def test_newer_sweeps_have_the_angles_and_remissions_of_their_lines(
    tmp_path: Path, mode: int | None, remissions: list[float] | None
) -> None:
    swept = carmen.sweep(CONFIG, RANGES, remissions, mode=mode)
    text = carmen.robot_laser(1, swept, [0.2, 0.1, 0.5], ORIGIN, [0.3, 0.1], 1000.0, 0.0)
    text += carmen.raw_laser(3, swept, 1000.1, 0.1)
    messages, balance = read(tmp_path, carmen.HEADER + text)
    assert not balance.left_out
    for scan in (*only(messages, ""), *only(messages, "laser/3")):
        assert isinstance(scan, LaserScan)
        assert scan.ranges.tolist() == RANGES
        assert scan.intensities.tolist() == (remissions or [])
        assert [scan.angle_min, scan.angle_increment, scan.angle_max] == [-1.5, 0.75, 1.5]
        assert scan.range_max == 50.0
    assert places(only(messages, "tf_static")[0])["laser"] == pytest.approx([0.2, 0.1, 0.5])


@given(robot=poses, velocity=st.tuples(numbers, numbers), place=st.tuples(numbers, numbers, st.floats(-3, 3)))
def test_place_of_a_laser_is_that_of_its_line_wherever_the_robot_is(
    tmp_path_factory: pytest.TempPathFactory,
    robot: tuple[float, float, float],
    velocity: tuple[float, float],
    place: tuple[float, float, float],
) -> None:
    cos, sin = math.cos(robot[2]), math.sin(robot[2])
    laser = [
        robot[0] + cos * place[0] - sin * place[1],
        robot[1] + sin * place[0] + cos * place[1],
        robot[2] + place[2],
    ]
    swept = carmen.sweep(CONFIG, RANGES, [])
    text = carmen.robot_laser(2, swept, laser, robot, velocity, 1000.0, 0.0)
    messages, balance = read(tmp_path_factory.mktemp("log"), text)
    assert [one.topic for one in messages] == ["tf_static", "laser/rear"] and not balance.left_out
    found = places(only(messages, "tf_static")[0])["laser_rear"]
    assert found[:2] == pytest.approx(place[:2], abs=0.02)  # lines have six digits of an angle
    assert math.remainder(found[2] - place[2], math.tau) == pytest.approx(0, abs=1e-5)


def test_place_that_changes_is_published_again_with_all_others(tmp_path: Path) -> None:
    swept = carmen.sweep(CONFIG, RANGES, [])
    text = ""
    for number, yaw in enumerate([0.0, 0.001, 0.5]):
        text += carmen.robot_laser(1, swept, [0.1, 0.0, yaw], ORIGIN, [0, 0], 1000.0 + number, number)
    text += carmen.robot_laser(2, swept, [-0.1, 0.0, math.pi], ORIGIN, [0, 0], 1003.0, 3.0)
    messages, _ = read(tmp_path, text + carmen.odometry(ORIGIN, [0, 0], 1004.0, 4.0))
    first, second = map(places, only(messages, "tf_static"))
    assert first["laser"] == pytest.approx([0.1, 0, 0]) and second["laser"] == pytest.approx([0.1, 0, 0.5])
    assert first["laser_rear"] == second["laser_rear"]
    assert first["laser_rear"][0] == pytest.approx(-0.1)


def test_older_sweeps_of_the_rear_laser_look_backwards(tmp_path: Path) -> None:
    robot = [4.0, 2.0, 1.0]
    text = carmen.old_laser("FLASER", [1.0] * 180, robot, robot, 1000.0, 0.0)
    text += carmen.old_laser("RLASER", [2.0] * 361, [3.5, 2.0, 1.0 + math.pi], robot, 1000.1, 0.1)
    for name in ("LASER3", "LASER4", "LASER"):
        text += carmen.old_raw_laser(name, [3.0] * 401, 1000.2, 0.2)
    messages, balance = read(tmp_path, text)
    assert not balance.left_out
    rear = only(messages, "laser/rear")[0]
    assert len(rear.ranges) == 361 and rear.angle_increment == pytest.approx(math.radians(0.5))
    assert [one.topic for one in messages][-4:] == ["laser/rear", "laser/3", "laser/4", "laser/raw_1"]
    assert math.degrees(only(messages, "laser/3")[0].angle_min) == pytest.approx(-50)
    found = places(only(messages, "tf_static")[0])
    assert found["laser"] == pytest.approx([0, 0, 0])
    assert abs(found["laser_rear"][2]) == pytest.approx(math.pi)


def test_parameters_place_older_lasers(tmp_path: Path) -> None:
    text = "".join(
        carmen.parameter(f"robot_{name}", value)
        for name, value in {
            "frontlaser_offset": 0.2,
            "frontlaser_side_offset": 0.05,
            "rearlaser_offset": -0.3,
            "rearlaser_angular_offset": 3.0,
        }.items()
    )
    corrected, robot = [105.0, 20.0, 1.0], [4.0, 2.0, 1.0]
    text += carmen.old_laser("FLASER", [1.0] * 180, corrected, robot, 1000.0, 0.0)
    text += carmen.old_laser("RLASER", [1.0] * 180, corrected, robot, 1000.0, 0.0)
    messages, _ = read(tmp_path, text)
    found = places(only(messages, "tf_static")[0])
    assert found["laser"] == pytest.approx([0.2, 0.05, 0])
    assert found["laser_rear"] == pytest.approx([-0.3, 0, 3.0])


def test_corrected_poses_of_the_robot_are_no_place_of_its_laser(tmp_path: Path) -> None:
    text = carmen.old_laser("FLASER", [1.0] * 180, [105.0, 20.0, 1.0], [4.0, 2.0, 1.0], 1000.0, 0.0)
    messages, _ = read(tmp_path, text)
    assert places(only(messages, "tf_static")[0])["laser"] == [0, 0, 0]
    assert only(messages, "odom")[0].pose.pose.position.x == 4.0


def test_log_without_odometry_gets_it_from_the_front_laser(tmp_path: Path) -> None:
    swept = carmen.sweep(CONFIG, RANGES, [])
    text = carmen.robot_laser(1, swept, [1.0, 2.0, 0.5], [1.0, 2.0, 0.5], [0.3, -0.1], 1000.0, 0.0)
    messages, _ = read(tmp_path, text)
    (odometry,) = only(messages, "odom")
    assert isinstance(odometry, Odometry)
    assert (odometry.pose.pose.position.x, odometry.pose.pose.position.y) == (1.0, 2.0)
    assert (odometry.twist.twist.linear.x, odometry.twist.twist.angular.z) == (0.3, -0.1)
    with_odometry = text + carmen.odometry([7, 8, 0], [0, 0], 1001.0, 1.0)
    assert len(only(read(tmp_path, with_odometry)[0], "odom")) == 1


def test_raw_sweeps_stand_in_for_the_front_laser_unless_it_is_in_the_log(tmp_path: Path) -> None:
    swept = carmen.sweep(CONFIG, RANGES, [])
    raw = carmen.raw_laser(1, swept, 1000.0, 0.0)
    assert [one.topic for one in read(tmp_path, raw)[0]] == ["tf_static", ""]
    both = raw + carmen.robot_laser(1, swept, ORIGIN, ORIGIN, [0, 0], 1000.0, 0.0)
    assert [one.topic for one in read(tmp_path, both)[0]] == ["tf_static", "laser/raw_1", "odom", ""]


def test_positions_and_inertial_data_are_read(tmp_path: Path) -> None:
    text = carmen.gga(1, "4759.500000 N", "00751.000000 E", 4, 278.5, 48.1, 1000.0, 0.0)
    text += carmen.gga(2, "3345.000000 S", "15112.000000 W", 0, 0.0, 0.0, 1000.1, 0.1)
    text += carmen.imu([0.1, 0.2, 9.8], [0.5, -0.5, 0.5, -0.5], [1, 2, 3], [0.01, 0.02, 0.03], 1000.2, 0.2)
    text += carmen.true_pose("TRUEPOS", [1.0, 2.0, math.pi / 2], ORIGIN, 1000.3, 0.3)
    text += carmen.true_pose("GLOBALPOS", [1.5, 2.5, 0.0], ORIGIN, 1000.4, 0.4)
    messages, balance = read(tmp_path, text)
    assert not balance.left_out
    _, fix, none, imu, true, estimate = [one.message for one in messages]
    assert isinstance(fix, NavSatFix) and isinstance(none, NavSatFix) and isinstance(imu, Imu)
    assert (fix.latitude, fix.longitude) == pytest.approx((47.991666667, 7.85))
    assert fix.altitude == pytest.approx(326.6)
    assert fix.status.status == NavSatStatus.STATUS_GBAS_FIX
    assert (none.latitude, none.longitude) == pytest.approx((-33.75, -151.2))
    assert none.status.status == NavSatStatus.STATUS_NO_FIX
    assert (imu.orientation.w, imu.orientation.x, imu.orientation.z) == (0.5, -0.5, -0.5)
    assert (imu.linear_acceleration.z, imu.angular_velocity.y) == (9.8, 0.02)
    assert isinstance(true, PoseStamped) and isinstance(estimate, PoseStamped)
    assert true.pose.orientation.yaw == pytest.approx(math.pi / 2) and estimate.pose.position.y == 2.5
    topics = [one.topic for one in messages]
    assert topics == ["tf_static", "gnss", "gnss/2", "imu", "truepos", "globalpos"]


def test_what_has_no_message_is_counted_by_kind(tmp_path: Path) -> None:
    text = carmen.HEADER + carmen.odometry(ORIGIN, [0, 0], 1000.0, 0.0) + carmen.parameter("base_model", "x")
    text += carmen.sync("start") + carmen.line("SONAR", "0.5 1 2.50 0.1 0.0 0.0", 1000.1, 0.1) * 2
    text += "$GPGGA,120000,4759.5,N\n" + "ODOM 1 2\nODOM 3\n" + carmen.odometry(ORIGIN, [1e9, 0], 1000.2, 0.2)
    messages, balance = read(tmp_path, text)
    assert len(messages) == 2
    assert balance.left_out == {
        "SYNC lines": 1,
        "SONAR lines": 2,
        "lines that begin with no record's name": 1,
        "broken ODOM lines; the first is line 12: ODOM should have 9 fields after its name, this has 2": 2,
        next(reason for reason in balance.left_out if reason.startswith("Odometry whose twist")): 1,
    }


@pytest.mark.parametrize(
    "line",
    [
        "NMEAGGA 1 1 4760.0 N 751.0 E 1 8 1 1 0 1 0 0 1000 h 1",
        "NMEAGGA 1 1 4759.0 X 751.0 E 1 8 1 1 0 1 0 0 1000 h 1",
        "NMEAGGA 1 1 4759.0 N 18100.0 E 1 8 1 1 0 1 0 0 1000 h 1",
        "ROBOTLASER1 0 -1.5 3 1 50 0.01 0 3 1 2 3 2 5 5 0 0 0 0 0 0 0 0 0 0 0 1000 h 1",
        "ROBOTLASER1 0 -1.5 3 1 50 0.01 0 3 1 2 3",
        "RAWLASER1 0 -1.5 3 1 50 0.01 0 0 0 1000 h 1",
        "RAWLASER1 0 -1.5 3 1 50 0.01 0 3 1 -2 3 0 1000 h 1",
        "RAWLASER1",
        "LASER3 1 2.5 1000 h 1",
        "RAWLASER1 0 -1.5 3 1 50 0.01 0 2 1 1e300 0 1000 h 1",
        "ODOM 0 0 0 0 0 0 -5 h 1",
        "ODOM 0 0 0 0 0 0 1e300 h 1",
        "ODOM 0 0 0 0 0 0 1000 h 1e300",
        "PARAM robot_rearlaser_side_offset wide h 0",
        "PARAM",
    ],
)
def test_broken_line_is_left_out_and_counted(tmp_path: Path, line: str) -> None:
    messages, balance = read(tmp_path, carmen.odometry(ORIGIN, [0, 0], 1000.0, 0.0) + line + "\n")
    ((reason, count),) = balance.left_out.items()
    assert len(messages) == 2 and count == 1
    assert reason.startswith(f"broken {line.split(maxsplit=1)[0]} lines; the first is line 2: ")


@pytest.mark.slow
@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress, lzma.compress])
def test_compressed_log_is_read_and_a_cut_one_as_far_as_it_goes(
    tmp_path: Path, compress: Callable[[bytes], bytes]
) -> None:
    generator = np.random.default_rng(1)
    poses = generator.uniform(-9, 9, (20_000, 3))
    text = "".join(carmen.odometry(pose, [0, 0], 1000.0 + at, at) for at, pose in enumerate(poses))
    packed = compress(text.encode())
    assert len(only(read(tmp_path, packed)[0], "odom")) == 20_000
    messages, balance = read(tmp_path, packed[: len(packed) * 9 // 10])
    assert 1_000 < len(only(messages, "odom")) < 20_000
    assert "end of the file, whose compression is damaged" in balance.left_out


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"# CARMEN Logfile\n",
        b"Dear robot,\nhow are you?\n",
        b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9,
    ],
)
@pytest.mark.parametrize("compress", [bytes, bz2.compress, gzip.compress])
def test_what_is_no_carmen_log_is_refused(
    tmp_path: Path, content: bytes, compress: Callable[[bytes], bytes]
) -> None:
    with pytest.raises(NotALog, match=r"drive\.clf is no CARMEN log"):
        read(tmp_path, compress(content))
    with pytest.raises(NotALog):
        describe_carmen(tmp_path / "drive.clf")


def test_description_says_what_an_import_would_leave_out(tmp_path: Path) -> None:
    read(tmp_path, carmen.HEADER + carmen.odometry(ORIGIN, [0, 0], 1000.0, 2.0) + carmen.sync("x"))
    said = describe_carmen(tmp_path / "drive.clf")
    assert said["lines"] == "1 ODOM, 1 SYNC" and said["import leaves out"] == "1 SYNC lines"
    assert said["from"].startswith("1970-01-01T00:16:40")
    with pytest.raises(LogUnreadable, match="No such file"):
        describe_carmen(tmp_path / "none.clf")


@pytest.mark.skipif(not FOREIGN.exists(), reason=f"the log is not at {FOREIGN}")
def test_foreign_log_has_all_its_sweeps(tmp_path: Path) -> None:
    messages, balance = read(tmp_path, FOREIGN.read_bytes())
    scans = only(messages, "")
    assert len(scans) == 20 and not balance.left_out
    for scan in scans:
        assert scan.ranges.tolist() == [2.5] * 181
        assert [scan.angle_min, scan.angle_increment, scan.range_max] == pytest.approx(
            [-1.570796, 0.017453, 81.9]
        )
    assert [places(one)["laser"][0] for one in only(messages, "tf_static")] == [pytest.approx(0.1)]


@given(
    place=st.integers(0, 2000), cut=st.integers(0, 40), piece=st.sampled_from(PIECES) | st.binary(max_size=20)
)
def test_damage_anywhere_leaves_out_lines_and_breaks_nothing(
    tmp_path_factory: pytest.TempPathFactory, place: int, cut: int, piece: bytes
) -> None:
    swept = carmen.sweep(CONFIG, RANGES, [1, 2, 3, 4, 5])
    lines = [
        carmen.parameter("robot_frontlaser_offset", 0.2),
        carmen.odometry(ORIGIN, [0, 0], 1000.0, 0.0),
        carmen.robot_laser(1, swept, [0.1, 0, 0], ORIGIN, [0, 0], 1000.0, 0.1),
        carmen.raw_laser(2, swept, 1000.0, 0.2),
        carmen.old_laser("RLASER", [1.0] * 5, ORIGIN, ORIGIN, 1000.0, 0.3),
        carmen.gga(1, "4759.5 N", "00751.0 E", 4, 278.5, 48.1, 1000.0, 0.4),
        carmen.imu([1, 2, 3], [1, 0, 0, 0], [1, 2, 3], [1, 2, 3], 1000.0, 0.5),
        carmen.odometry(ORIGIN, [0, 0], 1000.0, 0.6),
    ]
    text = "".join(lines).encode()
    at = place % len(text)
    damaged = text[:at] + piece + text[at + cut :]
    messages, balance = read(tmp_path_factory.mktemp("log"), damaged)
    for one in messages:
        assert one.message.decode(one.message.encode()) == one.message
    assert len(messages) + balance.read >= 5
