"""A device whose library waits by itself: it is lost, found, silent, slow to take, and stuck."""

import time
from collections.abc import Callable
from contextlib import closing
from threading import Event
from typing import TypeVar

import pytest

from robbie_robots.hw.connection.background import MAX_CALL_S, BackgroundDevice, DeviceStuck
from robbie_robots.hw.connection.device import ConnectionState
from tests.hw._support.line import Clock

LIMIT_S = 20.0

T = TypeVar("T")


class Counting(BackgroundDevice[int]):
    """Gives numbers, one for each `allow`."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__("the counter", silence_s=1.0, kept=3, monotonic=clock)
        self.is_there, self.is_silent, self.number, self.opened, self.closed = True, False, 0, 0, 0
        self.go = Event()
        self.release, self.is_hanging = Event(), Event()
        self.hangs = False

    def _open(self) -> None:
        if not self.is_there:
            raise OSError("it is not there")
        self.opened += 1

    def _read(self) -> int | None:
        if self.hangs:
            self.is_hanging.set()
            self.release.wait(LIMIT_S)
        if not self.is_there:
            raise OSError("it was pulled out")
        if self.is_silent or not self.go.wait(0.01):
            return None
        self.go.clear()
        self.number += 1
        return self.number

    def _close(self) -> None:
        self.closed += 1

    def give(self, count: int = 1) -> None:
        """Let it give numbers, and wait until it has."""
        for _ in range(count):
            before = self.number
            self.go.set()
            until(lambda before=before: self.number > before)  # type: ignore[misc]


def until(condition: Callable[[], T]) -> T:
    give_up_s = time.monotonic() + LIMIT_S
    while not (result := condition()):
        assert time.monotonic() < give_up_s
        time.sleep(0.001)
    return result


def test_value_connects_and_loss_is_told_until_the_device_is_back() -> None:
    with closing(Counting()) as device:
        assert device.poll() == [] and device.state == ConnectionState.DISCONNECTED
        device.give()
        assert device.poll(LIMIT_S) == [1]
        assert device.is_connected and device.reason == ""
        device.is_there = False
        until(lambda: not device.is_connected)
        assert device.reason in ("it was pulled out", "it is not there")
        device.is_there = True
        device.go.set()
        assert until(lambda: device.poll(0.05)) == [2]
        assert (device.counters.connections, device.counters.losses) == (2, 1)
    assert device.closed >= device.opened and device.reason == "closed"


def test_values_that_nobody_takes_are_dropped_oldest_first_and_counted() -> None:
    with closing(Counting()) as device:
        device.poll()
        device.give(5)
        until(lambda: device.counters.values == 5)
        assert device.poll() == [3, 4, 5]
        assert device.dropped == 2
        device.give()
        until(lambda: device.counters.values == 6)
        device.is_there = False
        until(lambda: not device.is_connected)
        device.is_there = True
        assert device.poll() == [] and device.dropped == 3


def test_silent_device_counts_as_lost_and_is_opened_again() -> None:
    clock = Clock()
    with closing(Counting(clock)) as device:
        device.poll()
        device.give()
        until(device.poll)
        clock.now_s += 1.1
        assert device.poll() == [] and not device.is_connected
        assert device.reason == "the counter has sent nothing for 1 s"
        until(lambda: device.opened == 2)
        device.go.set()
        assert until(device.poll) == [2]
        assert (device.counters.connections, device.counters.losses, device.counters.failures) == (2, 1, 0)


def test_library_that_does_not_return_is_told_so_that_the_process_is_replaced() -> None:
    clock = Clock()
    with closing(Counting(clock)) as device:
        device.poll()
        device.give()
        until(device.poll)
        device.hangs = True
        assert device.is_hanging.wait(LIMIT_S)
        clock.now_s += MAX_CALL_S + 0.1
        with pytest.raises(DeviceStuck, match="the library of the counter has not returned for 15 s"):
            device.poll()
        device.hangs = False
        device.release.set()
