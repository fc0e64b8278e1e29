"""The records of publisher and subscribers: mapped files, which the other processes can read at any time."""

import mmap
import time
from pathlib import Path
from typing import Protocol

from tools.bench.work import END, Work

RECEIVED, FINISHED, MEASURED, FIRST_NS, LAST_NS, HEADER = range(6)
SENT, BEGAN_NS, ENDED_NS, STAMPS = range(4)


def _map(file: Path, words: int) -> memoryview:
    with file.open("a+b") as opened:
        opened.truncate(words * 8)
        return memoryview(mmap.mmap(opened.fileno(), words * 8)).cast("q")


def subscriber_file(work: Work, index: int) -> Path:
    """Return the file in which a subscriber records the messages it receives."""
    return work.folder / f"subscriber-{index}.record"


def publisher_file(work: Work) -> Path:
    """Return the file in which the publisher records the messages it sends."""
    return work.folder / "publisher.record"


def map_subscriber(work: Work, index: int) -> memoryview:
    """Map a subscriber's words: the header, then the latency of each message (ns; 0: not received)."""
    return _map(subscriber_file(work, index), HEADER + work.count)


def map_publisher(work: Work) -> memoryview:
    """Map the publisher's words; if there are stages, the stamp of each message follows (monotonic, ns)."""
    return _map(publisher_file(work), STAMPS + (work.count if work.stages else 0))


class OnMessage(Protocol):
    """Records decoded messages; see `Receipts.handle`."""

    def __call__(self, number: int, stamp_ns: int, now_ns: int = 0, /) -> bool:
        """Record a message by its number and stamp (monotonic clock, ns); return True after the last one."""


class Receipts:
    """Writes the record of one subscriber."""

    def __init__(self, work: Work, index: int):
        self._words = map_subscriber(work, index)
        self._stamps = map_publisher(work)[STAMPS:] if work.stages else None
        self._received = 0
        self._measured = 0

    def handle(self, number: int, stamp_ns: int, now_ns: int = 0) -> bool:
        """Record a decoded message. Return True if it was the last one.

        Args:
            number: of the message.
            stamp_ns: when it was published; behind stages, the publisher's record has it.
            now_ns: when it was decoded; 0: now.
        """
        now_ns = now_ns or time.monotonic_ns()
        words = self._words
        if number >= 0:
            if self._stamps is not None:
                stamp_ns = self._stamps[number]
            words[HEADER + number] = now_ns - stamp_ns
            words[LAST_NS] = now_ns
            if not self._measured:
                words[FIRST_NS] = now_ns
            self._measured += 1
            words[MEASURED] = self._measured
            return False
        if number == END:
            words[FINISHED] = 1
            return True
        self._received += 1
        words[RECEIVED] = self._received
        return False
