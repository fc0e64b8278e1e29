"""The comparison of runs in lockstep."""

from dataclasses import replace
from pathlib import Path

import pytest

from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import LaserScan, Odometry
from tests.recording._support.logs import LogFile
from tools.trials.recordings.intel_lockstep import Outcome, violations, without_lost, write_log

CALM = Outcome(10.0, b"1 2 3 4\n", odometry=12, scans=3, dropped=0, restarts=0, restored=None)
KILLED = replace(CALM, trajectory=b"1 2 3\n", odometry=9, scans=2, restarts=1, restored=(5, 1))
LESS = replace(KILLED, restarts=0, restored=None)


def test_messages_lost_by_a_killed_mapping_are_removed(tmp_path: Path) -> None:
    with LogFile(tmp_path / "log.mcap") as log:
        for number in range(1, 13):
            log.add(Odometry(child_frame_id=str(number)), "odom")
            if number % 4 == 0:
                log.add(LaserScan(), "")
    with open_log(tmp_path / "log.mcap") as whole:
        kept = without_lost(whole.messages(), KILLED, CALM)
        write_log(tmp_path / "less.mcap", tmp_path / "log.mcap", kept)
    with open_log(tmp_path / "less.mcap") as less:
        messages = list(less.messages())
    frames = [
        Odometry.decode(message.data).child_frame_id if message.channel.topic else "scan"
        for message in messages
    ]
    assert frames == ["1", "2", "3", "4", "scan", "5", "9", "10", "11", "12", "scan"]


def test_equal_runs_are_not_a_violation() -> None:
    assert violations([CALM, CALM], KILLED, LESS) == []


@pytest.mark.parametrize(
    ("same", "killed", "less"),
    [
        ([CALM, replace(CALM, trajectory=b"1 2 3 5\n")], KILLED, LESS),
        ([CALM, replace(CALM, dropped=1)], KILLED, LESS),
        ([CALM], replace(KILLED, restarts=0), LESS),
        ([CALM], replace(KILLED, restored=None), LESS),
        ([CALM], KILLED, replace(LESS, trajectory=b"1 2\n")),
    ],
)
def test_any_difference_is_a_violation(same: list[Outcome], killed: Outcome, less: Outcome) -> None:
    assert violations(same, killed, less)
