"""A press of the emergency stop is repeated until the base confirms it, and never stops the robot twice."""

import json
import time
from unittest.mock import Mock

import pytest

from robbie_mp.messages import EmergencyStop
from robbie_mp.module.clock import ManualClock
from robbie_mp.station.fleet.stop_all import StopAll
from robbie_mp.station.stop.connection import Question, question_of
from robbie_mp.station.stop.emergency_stop import EmergencyStopControl
from robbie_mp.station.stop.requests import (
    IN_FLIGHT_S,
    MAX_PRESSES,
    MIN_INTERVAL_S,
    REPEAT_S,
    PressState,
    StopRequests,
    state_text,
)
from robbie_mp.station.watch.latest import Latest


class Base:
    """Gets stops (True) and releases (False), and says what it does."""

    def __init__(self) -> None:
        self.clock = ManualClock(100 * 10**9)
        self.heard: list[bool] = []
        self.has_room = True
        self.requests = StopRequests(self.hear, self.now_s)

    def now_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9

    def hear(self, engaged: bool) -> bool:
        if self.has_room:
            self.heard.append(engaged)
        return self.has_room

    def after(self, seconds: float) -> "Base":
        self.clock.advance(seconds)
        self.requests.repeat()
        return self

    def says(self, *, engaged: bool, earlier_s: float = 0.0) -> None:
        self.requests.see(engaged=engaged, published_s=self.now_s() - earlier_s)


@pytest.fixture
def base() -> Base:
    return Base()


def test_press_is_repeated_until_the_base_confirms_it(base: Base) -> None:
    base.requests.press("one")
    assert base.heard == [True]
    for _ in range(5):
        base.after(REPEAT_S + 0.001)
        base.says(engaged=False)
    assert base.heard == [True] * 6
    assert base.requests.waits_s == pytest.approx(5 * REPEAT_S, abs=0.01)
    base.says(engaged=True)
    base.after(10 * REPEAT_S)
    assert base.heard == [True] * 6
    assert base.requests.fate("one") is PressState.CONFIRMED
    assert base.requests.waits_s is None


def test_earlier_report_of_the_base_does_not_confirm_a_press(base: Base) -> None:
    base.requests.press("one")
    base.clock.advance(0.01)
    base.says(engaged=True, earlier_s=0.02)
    assert base.requests.fate("one") is PressState.PENDING


def test_press_right_after_a_release_is_not_confirmed_by_the_earlier_stop(base: Base) -> None:
    base.requests.release()
    base.requests.press("one")
    base.after(IN_FLIGHT_S / 2).says(engaged=True)  # it has heard neither yet
    assert base.requests.fate("one") is PressState.PENDING
    base.after(IN_FLIGHT_S).says(engaged=True)
    assert base.requests.fate("one") is PressState.CONFIRMED


def test_repeated_settled_press_does_not_stop_the_robot_again(base: Base) -> None:
    base.requests.press("one")
    base.clock.advance(0.1)
    base.says(engaged=True)
    base.requests.release()
    base.requests.press("one")  # by a page that has not been told yet
    base.after(1)
    assert base.heard == [True, False]


def test_release_withdraws_waiting_presses_and_a_new_press_stops_again(base: Base) -> None:
    base.requests.press("one")
    assert base.requests.release()
    assert base.requests.fate("one") is PressState.WITHDRAWN
    base.after(1)
    assert base.heard == [True, False]
    base.requests.press("two")
    assert base.heard == [True, False, True]


def test_press_refused_for_lack_of_memory_is_sent_as_soon_as_possible(base: Base) -> None:
    base.has_room = False
    base.requests.press("one")
    base.clock.advance(0.1)
    base.says(engaged=True)
    assert base.requests.fate("one") is PressState.PENDING, "nothing was sent that could be confirmed"
    assert not base.requests.release()
    base.has_room = True
    base.after(0.001)
    assert base.heard == [True]


def test_flood_of_presses_is_bounded_in_memory_and_rate(base: Base) -> None:
    for number in range(3 * MAX_PRESSES):
        base.requests.press(str(number))
    assert base.heard == [True]
    base.after(MIN_INTERVAL_S)
    assert base.heard == [True, True]
    known = [base.requests.fate(str(number)) for number in range(3 * MAX_PRESSES)]
    assert known.count(PressState.PENDING) == MAX_PRESSES
    base.after(0.01).says(engaged=True)
    assert base.requests.waits_s is None


def test_pages_are_notified_when_the_state_of_a_press_changes(base: Base) -> None:
    told: list[PressState | None] = []
    listener = lambda: told.append(base.requests.fate("one"))  # noqa: E731
    base.requests.listen(listener)
    base.requests.press("one")
    base.after(0.1).says(engaged=True)
    base.requests.ignore(listener)
    base.requests.press("two")
    assert told == [PressState.PENDING, PressState.CONFIRMED]


@pytest.mark.parametrize(
    "text",
    [
        None, "", "{", "5", "[]", "{}", '{"asked_ms": 1}', '{"asked_ms": null, "press": ""}',
        '{"asked_ms": NaN, "press": ""}', '{"asked_ms": 1e999, "press": ""}', '{"asked_ms": 1, "press": 3}',
        f'{{"asked_ms": {"9" * 400}, "press": ""}}', f'{{"asked_ms": 1, "press": "{"x" * 65}"}}',
        "[" * 100_000, '{"asked_ms": 1, "press": "", "press_all": 5}',
        '{"asked_ms": 1, "press": "", "settled": "a"}',
        '{"asked_ms": 1, "press": "", "settled": [5]}',
        f'{{"asked_ms": 1, "press": "", "settled": {json.dumps(["a"] * 65)}}}',
    ],
)  # fmt: skip
def test_malformed_questions_are_ignored(text: object) -> None:
    assert question_of(text) is None


def test_question_names_a_press_or_none() -> None:
    assert question_of('{"asked_ms": 1.5, "press": "ab-1"}') == Question(1.5, "ab-1")
    assert question_of('{"asked_ms": 2, "press": ""}') == Question(2.0, "")
    asked = '{"asked_ms": 3, "press": "", "press_all": "c-2", "settled": ["blue"]}'
    assert question_of(asked) == Question(3.0, "", "c-2", ("blue",))


class Team:
    """Robots of a team, of which each tells its own base."""

    def __init__(self, *names: str):
        self.bases = {name: Base() for name in ("", *names)}
        others = {name: Mock(requests=base.requests) for name, base in self.bases.items() if name}
        for name, robot in others.items():
            robot.name, robot.stop_state = name, "ready"
        self.stop = StopAll(self.bases[""].requests, lambda: "ready", Mock(all=others, unknown=""))

    def fates(self, press: str) -> dict[str, str]:
        return {one["robot"]: one["fate"] for one in self.stop.states(press)}

    def confirm(self, name: str) -> None:
        base = self.bases[name]
        base.clock.advance(0.1)
        base.requests.see(engaged=True, published_s=base.now_s())


def test_each_robot_confirms_a_stop_of_all_by_itself() -> None:
    team = Team("blue", "green")
    team.stop.press("p", ())
    assert [base.heard for base in team.bases.values()] == [[True]] * 3
    team.confirm("")
    team.confirm("green")
    assert team.fates("p") == {"": "confirmed", "blue": "pending", "green": "confirmed"}
    team.stop.press("p", ())  # as the page says until all have confirmed
    assert team.bases["green"].heard == [True]


def test_restarted_station_stops_no_robot_again_that_has_confirmed() -> None:
    team = Team("blue", "green")
    team.stop.press("p", ("", "green"))
    assert [base.heard for base in team.bases.values()] == [[], [True], []]


def test_stop_that_is_not_confirmed_is_said_with_its_age() -> None:
    assert state_text(0.2, False, 0.1) == "stopping …"
    assert state_text(4.2, True, 0.1, ": no link") == "NOT CONFIRMED for 4 s: no link"
    assert state_text(None, True, 0.1) == "STOPPED"
    assert state_text(None, False, 5.0) == "base silent for 5 s; before: ready"
    assert state_text(None, None, None) == "base silent"


def test_base_beside_a_paused_log_falls_silent() -> None:
    """The clock of ages is that of the log, which stands; the base's report grows old all the same."""
    state: Latest[EmergencyStop] = Latest(lambda: 5.0)
    messages = Mock(envelope=Mock(sender="base", published_ns=0), newest=lambda *_: state)
    control = EmergencyStopControl(messages, Mock(), Mock(), log_source="playback")
    question = Question(0.0, "")
    assert json.loads(control.service.answer(question))["age_s"] is None
    state.put(EmergencyStop(engaged=False))
    time.sleep(0.2)
    answer = json.loads(control.service.answer(question))
    assert 0.2 <= answer["age_s"] < 100
    assert (answer["engaged"], answer["is_of_log"]) == (False, False)
