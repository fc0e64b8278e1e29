"""Commands that a slow link or a stopped server delivers late do not move the robot."""

import math
from typing import Any

import pytest

from robbie_mp.station.dead_man import DeadManSwitch
from robbie_mp.station.driving.driver import checked


def test_commands_with_the_usual_delay_are_fresh() -> None:
    switch = DeadManSwitch()
    switch.begin()
    for beat in range(20):
        sent_s = 1000 + 0.1 * beat
        assert switch.accept(sent_s, 5 + 0.1 * beat + 0.02 * (beat % 3))
    assert switch.stale == 0


def test_delayed_commands_are_discarded_and_counted() -> None:
    switch = DeadManSwitch()
    switch.begin()
    assert switch.accept(1000.0, 5.0)
    # The server stood still for 2 s; then it gets all of them at once.
    late = [switch.accept(1000.0 + 0.1 * beat, 7.06) for beat in range(1, 21)]
    assert late == [False] * 18 + [True, True]
    assert switch.stale == 18


def test_each_drive_has_its_own_reference_delay() -> None:
    switch = DeadManSwitch()
    switch.begin()
    assert switch.accept(1000.0, 5.0)
    switch.begin()  # perhaps after the page's clock stood still in a laptop that was asleep
    assert switch.accept(1001.0, 900.0)


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
        {"linear": None, "angular": 0, "sent_s": 0},
    ],
)
def test_malformed_commands_are_ignored(sent: Any) -> None:
    assert checked(sent) is None


def test_speeds_beyond_the_pad_are_clamped() -> None:
    assert checked({"linear": 7, "angular": -7, "sent_s": 1, "held": True}) == (True, False, 1.0, -1.0, 1.0)
