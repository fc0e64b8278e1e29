"""The modules in docs/coming-from-ros2.md work as described, and every command has an answer."""

import logging
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.cli import main
from robbie_mp.logs.recording.decoding import LogDecoder
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import DriveCommand, LaserScan, String, Twist, TwistStamped, Vector3
from tests.docs._support.pages import ROOT, block
from tests.logs.recording.test_imports import write_bag

PAGE = "docs/coming-from-ros2.md"

ROWS = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in (ROOT / "docs/commands-compared.md").read_text().splitlines()
    if line.startswith("| `") and "| here |" not in line
]


def names(mark: str) -> dict[str, Any]:
    """Run a block of the page; return what it defines."""
    defined: dict[str, Any] = {"__name__": __name__}
    exec(block(PAGE, mark), defined)
    return defined


def test_module_stops_before_an_obstacle() -> None:
    with ModuleHarness(names("stopper")["Stopper"]) as harness:
        harness.send(LaserScan(range_max=9.0, ranges=np.array([3.0], np.float32)), topic="scan")
        assert not harness.take(TwistStamped)
        harness.send(LaserScan(range_max=9.0, ranges=np.array([0.3], np.float32)), topic="scan")
        assert len(harness.take(TwistStamped)) == 1


def test_listener_logs_what_the_talker_says(caplog: pytest.LogCaptureFixture) -> None:
    pair = names("talker and listener")
    with ModuleHarness(pair["Talker"]) as talker, ModuleHarness(pair["Listener"]) as listener:
        talker.advance(1.5)
        said = talker.take(String, topic="chatter")
        assert [one.data for one in said] == ["Hello World: 1", "Hello World: 2"]
        with caplog.at_level(logging.INFO):
            listener.send(said[1], topic="chatter")
    assert "I heard: Hello World: 2" in caplog.text


def test_drive_command_expires_as_set() -> None:
    with ModuleHarness(names("driving")["TwistToDrive"], {"valid_for_s": 0.25}) as harness:
        harness.send(Twist(linear=Vector3(x=0.5), angular=Vector3(z=-1.0)), topic="cmd_vel")
        (command,) = harness.take(DriveCommand, topic="manual")
    assert (command.linear_m_per_s, command.angular_rad_per_s) == (0.5, -1.0)
    assert command.valid_for.seconds == 0.25


def test_profile_fits_the_modules_of_the_page(tmp_path: Path) -> None:
    for folder in ("modules", "profiles"):
        (tmp_path / folder).mkdir()
    (tmp_path / "modules/__init__.py").touch()
    code = block(PAGE, "talker and listener") + block(PAGE, "filter")
    (tmp_path / "modules/scan_tools.py").write_text(code)
    (tmp_path / "profiles/scan_tools.yaml").write_text(block(PAGE, "file profiles/scan_tools.yaml"))
    program = "from robbie_mp.cli.start import main; raise SystemExit(main())"
    command = [sys.executable, "-c", program, "profile", "show", "scan_tools"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "range_max_m: 4.0" in done.stdout


def test_bag_becomes_a_log_that_the_filter_reads_and_a_bag_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path, "SQLITE3").rename("drive")
    for line in block(PAGE, "bags").splitlines():
        assert main(shlex.split(line, comments=True)[1:]) == 0
    with AnyReader([Path("drive")]) as before, AnyReader([Path("drive_again")]) as after:
        was = [(one.topic, one.msgtype, time, data) for one, time, data in before.messages()]
        assert was == [(one.topic, one.msgtype, time, data) for one, time, data in after.messages()]
    with (
        open_log(Path("drive_again")) as log,
        ModuleHarness(names("filter")["ScanFilter"], {"range_max_m": 2.0}) as harness,
    ):
        (scan,) = [
            LogDecoder().decode(one) for one in log.messages() if one.channel.type_name == LaserScan.type_name
        ]
        assert isinstance(scan, LaserScan) and scan.ranges.tolist() == [1.0, 2.5]
        harness.send(scan, topic="scan")
        (filtered,) = harness.take(LaserScan, topic="scan_filtered")
        assert filtered.ranges.tolist() == [1.0, np.inf]
        assert filtered.header == scan.header
    with pytest.raises(SettingError):
        ModuleHarness(names("filter")["ScanFilter"], {"range_max_m": 0.0})


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_row_answers(row: list[str]) -> None:
    theirs, answer, ours = row
    assert theirs
    assert answer in ("yes", "no", "another way", "not needed")
    assert ours or theirs == "`control …` (ros2_control)"


def test_rows_are_those_of_both_programs() -> None:
    assert len(ROWS) > 60
