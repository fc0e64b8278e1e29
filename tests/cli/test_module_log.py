"""What `robbie top` shows of a module's log."""

from pathlib import Path

import pytest

from robbie_mp.cli.module_log import read_module_log
from robbie_mp.trace.entry import Entry
from robbie_mp.trace.kinds import Kind

TRACEBACK = "Traceback (most recent call last):\n  File …\nZeroDivisionError: division by zero"


def entry(number: int, text: str, stream: str = "stdout", incarnation: int = 1, **more: str) -> Entry:
    return Entry(number, float(number), Kind.INFO, "laser", incarnation, stream, text, **more)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    (tmp_path / "log").mkdir()
    return tmp_path


def write(folder: Path, *entries: Entry) -> None:
    (folder / "log" / "laser.jsonl").write_bytes(b"".join(one.to_line() for one in entries))


def test_last_lines_are_shown_with_their_times(written: Path) -> None:
    write(written, *(entry(number, f"line {number}") for number in range(30)))
    log = read_module_log(written, "laser", 2)
    assert [line.split(" ", 1)[1] for line in log.lines] == ["line 28", "line 29"]
    assert log.crash == ()


def test_exception_that_ended_a_module_is_its_last_crash(written: Path) -> None:
    write(
        written,
        entry(1, "caught", "log", level="ERROR", traceback=TRACEBACK.replace("Zero", "Other")),
        entry(2, "ZeroDivisionError: …", "log", level="CRITICAL", traceback=TRACEBACK),
        entry(3, "works again", incarnation=2),
    )
    crash = read_module_log(written, "laser", 2).crash
    assert crash[0].startswith("start 1, ")
    assert crash[-1] == "ZeroDivisionError: division by zero"
    assert "OtherDivisionError" not in "\n".join(crash)


def test_stack_dump_of_a_crash_in_c_is_its_last_crash(written: Path) -> None:
    write(
        written,
        entry(1, "Fatal Python error: Segmentation fault", "stderr"),
        entry(2, "from a thread"),
        entry(3, "Current thread 0x1:", "stderr"),
        entry(4, "restarted", "stderr", incarnation=2),
    )
    crash = read_module_log(written, "laser", 5).crash
    assert crash[1:] == ("Fatal Python error: Segmentation fault", "Current thread 0x1:")


def test_module_without_any_log_has_neither(tmp_path: Path) -> None:
    assert read_module_log(tmp_path, "laser", 5).lines == ()
