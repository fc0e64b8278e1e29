"""Mapping of a log through emulated serial devices, compared with the direct playback."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.robot.test_stock_robot import DATA, needs_intel
from tools.trials.__main__ import main
from tools.trials.recordings.intel_emulated import beginning, compare, with_stamps_of_log


def test_poses_get_the_stamps_of_the_log_that_were_played_at_their_time() -> None:
    trajectory = np.array([[10.0, 0.0, 0.0, 3.1], [11.0, 1.0, 2.0, -3.1], [12.0, 1.0, 2.0, -3.1]])
    played = np.array([[9.0, 1.0], [10.5, 2.0], [11.5, 1.9], [13.0, 3.0]])
    found = with_stamps_of_log(trajectory, played)
    assert found[:, 0].tolist() == [2.0, 1.9]
    assert found[:, 1:3].tolist() == [[0.5, 1.0], [1.0, 2.0]]
    assert found[:, 3] == pytest.approx([math.pi, 2 * math.pi - 3.1])


def test_beginning_of_a_log_keeps_parameters_and_the_records_of_its_time(tmp_path: Path) -> None:
    lines = [
        "# a remark",
        "PARAM offset 0.0 host 0",
        "ODOM 0 0 0 0 0 0 9.0 host 1.0",
        "ODOM 1 0 0 0 0 0 9.9 host 1.9",
    ]
    (tmp_path / "log.clf").write_text("\n".join(lines) + "\n")
    part = beginning(tmp_path / "log.clf", tmp_path / "part.clf", 1.5)
    assert part.read_text().splitlines() == lines[:3]


def test_missing_log_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["intel_emulated", "--data", str(tmp_path)])
    assert end.value.code == 2
    assert "has no intel.clf" in capsys.readouterr().err


@needs_intel
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_beginning_of_the_intel_log_is_mapped_through_serial_lines(tmp_path: Path) -> None:
    report = compare(tmp_path / "runs", DATA, rate=6.0, seconds=80.0)
    played, emulated = report["played"], report["emulated"]
    assert isinstance(played, dict)
    assert isinstance(emulated, dict)
    assert played["sent"] == played["scans"] > 10
    assert emulated["relations_used"] > 10
    assert emulated["translation_mean_m"] < 0.25
