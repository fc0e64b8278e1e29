"""Every time that people see is UTC and says so, wherever the robot is."""

import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.base.utc import file_stamp, time_from, time_of_day, time_text
from robbie_mp.cli import main
from robbie_mp.cli.log import EntryPrinter
from robbie_mp.run.supervisor.run import default_output_directory
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.station.panels.trace import line_of
from tests._support.places import PROJECT
from tests.logs.recording._support.logs import START_NS, write_log

TIME_S = START_NS / 1e9  # 2023-11-14, 22:13:20 UTC
LOCAL = re.compile(
    r"localtime|\.astimezone\(\)|datetime\.now\(\)|fromtimestamp\([^,()]*\)|toTimeString|toLocale|getHours|"
    r"getMinutes"
)


@pytest.fixture
def tokyo(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The local time is 9 h ahead of UTC."""
    monkeypatch.setenv("TZ", "Asia/Tokyo" if Path("/usr/share/zoneinfo/Asia/Tokyo").exists() else "JST-9")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def test_times_are_utc_in_every_zone(tokyo: None) -> None:
    assert time.localtime(TIME_S).tm_hour == 7, "the zone was not set"
    assert time_text(TIME_S) == "2023-11-14T22:13:20.000Z"
    assert time_of_day(TIME_S + 0.25) == "22:13:20.250Z"
    assert file_stamp(TIME_S) == "20231114T221320Z"
    assert time_from(time_text(TIME_S)).timestamp() == TIME_S
    assert time_text(1e300) == time_text(float("nan")) == "?"


@pytest.mark.parametrize("fraction", [".25", ".250", ".25000000"])
@pytest.mark.parametrize("offset", ["Z", "z", "+00:00"])
def test_times_are_read_with_any_number_of_digits(fraction: str, offset: str) -> None:
    assert time_from(f"2023-11-14T22:13:20{fraction}{offset}").timestamp() == TIME_S + 0.25


def test_commands_pages_and_names_agree(
    tokyo: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "log.mcap", 3)
    assert main(["info", str(log)]) == 0
    assert "2023-11-14T22:13:20.000Z to 2023-11-14T22:13:20.200Z" in capsys.readouterr().out
    entry = Entry(1, TIME_S, Kind.INFO, "laser", 1, "stdout", "ready")
    EntryPrinter(as_json=False).print(entry)
    assert capsys.readouterr().out.startswith("22:13:20.000Z laser#1")
    assert line_of(entry).startswith("22:13:20.000Z laser#1")
    before = file_stamp()
    made = default_output_directory("demo").name.removesuffix(f"-{os.getpid()}")
    assert before <= made <= file_stamp()


def test_no_file_of_the_framework_uses_a_local_time() -> None:
    files = [path for ending in ("*.py", "*.html", "*.js") for path in (PROJECT / "robbie_mp").rglob(ending)]
    assert len(files) > 200
    found = {str(path): LOCAL.findall(path.read_text()) for path in files}
    assert {path: calls for path, calls in found.items() if calls} == {}
