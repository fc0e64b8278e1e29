"""Commands that a slow network or a stopped server delivers late do not move the robot."""

import heapq
import math
from typing import Any

import pytest

from robbie_mp.station.driving.dead_man import LIMIT_S, MAX_WAITING, PING_PERIOD_S, WINDOW_S, DeadManSwitch
from robbie_mp.station.driving.driver import DriverInput, checked, share_of_speed

PAGE_AHEAD_S = 1000.0
"""How far the page's clock is ahead of the robot's."""


class Network:
    """A page and its server, with a delay in each direction, in fake time."""

    def __init__(self, there_s: float, back_s: float):
        self.there_s, self.back_s = there_s, back_s
        self.now_s = 5.0
        self.switch = DeadManSwitch()
        self._next_ping_s = self.now_s
        self._pongs: list[tuple[float, int, float]] = []

    def run(self, for_s: float) -> None:
        """Let time pass, in which pings are exchanged."""
        until_s = self.now_s + for_s
        while self.now_s < until_s:
            self.now_s += 0.01
            if self.now_s >= self._next_ping_s:
                self._next_ping_s += PING_PERIOD_S
                number, page_s = self.switch.ping(self.now_s), self.now_s + self.there_s + PAGE_AHEAD_S
                heapq.heappush(self._pongs, (self.now_s + self.there_s + self.back_s, number, page_s))
            while self._pongs and self._pongs[0][0] <= self.now_s:
                arrives_s, number, page_s = heapq.heappop(self._pongs)
                self.switch.pong(number, page_s, arrives_s)
            self.switch.look(self.now_s)

    def age_s(self, delay_s: float | None = None) -> float:
        """Return the age that is told of a command that arrives now."""
        delay_s = self.back_s if delay_s is None else delay_s
        return self.switch.age_s(self.now_s - delay_s + PAGE_AHEAD_S, self.now_s)


@pytest.mark.parametrize(
    ("there_s", "back_s"),
    [(0.3, 0.3), (1.0, 1.0), (2.5, 2.5), (0.0, 0.3), (0.3, 0.0), (2.0, 0.01)],
)
def test_constant_delay_is_seen_whatever_the_clocks_say(there_s: float, back_s: float) -> None:
    network = Network(there_s, back_s)
    for _ in range(20):
        network.run(0.5)
        assert network.age_s() >= there_s + back_s - 0.02 > LIMIT_S
    assert network.switch.is_too_slow
    assert network.switch.losses == 1
    assert network.switch.delay_s(network.now_s) == pytest.approx(there_s + back_s, abs=0.02)


def test_commands_of_a_quick_network_are_fresh() -> None:
    network = Network(0.03, 0.02)
    network.run(60.0)
    assert 0.02 <= network.age_s() <= 0.1
    assert (network.switch.is_too_slow, network.switch.losses) == (False, 0)


def test_no_command_counts_before_the_first_ping_is_answered() -> None:
    network = Network(0.05, 0.05)
    assert network.age_s(0.0) == math.inf
    network.run(0.2)
    assert network.age_s() <= LIMIT_S


def test_delay_that_begins_during_a_drive_makes_commands_old_at_once() -> None:
    network = Network(0.01, 0.01)
    network.run(5.0)
    network.there_s = network.back_s = 0.3
    assert network.age_s() >= 0.3
    network.run(WINDOW_S + 1.0)
    assert network.switch.losses == 1
    network.there_s = network.back_s = 0.01
    network.run(1.0)
    assert not network.switch.is_too_slow
    assert network.age_s() < 0.1


def test_page_that_answers_no_ping_is_too_slow() -> None:
    network = Network(0.01, math.inf)
    network.run(1.0)
    assert network.switch.is_too_slow
    assert network.switch.delay_s(network.now_s) == pytest.approx(1.0, abs=0.03)


def test_one_ping_that_had_to_wait_is_no_slow_network() -> None:
    network = Network(0.01, 0.01)
    network.run(3.0)
    network.back_s = 0.4
    network.run(PING_PERIOD_S)
    network.back_s = 0.01
    network.run(3.0)
    assert network.switch.losses == 0


def test_clock_of_a_laptop_that_was_asleep_is_learnt_again() -> None:
    network = Network(0.01, 0.01)
    network.run(3.0)
    slept_s = 900.0  # for which the page's clock stood still
    switch, now_s = network.switch, network.now_s + slept_s
    number = switch.ping(now_s)
    page_s = network.now_s + 0.01 + PAGE_AHEAD_S
    assert switch.age_s(page_s, now_s + 0.02) > LIMIT_S
    switch.pong(number, page_s, now_s + 0.02)
    assert switch.age_s(page_s, now_s + 0.03) <= LIMIT_S


@pytest.mark.parametrize("page_s", [math.nan, math.inf, -1e300])
def test_answers_that_cannot_be_are_ignored(page_s: float) -> None:
    switch = DeadManSwitch()
    switch.pong(switch.ping(1.0), page_s, 1.1)
    switch.pong(99, 5.0, 1.1)
    assert switch.age_s(5.0, 1.1) == math.inf
    assert switch.age_s(page_s, 1.1) == math.inf


def test_pings_without_an_answer_are_bounded() -> None:
    switch = DeadManSwitch()
    numbers = [switch.ping(float(second)) for second in range(10 * MAX_WAITING)]
    switch.pong(numbers[0], 5.0, 1000.0)
    assert switch.age_s(5.0, 1000.0) == math.inf


@pytest.mark.parametrize(
    "sent",
    [
        None,
        "drive",
        [],
        {},
        {"linear": "fast", "angular": 0, "sent_s": 0},
        {"linear": math.nan, "angular": 0, "sent_s": 0},
        {"linear": 0, "angular": math.inf, "sent_s": 0},
        {"linear": 0, "angular": 10**400, "sent_s": 0},
        {"linear": None, "angular": 0, "sent_s": 0},
    ],
)
def test_malformed_commands_are_ignored(sent: Any) -> None:
    assert checked(sent) is None


def test_speeds_beyond_the_pad_are_clamped() -> None:
    sent = {"linear": 7, "angular": -7, "sent_s": 1, "held": True}
    assert checked(sent) == DriverInput(held=True, begins=False, linear=1.0, angular=-1.0, sent_s=1.0)


@pytest.mark.parametrize(
    ("seen", "age_s", "share"),
    [
        (None, 0.0, 1.0),
        (0.5, 0.5, 1.0),
        (1.0, 1.0, 0.5),
        (60.0, 60.0, 0.1),
        (math.inf, math.inf, 0.1),
        (-0.05, 0.0, 1.0),
        (-3, math.inf, 0.1),
    ],
)
def test_top_speed_falls_with_the_age_of_the_operators_picture(seen: Any, age_s: float, share: float) -> None:
    wish = checked({"linear": 1, "angular": 1, "sent_s": 1, "held": True, "picture_age_s": seen})
    assert wish is not None
    assert (wish.picture_age_s, share_of_speed(wish.picture_age_s)) == (age_s, share)


@pytest.mark.parametrize("seen", [math.nan, "old", [], 10**400])
def test_input_whose_picture_has_no_age_is_refused(seen: Any) -> None:
    assert checked({"linear": 1, "angular": 1, "sent_s": 1, "held": True, "picture_age_s": seen}) is None


def test_who_has_let_go_does_not_move_the_robot() -> None:
    sent = {"linear": 1, "angular": 1, "sent_s": 1, "held": False}
    assert checked(sent) == DriverInput(held=False, begins=False, linear=0.0, angular=0.0, sent_s=1.0)


def test_order_is_prompt_only_while_the_page_answers() -> None:
    network = Network(0.05, 0.05)
    assert network.switch.is_prompt(network.now_s)  # the page has just been opened
    network.run(3.0)
    assert network.switch.is_prompt(network.now_s)
    network.there_s = 30.0  # the network is cut; what the operator presses meanwhile arrives later
    network.run(5.0)
    assert not network.switch.is_prompt(network.now_s)


def test_order_that_waited_in_a_stopped_station_is_not_prompt_until_the_page_has_answered_again() -> None:
    network = Network(0.05, 0.05)
    network.run(3.0)
    network.now_s += 10.0  # the process was stopped, and the browser's messages wait for it
    assert not network.switch.is_prompt(network.now_s)
    number = network.switch.ping(network.now_s)
    network.switch.look(network.now_s)
    assert not network.switch.is_prompt(network.now_s)
    network.switch.pong(number, network.now_s + PAGE_AHEAD_S, network.now_s + 0.1)
    assert network.switch.is_prompt(network.now_s + 0.1)
