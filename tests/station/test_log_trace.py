"""The trace of a log is that of its run, up to the moment that is shown."""

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from threading import Event

import pytest

from robbie_mp.messages import Log, ModuleState
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.station.past import log_trace
from robbie_mp.station.past.log_trace import LogTrace
from tests._support.robot import LIMIT_S, wait_until
from tests.logs.recording._support.logs import START_NS, LogFile

SECOND = 1_000_000_000
START_S = START_NS / 1e9


def write_log(path: Path) -> None:
    with LogFile(path) as log:
        log.add(ModuleState(module="laser", state="RUNNING"), time_ns=START_NS)
        log.add(Log(level=Log.WARN, name="nav", msg="a wall"), time_ns=START_NS + 2 * SECOND)
        log.add(ModuleState(module="laser", state="FAILED", reason="it burns"), time_ns=START_NS + 4 * SECOND)


def trace_of(path: Path) -> LogTrace:
    trace = LogTrace()
    trace.read(str(path))
    wait_until(lambda: bool(trace.entries or trace.error))
    return trace


def test_entries_of_the_runs_trace_in_the_logs_time_come_until_the_moment_shown(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "log").mkdir()
    write_log(tmp_path / "logs" / "way.mcap")
    for module, times in {"laser": (-1, 3, 5), "base": (1,)}.items():
        lines = [
            Entry(at + 9, START_S + at, Kind.INFO, module, 1, "log", f"at {at}").to_line() for at in times
        ]
        (tmp_path / "log" / f"{module}.jsonl").write_bytes(b"".join(lines))
    trace = trace_of(tmp_path / "logs" / "way.mcap")
    assert [(one.module, one.text) for one in trace.entries] == [("base", "at 1"), ("laser", "at 3")]
    assert [one.text for one in trace.until(START_S + 2, 10)] == ["at 1"]
    assert [one.text for one in trace.until(START_S + 4, 1)] == ["at 3"]


def test_log_without_a_trace_has_what_its_messages_say(tmp_path: Path) -> None:
    write_log(tmp_path / "way.mcap")
    said = [(one.kind, one.module, one.text) for one in trace_of(tmp_path / "way.mcap").entries]
    assert said == [
        (Kind.INFO, "laser", "RUNNING"),
        (Kind.WARNING, "nav", "a wall"),
        (Kind.ERROR, "laser", "FAILED: it burns"),
    ]


def test_unreadable_log_has_no_trace_and_a_reason(tmp_path: Path) -> None:
    assert "cannot be read" in trace_of(tmp_path / "missing.mcap").error


def test_reading_of_a_long_log_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_trace, "MAX_READ", 250)
    monkeypatch.setattr(log_trace, "entries_of_messages", lambda _log: endless(Event()))
    write_log(tmp_path / "way.mcap")
    trace = trace_of(tmp_path / "way.mcap")
    assert len(trace.entries) == 250
    assert trace.error == "only the first 250 entries of the log's trace are read"


def test_reading_ends_when_another_log_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = Event(), Event()
    reads = [endless(ended, begun), iter([line(1)])]
    monkeypatch.setattr(log_trace, "MAX_READ", 10**12)
    monkeypatch.setattr(log_trace, "entries_of_messages", lambda _log: reads.pop(0))
    for name in ("way.mcap", "other.mcap"):
        write_log(tmp_path / name)
    trace = LogTrace()
    trace.read(str(tmp_path / "way.mcap"))
    assert begun.wait(LIMIT_S)
    trace.read(str(tmp_path / "other.mcap"))
    wait_until(lambda: bool(trace.entries))
    wait_until(ended.is_set)
    assert len(trace.entries) == 1


def line(number: int) -> Entry:
    return Entry(number, START_S, Kind.INFO, "laser", 0, "log", "spins")


def endless(ended: Event, begun: Event | None = None) -> Iterator[Entry]:
    if begun is not None:
        begun.set()
    try:
        yield from map(line, count(1))
    finally:
        ended.set()
