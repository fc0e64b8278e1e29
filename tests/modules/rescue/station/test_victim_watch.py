"""Victims in a log are events, one for each change of their state."""

from pathlib import Path

from modules.rescue.messages import VictimFound
from modules.rescue.station.mission_panel import MissionPanel
from robbie_mp.messages import Mark
from robbie_mp.station.log_events import LogEvents
from tests._support.robot import wait_until
from tests.recording._support.logs import LogFile


def test_each_change_of_a_victims_state_is_an_event(tmp_path: Path) -> None:
    states = [VictimFound.SUSPECTED, VictimFound.SUSPECTED, VictimFound.CONFIRMED]
    with LogFile(tmp_path / "log.mcap") as log:
        for state in states:
            log.add(VictimFound(id=7, name="tag 7", state=state))
        log.add(VictimFound(id=8, state=VictimFound.SUSPECTED))
        log.add(Mark(text="here"))
    events = LogEvents(MissionPanel.log_events)
    events.read(str(tmp_path / "log.mcap"))
    wait_until(lambda: bool(events.found or events.error))
    found = [(event.kind.name, event.text) for event in events.found]
    assert found == [
        ("victim", "tag 7 suspected"),
        ("victim", "tag 7 confirmed"),
        ("victim", "8 suspected"),
        ("mark", "here"),
    ]
