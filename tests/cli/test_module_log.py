"""What `robbie top` shows of a module's log."""

from pathlib import Path

import pytest

from robbie_mp.cli.top_program.details import read_module_log
from robbie_mp.run.trace.crash import CrashFolder, CrashReport, LastWords, report_name, report_place
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind

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


def test_last_crash_is_the_newest_report(written: Path) -> None:
    reports = CrashFolder(written / "log", keep=5)
    for incarnation, reason in ((1, "exit code 1"), (2, "killed by SIGSEGV")):
        words = LastWords(activity="tick")
        said = ["the stack"]
        crash = CrashReport(
            "laser", incarnation, 7, 1e9 + incarnation, 1.0, reason, None, 11, 0.1, [], words, said, []
        )
        reports.keep(crash.module, report_name(crash), crash.to_json())
        place = report_place(crash)
        text = f"crashed in tick: {reason}"
        write(written, entry(incarnation, text, traceback="\n".join(crash.lines()), crash_report=place))
    log = read_module_log(written, "laser", 2)
    assert [line.split(" ", 1)[1] for line in log.lines] == ["crashed in tick: killed by SIGSEGV"]
    assert log.crash[0].startswith("start 2, ")
    assert log.crash[0].endswith("killed by SIGSEGV")
    assert log.crash[-1].strip() == "the stack"


def test_module_without_a_log_has_neither_lines_nor_crash(tmp_path: Path) -> None:
    assert read_module_log(tmp_path, "laser", 5).lines == ()
