"""Mistakes that authors make with a module's methods get an error that says what was wanted."""

import re
from collections.abc import Iterator
from typing import Any

import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.messages import DriveCommand, LaserScan, NotAMessage
from robbie_mp.module.module import InvalidPeriod


class Plain(Module):
    """Does nothing by itself."""


@pytest.fixture
def module() -> Iterator[Any]:
    with ModuleHarness(Plain) as harness:
        yield harness.module


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"ranges": [1.0]}, r"publish wants a message.*got \{'ranges': \[1.0\]\} \(dict\); from_dict"),
        (LaserScan, r"the class itself; create a message: publish\(LaserScan\(\.\.\.\)\)"),
        ("hello", r"got 'hello' \(str\)"),
        (None, r"got None \(NoneType\)"),
    ],
)
def test_publishing_anything_but_a_message_says_what_is_wanted(module: Any, wrong: object, said: str) -> None:
    with pytest.raises(NotAMessage, match=said):
        module.publish(wrong)


@pytest.mark.parametrize("wrong", ["sensor_msgs/msg/LaserScan", LaserScan(), dict, None])
def test_types_must_be_classes_of_messages(module: Any, wrong: object) -> None:
    with pytest.raises(NotAMessage, match="subscribe wants a class of messages, such as LaserScan"):
        module.subscribe(wrong, print)
    with pytest.raises(NotAMessage, match="advertise wants a class"):
        module.advertise(wrong)
    with pytest.raises(NotAMessage, match="loan wants a class"), module.loan(wrong):
        pass


def test_message_can_be_announced_before_it_is_published(module: Any) -> None:
    module.advertise(DriveCommand, topic="drive")
    assert module.publish(DriveCommand(), topic="drive")


class Ticking(Module):
    """Never says how often it ticks."""

    def tick(self) -> None:
        """Never runs."""


class TicksLater(Ticking):
    """Begins to tick when a handler says so."""

    period_s = None


class SetsItInSetup(Ticking):
    """Sets the period of its ticks at the last moment."""

    def setup(self) -> None:
        self.period_s = 0.1


class NotPositive(Ticking):
    """Has no time between ticks."""

    period_s = 0.0


class Endless(Ticking):
    """Has more time between ticks than a clock can show."""

    period_s = 1e300


class Text(Ticking):
    """Has a text as its time between ticks."""

    period_s = "0.1"


def test_tick_without_a_period_is_an_error() -> None:
    with pytest.raises(InvalidPeriod, match=r"Ticking has a tick\(\), but nothing sets period_s"):
        ModuleHarness(Ticking).__enter__()
    for cls in (NotPositive, Endless, Text):
        with pytest.raises(InvalidPeriod, match=rf"period_s is {re.escape(str(cls.period_s))}; it must be"):
            ModuleHarness(cls).__enter__()


@pytest.mark.parametrize("cls", [Plain, TicksLater, SetsItInSetup])
def test_module_may_be_passive_or_set_its_period_itself(cls: type[Module]) -> None:
    with ModuleHarness(cls):
        pass
