"""Input that must keep coming: a module is told once when it does not, by its own clock."""

import logging
import math
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest

from robbie_mp import MessageHandling, Module, ModuleHarness, RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import LaserScan, Odometry
from robbie_mp.module.bus import CopyingBus
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.deadlines import Deadlines, InvalidDeadline
from robbie_mp.module.envelope import Envelope
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.module.health import Health

SCAN = ChannelName("sensor_msgs/msg/LaserScan", 1, "")
S = 10**9


class Driver(Module):
    """Has no period: it is woken by messages and deadlines alone."""

    is_optional = False

    def setup(self) -> None:
        self.late: list[int] = []
        self.subscribe(
            LaserScan, self.ignore, topic="front", deadline_s=0.4, on_late=self.on_late,
            optional=self.is_optional,
        )  # fmt: skip
        self.subscribe(Odometry, self.ignore, MessageHandling.KEEP_ONLY_NEWEST)

    def ignore(self, _message: object) -> None:
        pass

    def on_late(self) -> None:
        self.late.append(self.clock.monotonic_ns())


class PatientDriver(Driver):
    is_optional = True


def test_late_input_is_reported_once_until_a_message_comes_in_time() -> None:
    with ModuleHarness(Driver) as harness:
        harness.send(LaserScan(), topic="front")
        harness.advance(0.39)
        assert not harness.module.late
        harness.advance(10.0)
        assert harness.module.late == [round(0.4 * S)], "neither early nor twice"
        harness.send(LaserScan(), topic="front")
        harness.advance(0.39)
        assert len(harness.module.late) == 1
        harness.advance(10.0)
        assert harness.module.late == [round(0.4 * S), round(10.79 * S)]


def test_messages_of_other_subscriptions_do_not_count() -> None:
    with ModuleHarness(Driver) as harness:
        for _ in range(10):
            with suppress(NotSubscribed):
                harness.send(LaserScan(), topic="rear")
            with suppress(NotSubscribed):
                harness.send(Odometry())
            harness.advance(0.1)
        assert harness.module.late == [round(0.4 * S)]


def test_ill_formed_messages_do_not_count() -> None:
    with ModuleHarness(Driver) as harness:
        for _ in range(10):
            harness.send(LaserScan(angle_min=math.nan), topic="front")
            harness.advance(0.1)
        assert harness.module.late == [round(0.4 * S)]
        assert harness.module.ill_formed.total == 10


def test_ill_formed_message_hides_no_good_one() -> None:
    with ModuleHarness(Driver) as harness:
        for _ in range(10):
            harness.advance(0.15)
            harness.send(LaserScan(), topic="front")
            harness.advance(0.15)
            harness.send(LaserScan(angle_min=math.nan), topic="front")
        assert not harness.module.late


def test_message_that_a_tool_loses_does_not_count(caplog: pytest.LogCaptureFixture) -> None:
    bus = CopyingBus(lambda _: 0)
    name = bus.subscriptions.subscribe(LaserScan, lambda _: None, MessageHandling.ALWAYS_DELIVER, "front")
    (subscription,) = bus.subscriptions
    for data in (LaserScan(angle_min=math.nan).encode(), b"\0\1\0\0damaged", LaserScan().encode()):
        before_ns = bus.newest_stamp_ns(name)
        bus.hand_over(subscription, name, Envelope("front", 1, "laser", S), data)
    assert before_ns == -1
    assert bus.newest_stamp_ns(name) == S
    assert bus.subscriptions.refusals.total == 2
    assert "refused an ill-formed message" in caplog.text


def test_first_message_may_be_late_unless_it_is_optional() -> None:
    with ModuleHarness(Driver) as harness:
        harness.advance(1.0)
        assert len(harness.module.late) == 1
    with ModuleHarness(PatientDriver) as harness:
        harness.advance(1.0)
        assert not harness.module.late
        harness.send(LaserScan(), topic="front")
        harness.advance(1.0)
        assert len(harness.module.late) == 1


def test_lateness_is_said_when_it_begins_and_when_it_ends(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with ModuleHarness(Driver) as harness:
        harness.advance(5.0)
        assert caplog.messages == ["DEGRADED: no LaserScan on topic 'front' for 0.4 s"]
        harness.send(LaserScan(), topic="front")
        harness.advance(0.3)
        assert caplog.messages[1:] == ["OK again: LaserScan on topic 'front' comes again"]


@pytest.mark.parametrize("deadline_s", [0.0, -1.0, 1e300, float("nan"), float("inf")])
def test_deadline_must_be_a_positive_time(deadline_s: float) -> None:
    with ModuleHarness(Driver) as harness, pytest.raises(InvalidDeadline, match="greater than 0"):
        harness.module.subscribe(LaserScan, print, deadline_s=deadline_s)


def test_on_late_needs_a_deadline() -> None:
    with ModuleHarness(Driver) as harness, pytest.raises(RobbieError, match="give both"):
        harness.module.subscribe(LaserScan, print, on_late=print)


class LateSubscriber(Driver):
    def setup(self) -> None:
        self.late = []
        self.subscribe(Odometry, self.begin)

    def begin(self, _message: object) -> None:
        self.subscribe(LaserScan, self.ignore, deadline_s=0.4, on_late=self.on_late)


def test_deadline_of_a_later_subscription_begins_with_it() -> None:
    with ModuleHarness(LateSubscriber) as harness:
        harness.advance(3.0)
        harness.send(Odometry())
        harness.advance(3.0)
        assert harness.module.late == [round(3.4 * S)]


class FakeTime:
    """A run's clock that can be set, and a bus whose newest message is `newest_ns` old by the machine."""

    def __init__(self) -> None:
        self.machine_ns = self.run_ns = self.jumps = 0
        self.rate = 1.0
        self.newest_ns = -1
        self.shown: list[int] = []
        self.peers = SimpleNamespace(now_ns=lambda: self.machine_ns)

    def monotonic_ns(self) -> int:
        return self.run_ns

    def at(self, machine_ns: int) -> int:
        return round(self.run_ns - (self.machine_ns - machine_ns) * self.rate)

    def machine_s_until(self, run_ns: int) -> float:
        return (run_ns - self.run_ns) / 1e9 / self.rate if self.rate else float("inf")

    def newest_stamp_ns(self, _name: ChannelName) -> int:
        return self.newest_ns

    def show_deadline(self, _name: ChannelName, *words: int) -> None:
        self.shown = list(words)

    def publish(self) -> None:
        self.newest_ns = self.machine_ns

    def pass_s(self, seconds: float) -> None:
        self.machine_ns += round(seconds * S)
        self.run_ns += round(seconds * S * self.rate)


def begin(time: FakeTime, on_late: Callable[[], None]) -> Deadlines:
    anything: Any = time
    deadlines = Deadlines(anything, anything, Health(logging.getLogger("test").warning), Due())
    deadlines.add(SCAN, "LaserScan", 0.4, on_late, is_optional=False)
    deadlines.begin()
    deadlines.look()
    return deadlines


def test_message_that_waited_is_as_old_as_it_is() -> None:
    time, late = FakeTime(), [0]
    deadlines = begin(time, lambda: late.append(1))
    time.publish()
    time.pass_s(0.5)
    deadlines.look()
    assert sum(late) == 1
    time.newest_ns = time.machine_ns - S // 2  # the next one has waited as long
    deadlines.look()
    assert sum(late) == 1, "it is late all the time"
    time.publish()
    deadlines.look()
    time.pass_s(0.7)
    deadlines.look()
    assert sum(late) == 2
    assert time.shown == [round(0.4 * S), 2, round(0.7 * S)]


def test_time_that_stands_still_makes_nothing_late() -> None:
    time, late = FakeTime(), [0]
    deadlines = begin(time, lambda: late.append(1))
    time.rate = 0.0
    time.pass_s(100.0)
    deadlines.look()
    assert sum(late) == 0
    assert deadlines.due_ns <= time.machine_ns + S // 5, "the rate may change at any time"
    time.rate = 10.0
    time.pass_s(0.05)
    deadlines.look()
    assert sum(late) == 1


@pytest.mark.parametrize("jump_s", [-1000, 1000])
def test_jump_of_time_makes_nothing_late_and_hides_nothing(jump_s: int) -> None:
    time, late = FakeTime(), [0]
    time.run_ns = 5000 * S
    deadlines = begin(time, lambda: late.append(1))
    time.publish()
    time.run_ns += jump_s * S
    time.jumps += 1
    deadlines.look()
    assert sum(late) == 0
    time.pass_s(0.5)
    deadlines.look()
    assert sum(late) == 1


def test_module_without_deadlines_never_looks() -> None:
    anything: Any = FakeTime()
    deadlines = Deadlines(anything, anything, Health(logging.getLogger("test").warning), Due())
    deadlines.begin()
    deadlines.look()
    assert deadlines.due_ns == NEVER_NS


def test_module_is_ok_again_only_when_no_reason_is_left(caplog: pytest.LogCaptureFixture) -> None:
    shown: list[str] = []
    health = Health(logging.getLogger("test").warning, shown.append)
    health.degrade("scan", "no scan")
    health.degrade("pose", "no pose")
    health.degrade("scan", "no scan")
    health.recover("scan", "scans come")
    health.recover("scan", "scans come")
    health.recover("pose", "poses come")
    assert shown == ["no scan", "no scan; no pose", "no pose", ""]
    assert caplog.messages == [
        "DEGRADED: no scan", "DEGRADED: no pose", "still DEGRADED: scans come", "OK again: poses come",
    ]  # fmt: skip
