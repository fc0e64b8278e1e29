"""Crashes, marks and the events of panels are found in a log, each once."""

from collections.abc import Callable
from pathlib import Path

from robbie_mp.messages import DriveCommand, Mark, ModuleState, String
from robbie_mp.station.page.log_events import MAX_EVENTS, EventKind, LogEvents
from tests._support.robot import wait_until
from tests.logs.recording._support.logs import START_NS, LogFile

SECOND = 1_000_000_000


def changes() -> Callable[[String], str | None]:
    """Return a reader that reports each text that differs from the previous one."""
    said = [""]

    def describe(text: String) -> str | None:
        if text.data == said[0]:
            return None
        said[0] = text.data
        return f"said {text.data}"

    return describe


SPEECH = EventKind("speech", String, changes, "chat", "blue-3")


def events_in(path: Path) -> LogEvents:
    events = LogEvents([SPEECH])
    events.read(str(path))
    wait_until(lambda: bool(events.found or events.error))
    return events


def test_events_are_found_at_their_times_and_unchanged_states_are_omitted(tmp_path: Path) -> None:
    happened = [
        ModuleState(module="laser", state="RUNNING"),
        String(data="hello"),
        String(data="hello"),
        ModuleState(module="laser", state="BACKOFF", reason="killed by SIGKILL"),
        DriveCommand(),
        String(data="bye"),
        Mark(text="here"),
    ]
    with LogFile(tmp_path / "log.mcap") as log:
        for number, message in enumerate(happened):
            log.add(message, time_ns=START_NS + number * SECOND)
    found = [
        ((event.time_ns - START_NS) // SECOND, event.kind.name, event.text)
        for event in events_in(tmp_path / "log.mcap").found
    ]
    assert found == [
        (1, "speech", "said hello"),
        (3, "crash", "laser is BACKOFF: killed by SIGKILL"),
        (5, "speech", "said bye"),
        (6, "mark", "here"),
    ]


def test_events_are_bounded(tmp_path: Path) -> None:
    with LogFile(tmp_path / "log.mcap") as log:
        for _ in range(MAX_EVENTS + 1):
            log.add(Mark())
    assert len(events_in(tmp_path / "log.mcap").found) == MAX_EVENTS


def test_unreadable_log_has_no_events_and_a_reason(tmp_path: Path) -> None:
    assert "cannot be read" in events_in(tmp_path / "missing.mcap").error
