"""The lower bound for brokered messages: three processes wake one another, with 64 bytes in mapped memory."""

import contextlib
import mmap
import os
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import Protocol

import posix_ipc

from tools.bench.peers.peer import Handle, Peer, Send
from tools.bench.work import END, Work

PROBE = struct.Struct("qqdddddd")
NUMBER = struct.Struct("q")
MEMORY_BYTES = 1 << 20
PLACES = range(0, MEMORY_BYTES, PROBE.size)
"""The places of messages in memory: enough that no message is overwritten before it is read."""

RELAY, SUBSCRIBER = "relay", "subscriber"
POLL_S = 0.01


class Wakes(Protocol):
    """One way for a process to wake another one."""

    title: str
    how: str

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function with which the process `name` sleeps until another process wakes it."""

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that wakes the process `name` once."""

    def clean(self, work: Work, name: str) -> None:
        """Remove what would be left outside the work's folder."""


class Floor(Peer):
    """The least that any framework with a process between publisher and subscriber must do."""

    has_relay = True
    most_subscribers = 1

    def __init__(self, wakes: Wakes):
        self._wakes = wakes
        self.title = f"floor: 3 processes with {wakes.title}"
        self.how = f"{wakes.how}; 64 bytes packed into and unpacked from mapped memory; bare Python loops"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Pack messages, and wake the relay."""
        memory, wake_relay, places = _memory(work), self._wakes.waking(work, RELAY), cycle(PLACES)

        def send(number: int) -> None:
            stamp_ns = time.monotonic_ns()
            PROBE.pack_into(memory, next(places), number, stamp_ns, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
            wake_relay()

        yield send

    def relay(self, work: Work) -> None:
        """Wake the subscriber each time the publisher wakes this process."""
        memory, wait = _memory(work), self._wakes.waiting(work, RELAY)
        wake_subscriber = self._wakes.waking(work, SUBSCRIBER)
        number, places = 0, cycle(PLACES)
        while number != END:
            wait()
            wake_subscriber()
            (number,) = NUMBER.unpack_from(memory, next(places))

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait until the relay wakes this process, and unpack the message."""
        memory, wait = _memory(work), self._wakes.waiting(work, SUBSCRIBER)
        ended, places = False, cycle(PLACES)
        while not ended:
            wait()
            number, stamp_ns, *_ = PROBE.unpack_from(memory, next(places))
            ended = handle(number, stamp_ns)

    def clean(self, work: Work) -> None:
        """Remove what would be left."""
        for name in (RELAY, SUBSCRIBER):
            self._wakes.clean(work, name)


class InFolder:
    """Base of the ways that leave nothing outside the work's folder."""

    def clean(self, work: Work, name: str) -> None:
        """Do nothing: the folder is removed anyway."""


class Semaphores:
    """Semaphores, which Robbie uses, too."""

    title = "2 semaphores"
    how = "posix_ipc semaphores"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that waits for a post."""
        acquire: Callable[[], object] = _semaphore(work, name).acquire
        return acquire

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return a function that posts."""
        release: Callable[[], object] = _semaphore(work, name).release
        return release

    def clean(self, work: Work, name: str) -> None:
        """Remove the semaphore's name."""
        with contextlib.suppress(posix_ipc.ExistentialError):
            posix_ipc.unlink_semaphore(f"/{work.topic}-{name}")


def until_there(connect: Callable[[], None]) -> None:
    """Retry until the other process is ready."""
    while True:
        try:
            connect()
        except (FileNotFoundError, ConnectionRefusedError):
            time.sleep(POLL_S)
        else:
            return


def map_file(work: Work, name: str, size_bytes: int) -> mmap.mmap:
    """Map a file in the work's folder. Create it if it does not exist."""
    descriptor = os.open(work.folder / name, os.O_RDWR | os.O_CREAT, 0o600)
    os.truncate(descriptor, size_bytes)
    return mmap.mmap(descriptor, size_bytes)


def _memory(work: Work) -> mmap.mmap:
    return map_file(work, "floor.memory", MEMORY_BYTES)


def _semaphore(work: Work, name: str) -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{work.topic}-{name}", posix_ipc.O_CREAT, mode=0o600)


PEER = Floor(Semaphores())
