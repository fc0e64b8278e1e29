"""The times of handlers are kept, and used again in another run."""

import logging
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.module.handler_times import HandlerTimes, HandlerTimesMissing, recorded_times

LOG = logging.getLogger("times")


def charged(file: Path, measured: list[int], recorded: list[int] | None = None) -> list[int]:
    times = HandlerTimes(file, recorded, LOG)
    charge: Callable[[int], int] = times.charge
    found = [charge(one) for one in measured]
    times.close()
    return found


def test_measured_times_are_charged_and_kept(tmp_path: Path) -> None:
    assert charged(tmp_path / "times" / "camera.txt", [5, 7]) == [5, 7]
    assert recorded_times(tmp_path / "times", "camera") == [5, 7]


def test_recorded_times_are_charged_by_successive_processes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "camera.txt"
    assert charged(file, [1, 1], [50, 70, 90]) == [50, 70]
    assert charged(file, [1], [50, 70, 90]) == [90]
    assert not caplog.records
    assert charged(file, [2, 3], [50, 70, 90]) == [2, 3]
    assert [record.getMessage() for record in caplog.records] == [
        "the recorded handler times end after 3 messages; measured times follow, "
        "so this run does not repeat the recorded one"
    ]
    assert recorded_times(tmp_path, "camera") == [50, 70, 90, 2, 3]


def test_line_that_a_killed_process_did_not_finish_does_not_count(tmp_path: Path) -> None:
    (tmp_path / "camera.txt").write_text("12\n3")
    assert recorded_times(tmp_path, "camera") == [12]


@pytest.mark.parametrize("text", [None, "fast\n"])
def test_folder_without_times_is_reported(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "camera.txt").write_text(text)
    with pytest.raises(HandlerTimesMissing, match=r"camera\.txt has no handler times .* or be `measured`"):
        recorded_times(tmp_path, "camera")
