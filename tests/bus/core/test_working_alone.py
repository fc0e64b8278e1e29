"""The loop of the core in C: it waits for posts, handles what is common, and leaves the rest to Python."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

import pytest

from robbie_mp.bus._hot import choice
from robbie_mp.bus.core.native_router import NativeRouter
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.bus.transport.wakeup import Wakeup
from tests.bus.transport.test_cost_of_a_message import PUBLISHER, RUN_ID, SUBSCRIBER, Chain, Speed

LONG_S = 20.0
SHORT_S = 0.05


class Robot:
    """A chain whose core waits for posts as in a robot."""

    def __init__(self, chain: Chain, wakeup: Wakeup):
        assert isinstance(chain.core, NativeRouter)
        self.chain = chain
        self.wakeup = wakeup
        self.core = chain.core
        self.words = chain.core._words

    def work(self, timeout_s: float = LONG_S) -> float:
        """Let the core work alone; return how long it did."""
        begun_s = time.monotonic()
        assert self.core.work_alone(self.wakeup.post, timeout_s)
        return time.monotonic() - begun_s

    def routed(self) -> int:
        return self.words[layout.CORE_LAST_SEQUENCE]


@pytest.fixture
def robot() -> Iterator[Robot]:
    native = choice.native()
    if native is None:
        pytest.skip(f"NOT TESTED, {choice.why_not()}")
    chain = Chain(native)
    chain.send(Speed())
    wakeup = Wakeup.create(names.core_wakeup(RUN_ID), native, chain.core._words, layout.CORE_ASLEEP)
    yield Robot(chain, wakeup)
    wakeup.close()
    wakeup.unlink()
    chain.close()


def later(action: Callable[[], object]) -> threading.Thread:
    thread = threading.Timer(0.05, action)
    thread.start()
    return thread


def test_messages_are_routed_after_each_post_until_there_is_none(robot: Robot) -> None:
    before, wakeups = robot.routed(), robot.words[layout.CORE_WAKEUPS]
    for _ in range(3):
        assert robot.chain.outbox.publish(Speed(), "")
        robot.wakeup.post()
    assert robot.work(SHORT_S) >= SHORT_S
    assert robot.routed() == before + 3
    assert robot.words[layout.CORE_WAKEUPS] == wakeups + 2  # three posts wake it once, then it waits in vain
    assert abs(robot.words[layout.CORE_HEARTBEAT_NS] - time.monotonic_ns()) < 1e9
    assert robot.chain.posts[f"slot {SUBSCRIBER}"] > 0


def test_record_that_is_not_common_is_handled_by_python_at_once(robot: Robot) -> None:
    channels = len(robot.core._directory._channels)

    def declare() -> None:
        robot.chain.outbox._endpoint.advertise("test_msgs/msg/New", 1, "")
        robot.wakeup.post()

    later(declare)
    assert robot.work() < LONG_S / 2
    assert not robot.core.run_round()
    assert len(robot.core._directory._channels) == channels + 1


def test_module_that_comes_meanwhile_is_served(robot: Robot) -> None:
    def start() -> None:
        robot.chain.ends[0].send(Outbound.MODULE_UP, PUBLISHER, 2)
        robot.wakeup.post()

    later(start)
    assert robot.work() < LONG_S / 2
    robot.core.run_round()
    assert [link.incarnation for link in robot.core._members.links if link.slot == PUBLISHER] == [1, 2]


def test_signal_ends_the_work(robot: Robot) -> None:
    heard: list[int] = []

    def hear(number: int, _frame: FrameType | None) -> None:
        heard.append(number)

    before = signal.signal(signal.SIGALRM, hear)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        assert robot.work() < LONG_S / 2
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert heard == [signal.SIGALRM]


def test_flood_does_not_keep_python_from_looking_at_signals(robot: Robot) -> None:
    stop = threading.Event()

    def flood() -> None:
        while not stop.wait(0.001):
            robot.wakeup.post()

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        assert robot.work(4 * SHORT_S) < LONG_S / 2
    finally:
        stop.set()
        thread.join()


def test_module_that_waits_for_blocks_is_woken_without_python(robot: Robot) -> None:
    chain = robot.chain
    assert chain.outbox.publish(Speed(), "")
    chain.outbox._endpoint.wake_after_freed(1)
    robot.wakeup.post()
    robot.work(SHORT_S)
    before = chain.posts.copy()
    assert chain.inbox.handle_next()
    assert chain.posts["core"] == before["core"] + 1, "a release is awaited, so it posts"
    robot.wakeup.post()
    robot.work(SHORT_S)
    assert chain.posts[f"slot {PUBLISHER}"] == before[f"slot {PUBLISHER}"] + 1
