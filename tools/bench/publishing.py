"""A peer's publisher: it sends warm-up messages until all subscribers get them, then the measured ones."""

import time
from collections.abc import Callable

from tools.bench.record import (
    BEGAN_NS,
    ENDED_NS,
    FINISHED,
    MEASURED,
    RECEIVED,
    SENT,
    STAMPS,
    OnMessage,
    map_publisher,
    map_subscriber,
)
from tools.bench.work import END, Work

WARM_UP_HZ = 1000.0
CONNECT_LIMIT_S = 10.0
DRAIN_LIMIT_S = 3.0
"""If nothing arrives for this long, the missing messages count as lost."""
FLAT_OUT_LIMIT_S = 8.0
END_EVERY_S = 0.02


class NoConnection(RuntimeError):
    """No message arrived."""


def publish_all(work: Work, send: Callable[[int], None]) -> None:
    """Do the publisher's part of the work.

    Args:
        work: the work.
        send: stamps and publishes the message with a given number.

    Raises:
        NoConnection: a subscriber did not receive the warm-up.
    """
    subscribers = [map_subscriber(work, index) for index in range(work.subscribers)]
    _warm_up(work, send, subscribers)
    own = map_publisher(work)
    own[BEGAN_NS] = time.monotonic_ns()
    own[SENT] = _publish_measured(work, _stamping(own, send) if work.stages else send)
    own[ENDED_NS] = time.monotonic_ns()
    time.sleep(work.pause_s)
    _finish(send, subscribers)


def passing_on(work: Work, send: Callable[[int], None]) -> OnMessage:
    """Return what a stage does with each message: it sends one with the same number."""
    subscribers = [map_subscriber(work, index) for index in range(work.subscribers)]

    def handle(number: int, stamp_ns: int, now_ns: int = 0) -> bool:
        if number != END:
            send(number)
            return False
        _finish(send, subscribers)
        return True

    return handle


def _stamping(own: memoryview, send: Callable[[int], None]) -> Callable[[int], None]:
    def stamp_and_send(number: int) -> None:
        own[STAMPS + number] = time.monotonic_ns()
        send(number)

    return stamp_and_send


def _finish(send: Callable[[int], None], subscribers: list[memoryview]) -> None:
    """Send the last message until all subscribers have it, or nothing arrives any more."""
    before, since_s = -1, 0.0
    while not all(words[FINISHED] for words in subscribers):
        arrived = sum(words[MEASURED] for words in subscribers)
        if arrived != before:
            before, since_s = arrived, time.monotonic()
        if time.monotonic() - since_s > DRAIN_LIMIT_S:
            return
        send(END)
        time.sleep(END_EVERY_S)


def _warm_up(work: Work, send: Callable[[int], None], subscribers: list[memoryview]) -> None:
    period_s = 1 / min(work.rate_hz or WARM_UP_HZ, WARM_UP_HZ)
    deadline_s = time.monotonic() + CONNECT_LIMIT_S
    while any(words[RECEIVED] < work.warm_up for words in subscribers):
        if time.monotonic() > deadline_s:
            received = [words[RECEIVED] for words in subscribers]
            raise NoConnection(f"after {CONNECT_LIMIT_S:g} s subscribers had received {received} messages")
        send(-1)
        time.sleep(period_s)


def _publish_measured(work: Work, send: Callable[[int], None]) -> int:
    if not work.rate_hz:
        return _publish_flat_out(work, send)
    period_s = 1 / work.rate_hz
    next_s = time.monotonic()
    for number in range(work.count):
        next_s += period_s
        time.sleep(max(0.0, next_s - time.monotonic()))
        send(number)
    return work.count


def _publish_flat_out(work: Work, send: Callable[[int], None]) -> int:
    deadline_s = time.monotonic() + FLAT_OUT_LIMIT_S
    for number in range(work.count):
        send(number)
        if number % 1000 == 0 and time.monotonic() > deadline_s:
            return number + 1
    return work.count
