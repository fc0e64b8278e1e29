"""What one robot knows of its team: who is stopped, who is stale, and what others can do to its page."""

import json
import math
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import playwright
import pytest

from robbie_mp.bus.transport.endpoint import TooManyDeclarations
from robbie_mp.messages import EmergencyStop, LinkPeer, LinkState, Message, RobotAlarm, RobotSummary
from robbie_mp.module.clock import ManualClock
from robbie_mp.station.fleet import robots
from robbie_mp.station.fleet.robots import LINK_STALE_S, MAX_ROBOTS, OtherRobots
from robbie_mp.station.fleet.stop_all import StopAll
from robbie_mp.station.panels.robots import MAX_ADDRESS, RobotsPanel, stale_text, told
from robbie_mp.station.stop.emergency_stop import EmergencyStopControl
from robbie_mp.station.stop.requests import StopRequests
from robbie_mp.station.watch.latest import Latest

SCRIPT = Path(robots.__file__).parents[1] / "stop" / "emergency_stop.js"
NODE = Path(playwright.__file__).parent / "driver" / "node"


class Station:
    """Source of messages whose clock stands, as beside a paused log."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.real_s = 100.0
        monkeypatch.setattr(time, "monotonic", lambda: self.real_s)
        monkeypatch.setattr(robots, "StopRequests", lambda send: StopRequests(send, lambda: self.real_s))
        self.envelope = SimpleNamespace(published_ns=0)
        self.sent: list[tuple[str, bool]] = []
        self.refuses = ""
        self.holders: dict[tuple[str, str], Latest[Any]] = {}
        self.team = OtherRobots(self, ManualClock(0), self.publish, "red")  # type: ignore[arg-type]

    def newest(self, message_type: type[Message], topic: str = "") -> Latest[Any]:
        if topic.startswith("full/"):
            raise TooManyDeclarations("a test")
        return self.holders.setdefault((message_type.type_name, topic), Latest(lambda: 5.0))

    def publish(self, message: Message, *, topic: str = "") -> bool:
        if topic.startswith(f"{self.refuses}/"):
            raise TooManyDeclarations("a test")
        assert isinstance(message, EmergencyStop)
        self.sent.append((topic, message.engaged))
        return True

    def hears(self, message: Message, topic: str = "") -> None:
        self.envelope.published_ns = round(self.real_s * 1e9)
        self.newest(type(message), topic).put(message)

    def link_says(self, **peers: bool) -> None:
        names = [LinkPeer(robot=name, is_up=is_up, round_trip_s=math.nan) for name, is_up in peers.items()]
        self.hears(LinkState(peers=names))

    def stop_all(self) -> StopAll:
        return StopAll(Mock(fate=lambda _: "confirmed"), lambda: "STOPPED", self.team)


@pytest.fixture
def station(monkeypatch: pytest.MonkeyPatch) -> Station:
    return Station(monkeypatch)


def test_robot_that_falls_silent_is_stale_even_if_the_clock_of_the_run_stands(station: Station) -> None:
    station.link_says(blue=True)
    station.hears(RobotSummary(robot="blue"), "blue/robot_summary")
    blue = station.team.all["blue"]
    assert stale_text(blue) == ""
    station.real_s += 2.5
    assert stale_text(blue) == "what is shown is 2 s old"


def test_robot_of_which_no_link_tells_any_more_is_not_up(station: Station) -> None:
    station.link_says(blue=True)
    station.hears(RobotSummary(robot="blue"), "blue/robot_summary")
    station.link_says(green=True)  # the link was started again, and has not met blue
    station.real_s += LINK_STALE_S + 0.1
    station.hears(RobotSummary(robot="blue"), "blue/robot_summary")
    assert stale_text(station.team.all["blue"]).startswith("no link; ")
    station.team.all["blue"].requests.press("p")
    station.real_s += 4.0
    assert station.team.all["blue"].stop_state == "NOT CONFIRMED for 4 s: no link"


def test_press_is_not_settled_before_the_station_knows_its_team(station: Station) -> None:
    stop = station.stop_all()
    assert [(one["robot"], one["fate"]) for one in stop.states("p")] == [
        ("", "confirmed"),
        ("other robots", ""),
    ]
    station.link_says()
    assert [one["robot"] for one in stop.states("p")] == [""]


def test_robots_that_cannot_be_stopped_from_here_are_told(station: Station) -> None:
    station.link_says(full=True, **{f"r{number}": True for number in range(MAX_ROBOTS + 2)})
    assert len(station.team.all) == MAX_ROBOTS
    (last,) = station.stop_all().states("p")[MAX_ROBOTS + 1 :]
    assert last == {"robot": f"3 more than {MAX_ROBOTS} other robots", "state": "not known", "fate": ""}


def test_robot_to_which_nothing_can_be_sent_keeps_the_stop_from_no_other(station: Station) -> None:
    station.link_says(blue=True, green=True, red2=True)
    station.refuses = "blue"
    station.stop_all().press("p", ())
    assert station.sent == [("green/emergency_stop", True), ("red2/emergency_stop", True)]
    station.refuses = "-"
    station.real_s += 0.3
    station.team.tick()
    assert ("blue/emergency_stop", True) in station.sent


def test_stop_is_repeated_after_a_link_is_back_that_has_lost_it(station: Station) -> None:
    station.link_says(blue=False)
    station.stop_all().press("p", ())
    station.real_s += 1.0
    station.team.tick()
    assert station.sent == [("blue/emergency_stop", True)]
    station.link_says(blue=True)
    station.team.tick()
    assert station.sent == [("blue/emergency_stop", True)] * 2


def test_state_of_a_stop_over_a_slow_link_counts_its_way(station: Station) -> None:
    station.hears(LinkState(peers=[LinkPeer(robot="blue", is_up=True, round_trip_s=6.0)]))
    station.hears(EmergencyStop(engaged=True), "blue/emergency_stop_state")
    assert station.team.all["blue"].stop_state == "base silent for 3 s; before: STOPPED"


@pytest.mark.parametrize("battery", [math.inf, -math.inf, math.nan, 3e38])
def test_no_figure_of_a_robot_ends_the_page(battery: float) -> None:
    shown = told(RobotSummary(battery=battery, alarms=[RobotAlarm(level=255)] * 1000))
    assert shown["battery"] is None or battery == 3e38
    assert len(json.dumps(shown, allow_nan=False)) < 1000


def test_what_a_robot_tells_is_short_and_no_script() -> None:
    long = "<script>" * 1250
    summary = RobotSummary(robot=long, colour=f"red;{long}", page=f"https://{long}", mode=long, state=long)
    shown = told(summary)
    assert len(json.dumps(shown)) < 500
    assert (shown["page"], shown["colour"]) == ("", "")
    assert told(RobotSummary(page="javascript:alert(1)"))["page"] == ""
    assert told(RobotSummary(page="http://blue:8080/"))["page"] == "http://blue:8080/"
    assert len("http://blue:8080/") < MAX_ADDRESS


def shown(station: Station, name: str) -> dict[str, Any]:
    context = Mock(team=station.team)
    return RobotsPanel(context)._shown(Mock(can_command=True), name)


def test_robots_that_tell_the_same_name_or_page_are_told_apart(station: Station) -> None:
    station.team.own = RobotSummary(robot="red", page="http://127.0.0.1:8080/")
    station.link_says(blue=True, green=True)
    station.hears(RobotSummary(robot="blue", page="http://127.0.0.1:8081/"), "blue/robot_summary")
    station.hears(RobotSummary(robot="blue", page="http://127.0.0.1:8080/"), "green/robot_summary")
    blue, green = shown(station, "blue"), shown(station, "green")
    assert (blue["name"], green["name"]) == ("blue", "green (blue)")
    assert blue["mayHold"]
    # At this address the operator would drive red.
    assert (green["page"], green["mayHold"]) == ("", False)


DRIVER = """
import panel from "./emergency_stop.mjs";
const page = { kept_all: { name: "p", settled: [], reached: [] }, keep_all() {}, answer: null };
const told = JSON.parse(process.argv[2]).map((robots) => {
  page.answer = { press_all: "p", robots };
  panel.methods.hear_all.call(page, page.answer);
  return page.kept_all && panel.methods.missing.call(page).map((one) => `${one.robot}: ${one.state}`);
});
console.log(JSON.stringify(told));
"""


def kept_after(tmp_path: Path, *answers: dict[str, str]) -> list[Any]:
    """Return which robots the page misses after each answer with fates; None: the press is settled."""
    (tmp_path / "emergency_stop.mjs").write_text(f"globalThis.window = {{}};\n{SCRIPT.read_text()}")
    (tmp_path / "driver.mjs").write_text(DRIVER)
    fates = [[{"robot": name, "fate": fate} for name, fate in one.items()] for one in answers]
    command = [str(NODE), str(tmp_path / "driver.mjs"), json.dumps(fates)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    return list(json.loads(done.stdout))


def test_page_keeps_a_press_until_each_robot_that_it_has_reached_confirms_it(tmp_path: Path) -> None:
    met_again = kept_after(
        tmp_path,
        {"": "confirmed", "blue": "pending"},
        {"": "", "other robots": ""},  # this robot was started again, and its link, too
        {"": ""},
        {"": "", "blue": "pending", "late": "pending"},
        {"": "", "blue": "confirmed", "late": "pending"},
        {"": "", "blue": "", "late": "confirmed"},
    )
    missing = ["blue: NOT CONFIRMED: this robot has not met it again"]
    assert met_again == [[], missing, missing, [], [], None]


def test_page_keeps_a_press_while_the_team_is_unknown(tmp_path: Path) -> None:
    assert kept_after(tmp_path, {"": "confirmed", "other robots": ""}, {"": "confirmed"}) == [[], None]


def test_state_of_the_own_base_in_a_log_is_no_stop() -> None:
    state: Latest[EmergencyStop] = Latest()
    messages = Mock(envelope=Mock(sender="playback", published_ns=0), newest=lambda *_: state)
    control = EmergencyStopControl(messages, Mock(), Mock(), log_source="playback")
    state.put(EmergencyStop(engaged=True))
    assert control.state_text == "base silent"
