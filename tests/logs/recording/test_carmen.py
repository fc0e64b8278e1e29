"""A CARMEN log is read in recording order, and a broken line is left out and named."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp.logs.recording.carmen import CarmenLog
from robbie_mp.logs.recording.carmen_records import LaserRecord, OdometryRecord, beam_angles
from tests._support.places import PROJECT

INTEL = PROJECT.parent / "shared/data/intel.clf"
GOOD = """\
# comment
PARAM robot_frontlaser_offset 0.15 nohost 0
SYNC start 0 nohost 0
ODOM 1.5 -2.5 0.5 0.3 -0.1 0 976052857.33 nohost 0.25

FLASER 4 1.0 2.0 81.83 0.5 1 2 3 1.5 -2.5 0.5 976052857.36 nohost 0.5
ODOM 1.6 -2.5 0.5 0 0 0 976052857.10 nohost 0.75
"""


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "drive.clf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_records_are_in_recording_order_with_every_field(tmp_path: Path) -> None:
    log = CarmenLog(written(tmp_path, GOOD))
    first, sweep, last = log
    assert first == OdometryRecord(
        x_m=1.5,
        y_m=-2.5,
        theta_rad=0.5,
        linear_m_s=0.3,
        angular_rad_s=-0.1,
        ipc_time_s=976052857.33,
        logger_time_s=0.25,
    )
    assert isinstance(sweep, LaserRecord)
    assert sweep.ranges_m.dtype == np.float32
    assert sweep.ranges_m.tolist() == pytest.approx([1.0, 2.0, 81.83, 0.5])
    assert sweep.robot_pose == (1.5, -2.5, 0.5)
    assert (sweep.ipc_time_s, sweep.logger_time_s) == (976052857.36, 0.5)
    assert last.ipc_time_s < sweep.ipc_time_s
    assert log.parameters == {"robot_frontlaser_offset": "0.15"}
    assert log.balance.left_out == {"SYNC lines": 1}


def test_check_counts_the_records(tmp_path: Path) -> None:
    assert CarmenLog(written(tmp_path, GOOD)).check() == {"odometry": 2, "laser": 1}


@pytest.mark.parametrize(
    ("beams", "degrees_apart"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (90, 2.0), (721, 0.25)]
)
def test_beams_begin_at_minus_90_degrees_with_the_scanners_increment(
    beams: int, degrees_apart: float
) -> None:
    first, increment = beam_angles(beams)
    assert math.degrees(first) == pytest.approx(-90)
    assert math.degrees(increment) == pytest.approx(degrees_apart)


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("ODOM 1 2 3 4 5", "ODOM should have 9 fields after its name, this has 5"),
        ("ODOM 1 2 three 0 0 0 1 host 1", "'three' is not a number"),
        ("ODOM 1 2 nan 0 0 0 1 host 1", "'nan' is not a finite number"),
        ("FLASER", "number of beams"),
        ("FLASER x 1 2", "number of beams as field 1, not 'x'"),
        ("FLASER -3 1 2", "number of beams"),
        ("FLASER 4 1 2 3 1 2 3 1 2 3 5 host 6", "FLASER should have 14 fields after its name, this has 13"),
        ("FLASER 2 1 -2 1 2 3 1 2 3 5 host 6", "negative range, -2.0"),
        ("FLASER 2 1 inf 1 2 3 1 2 3 5 host 6", "'inf' is not a finite number"),
        ("FLASER 999999999999 1", "number of beams"),
        ("PARAM robot_frontlaser_offset far nohost 0", "'far' is not a number"),
        ("ODOM \ufffd 2 3 0 0 0 1 host 1", "is not a number"),
    ],
)
def test_broken_line_is_left_out_and_named(tmp_path: Path, line: str, what: str) -> None:
    log = CarmenLog(written(tmp_path, GOOD + line + "\n" + GOOD))
    assert log.check() == {"odometry": 4, "laser": 2}
    (reason,) = set(log.balance.left_out) - {"SYNC lines"}
    assert reason.startswith(f"broken {line.split(maxsplit=1)[0]} lines; the first is line 8: ")
    assert what in reason


def test_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        CarmenLog(tmp_path / "none.clf").check()


@pytest.mark.skipif(not INTEL.exists(), reason=f"the Intel log is not at {INTEL}")
def test_intel_log_is_read_completely() -> None:
    log = CarmenLog(INTEL)
    assert log.check() == {"odometry": 14541, "laser": 910}
    sweep = next(record for record in log if isinstance(record, LaserRecord))
    assert len(sweep.ranges_m) == 180
    assert log.parameters["robot_frontlaser_offset"] == "0.0"
