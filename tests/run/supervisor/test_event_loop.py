"""The loop makes exactly the calls that are due."""

import os
import signal
import time
from collections.abc import Iterator

import pytest

from robbie_mp.run.supervisor.event_loop import EventLoop, signals_in_loop


class Pipe:
    """A pipe that holds a byte."""

    def __init__(self) -> None:
        self.reader, self._writer = os.pipe()
        os.write(self._writer, b"x")

    def close(self) -> None:
        os.close(self.reader)
        os.close(self._writer)


@pytest.fixture
def loop() -> Iterator[EventLoop]:
    made = EventLoop(time.monotonic)
    yield made
    made.close()


def test_callback_of_a_descriptor_closed_in_the_same_turn_is_not_called(loop: EventLoop) -> None:
    pipes = [Pipe(), Pipe()]
    called: list[str] = []

    def close_all() -> None:
        called.append("first")
        for pipe in pipes:
            loop.unwatch(pipe.reader)
            pipe.close()

    for pipe in pipes:
        loop.watch(pipe.reader, close_all)
    loop.turn(1.0)
    assert called == ["first"]


def test_callback_of_a_descriptor_whose_number_was_reused_is_not_called(loop: EventLoop) -> None:
    pipes = [Pipe(), Pipe()]
    called: list[str] = []

    def replace_all() -> None:
        called.append("old")
        for pipe in pipes:
            loop.unwatch(pipe.reader)
            loop.watch(pipe.reader, lambda: called.append("new"))

    for pipe in pipes:
        loop.watch(pipe.reader, replace_all)
    loop.turn(1.0)
    assert called == ["old"]
    loop.turn(1.0)
    assert called == ["old", "new", "new"]
    for pipe in pipes:
        loop.unwatch(pipe.reader)
        pipe.close()


def test_timers_are_called_in_order_and_once() -> None:
    now_s = 0.0
    loop = EventLoop(lambda: now_s)
    called: list[str] = []
    loop.call_later(2.0, lambda: called.append("late"))
    loop.call_later(1.0, lambda: called.append("early"))
    loop.turn(0.0)
    assert called == []
    now_s = 5.0
    loop.turn(10.0)
    loop.turn(0.0)
    assert called == ["early", "late"]
    loop.close()


def test_signals_arrive_in_the_loop_and_handlers_are_restored(loop: EventLoop) -> None:
    before = signal.getsignal(signal.SIGTERM)
    arrived: list[int] = []
    with signals_in_loop(loop, [signal.SIGTERM], arrived.append):
        os.kill(os.getpid(), signal.SIGTERM)
        assert arrived == []
        loop.turn(1.0)
    assert arrived == [signal.SIGTERM]
    assert signal.getsignal(signal.SIGTERM) is before
