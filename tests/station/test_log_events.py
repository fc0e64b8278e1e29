"""Crashes, marks and victims are found in a log, each once."""

from pathlib import Path

from robbie_mp.messages import DriveCommand, Mark, ModuleState, VictimFound
from robbie_mp.station.log_events import MOST_EVENTS, LogEvents
from tests.recording._support.logs import START_NS, LogFile
from tests.run._support.robot import wait_until

SECOND = 1_000_000_000


def events_in(path: Path) -> LogEvents:
    events = LogEvents()
    events.read(str(path))
    wait_until(lambda: bool(events.found or events.error))
    return events


def test_what_happened_is_found_at_its_time_and_what_did_not_change_is_left_out(tmp_path: Path) -> None:
    victim = {"id": 7, "name": "tag 7"}
    happened = [
        ModuleState(module="laser", state="RUNNING"),
        VictimFound(**victim, state=VictimFound.SUSPECTED),
        VictimFound(**victim, state=VictimFound.SUSPECTED),
        ModuleState(module="laser", state="BACKOFF", reason="killed by SIGKILL"),
        DriveCommand(),
        VictimFound(**victim, state=VictimFound.CONFIRMED),
        Mark(text="here"),
    ]
    with LogFile(tmp_path / "log.mcap") as log:
        for number, message in enumerate(happened):
            log.add(message, time_ns=START_NS + number * SECOND)
    found = [
        ((event.time_ns - START_NS) // SECOND, event.kind, event.text)
        for event in events_in(tmp_path / "log.mcap").found
    ]
    assert found == [
        (1, "victim", "tag 7 suspected"),
        (3, "crash", "laser is BACKOFF: killed by SIGKILL"),
        (5, "victim", "tag 7 confirmed"),
        (6, "mark", "here"),
    ]


def test_events_are_bounded(tmp_path: Path) -> None:
    with LogFile(tmp_path / "log.mcap") as log:
        for _ in range(MOST_EVENTS + 1):
            log.add(Mark())
    assert len(events_in(tmp_path / "log.mcap").found) == MOST_EVENTS


def test_log_that_cannot_be_read_has_no_events_and_says_why(tmp_path: Path) -> None:
    assert "cannot be read" in events_in(tmp_path / "missing.mcap").error
