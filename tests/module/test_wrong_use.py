"""Mistakes that authors make with a module's methods get an error that says what was wanted."""

import re
from collections.abc import Iterator
from typing import Any

import pytest

from robbie_mp import Module, ModuleHarness, setting
from robbie_mp.messages import DriveCommand, LaserScan, NotAMessage
from robbie_mp.messages.errors import DeclarationError
from robbie_mp.module.class_check import InvalidClass
from robbie_mp.module.harness import InvalidAdvance, NotEntered
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


class SetsNoneInSetup(SetsItInSetup):
    """Sets a period that is none at the last moment."""

    def setup(self) -> None:
        self.period_s = 0


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
    with pytest.raises(InvalidClass, match=r"\.py:\d+: Ticking has a tick\(\), but nothing sets period_s"):
        ModuleHarness(Ticking)
    for cls in (NotPositive, Endless, Text):
        with pytest.raises(InvalidClass, match=rf"period_s is {re.escape(repr(cls.period_s))}; it must be"):
            ModuleHarness(cls)
    with pytest.raises(InvalidPeriod, match="period_s is 0; it must be"):
        ModuleHarness(SetsNoneInSetup).__enter__()


@pytest.mark.parametrize("cls", [Plain, TicksLater, SetsItInSetup])
def test_module_may_be_passive_or_set_its_period_itself(cls: type[Module]) -> None:
    with ModuleHarness(cls):
        pass


class AsyncTick(Module):
    """Has a tick that would never run."""

    period_s = 0.1

    async def tick(self) -> None:  # type: ignore[override]
        """Never runs."""


class AsyncSetup(Module):
    """Has a setup that would never run."""

    async def setup(self) -> None:  # type: ignore[override]
        """Never runs."""


class PortOfItsOwn(Module):
    """Is written as a node of ROS."""

    def __init__(self, port: str = "/dev/ttyUSB0") -> None:
        super().__init__()  # type: ignore[call-arg]
        self.port = port


class CountsInTick(Module):
    """Has a number in place of a method."""

    def setup(self) -> None:
        self.tick = 5  # type: ignore[assignment, method-assign]


class TicksUnderAnotherName(Module):
    """Has a period, and names its tick as other frameworks do."""

    period_s = 0.1

    def on_tick(self) -> None:
        """Never runs."""


class ForgotTick(Module):
    """Has a period as a setting, and handles messages only."""

    period_s: float = setting(0.1, "time between ticks")

    def setup(self) -> None:
        self.subscribe(LaserScan, print)


class NoModule:
    """Is derived from nothing."""


MISTAKEN: dict[Any, str] = {
    AsyncTick: r"test_wrong_use.py:\d+: tick is an `async def`, which would never run; write `def tick`",
    AsyncSetup: "setup is an `async def`, which would never run",
    PortOfItsOwn: r"__init__ calls super\(\).__init__\(\) without .*; make port a setting",
    CountsInTick: r"test_wrong_use.py:\d+: self.tick is a method of Module, and no place for a value",
    TicksUnderAnotherName: r"has a period_s, but no tick\(\) .*; rename on_tick\(\) to tick",
    ForgotTick: r"has a period_s, but no tick\(\) .*; write `def tick\(self\)`, or leave out period_s",
    NoModule: r"NoModule'> is no class of modules; write `class NAME\(robbie_mp.Module\)`",
}
"""By class: what a harness says of it, which `robbie run` says, too."""


@pytest.mark.parametrize("cls", MISTAKEN)
def test_harness_finds_the_mistakes_that_a_run_finds_before_it_starts(cls: Any) -> None:
    with pytest.raises(InvalidClass, match=MISTAKEN[cls]) as raised:
        ModuleHarness(cls)
    assert "\n" not in str(raised.value)


USES: dict[str, Any] = {
    "send": lambda harness: harness.send(LaserScan()),
    "advance": lambda harness: harness.advance(0.1),
    "change_setting": lambda harness: harness.change_setting("period_s", 1),
    "send_encoded": lambda harness: harness.send_encoded("a/msg/B", 1, LaserScan().encode()),
}


@pytest.mark.parametrize("use", USES)
def test_harness_without_its_block_says_so(use: str) -> None:
    with pytest.raises(NotEntered, match=r"setup\(\) has not run; write `with ModuleHarness\(Plain\) as"):
        USES[use](ModuleHarness(Plain))


WRONG: dict[str, tuple[Any, type[Exception], str]] = {
    "text to take": (
        lambda it: it.take("ticks"),
        NotAMessage,
        "take wants a class of messages.* got 'ticks'",
    ),
    "message to take": (lambda it: it.take(LaserScan()), NotAMessage, "give its class: LaserScan"),
    "text for latched": (lambda it: it.latched("map"), NotAMessage, "latched wants a class of messages"),
    "text to call": (lambda it: it.call("plan"), NotAMessage, "call wants a message"),
    "message to call": (lambda it: it.call(LaserScan()), DeclarationError, r"write class LaserScan\(Request"),
    "text as goal": (lambda it: it.send_goal("go"), NotAMessage, "send_goal wants a message"),
    "text as reply": (lambda it: it.reply(LaserScan(), "yes"), NotAMessage, "reply wants a message"),
    "message as goal": (lambda it: it.send_goal(LaserScan()), NotAMessage, "of a call, .* got a LaserScan"),
    "message as feedback": (
        lambda it: it.feed_back(LaserScan(), 1),
        NotAMessage,
        "feed_back wants a message of",
    ),
    "text to refuse": (lambda it: it.refuse("plan", "no"), NotAMessage, "refuse wants a message"),
    "text to cancel": (lambda it: it.cancel_goal("plan"), NotAMessage, "cancel_goal wants a message"),
    "text as end": (lambda it: it.end_goal("plan", "no"), NotAMessage, "end_goal wants a message"),
    "back in time": (lambda it: it.advance(-1), InvalidAdvance, r"advance\(-1\): give a time from 0 to 1e9"),
    "no time": (lambda it: it.advance("1s"), InvalidAdvance, r"advance\('1s'\): give a time"),
    "no number": (lambda it: it.advance(float("nan")), InvalidAdvance, r"advance\(nan\): give a time"),
}
"""What a test does wrong with a harness: its error, and what the line says."""


@pytest.mark.parametrize("name", WRONG)
def test_wrong_use_of_a_harness_is_explained(name: str) -> None:
    use, error, said = WRONG[name]
    with ModuleHarness(Plain) as harness, pytest.raises(error, match=said) as raised:
        use(harness)
    assert "\n" not in str(raised.value)
    with ModuleHarness(Plain) as harness:
        harness.advance(0)
