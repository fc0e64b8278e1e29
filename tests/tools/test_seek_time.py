"""The measurement of seeks checks that they reach the right place."""

from pathlib import Path

from tools.trials.recordings.seek import measure, write_scans


def test_seeks_in_a_small_log_reach_the_right_messages(tmp_path: Path) -> None:
    write_scans(tmp_path / "log.mcap", 300, 10.0)
    report = measure(tmp_path / "log.mcap", 20)
    assert [violation for violation in report["violations"] if "led to" in violation] == []
