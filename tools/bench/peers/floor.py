"""The floor of brokered messages: three processes wake one another by semaphores; 64 bytes lie in memory."""

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
"""Where messages lie, one after another: enough of them that none is overwritten before it is read."""

RELAY, SUBSCRIBER = "relay", "subscriber"
POLL_S = 0.01


class Wakes(Protocol):
    """One way in which a process that sleeps is woken by another."""

    title: str
    how: str

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Return what sleeps until woken, once for each time; `name` says who."""

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Return what wakes who has this name."""

    def clean(self, work: Work, name: str) -> None:
        """Remove what would stay, outside the work's folder."""


class Floor(Peer):
    """No framework can do less and still have a process of its own between publisher and subscriber."""

    has_relay = True
    most_subscribers = 1

    def __init__(self, wakes: Wakes):
        self._wakes = wakes
        self.title = f"floor: 3 processes with {wakes.title}"
        self.how = f"{wakes.how}; 64 bytes packed into and unpacked from mapped memory; bare Python loops"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Pack, and wake the relay."""
        memory, wake_relay, places = _memory(work), self._wakes.waking(work, RELAY), cycle(PLACES)

        def send(number: int) -> None:
            stamp_ns = time.monotonic_ns()
            PROBE.pack_into(memory, next(places), number, stamp_ns, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
            wake_relay()

        yield send

    def relay(self, work: Work) -> None:
        """Wake the subscriber whenever woken."""
        memory, wait = _memory(work), self._wakes.waiting(work, RELAY)
        wake_subscriber = self._wakes.waking(work, SUBSCRIBER)
        number, places = 0, cycle(PLACES)
        while number != END:
            wait()
            wake_subscriber()
            (number,) = NUMBER.unpack_from(memory, next(places))

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait to be woken, and unpack."""
        memory, wait = _memory(work), self._wakes.waiting(work, SUBSCRIBER)
        ended, places = False, cycle(PLACES)
        while not ended:
            wait()
            number, stamp_ns, *_ = PROBE.unpack_from(memory, next(places))
            ended = handle(number, stamp_ns)

    def clean(self, work: Work) -> None:
        """Remove what would stay."""
        for name in (RELAY, SUBSCRIBER):
            self._wakes.clean(work, name)


class InFolder:
    """For ways whose all lies in the work's folder."""

    def clean(self, work: Work, name: str) -> None:
        """The folder is removed anyway."""


class Semaphores:
    """What Robbie uses."""

    title = "2 semaphores"
    how = "posix_ipc semaphores"

    def waiting(self, work: Work, name: str) -> Callable[[], object]:
        """Wait for a post."""
        acquire: Callable[[], object] = _semaphore(work, name).acquire
        return acquire

    def waking(self, work: Work, name: str) -> Callable[[], object]:
        """Post."""
        release: Callable[[], object] = _semaphore(work, name).release
        return release

    def clean(self, work: Work, name: str) -> None:
        """Remove the semaphore's name."""
        with contextlib.suppress(posix_ipc.ExistentialError):
            posix_ipc.unlink_semaphore(f"/{work.topic}-{name}")


def until_there(connect: Callable[[], None]) -> None:
    """Try until the other process is ready for it."""
    while True:
        try:
            connect()
        except (FileNotFoundError, ConnectionRefusedError):
            time.sleep(POLL_S)
        else:
            return


def map_file(work: Work, name: str, size_bytes: int) -> mmap.mmap:
    """Map a file of the work's folder, made if need be."""
    descriptor = os.open(work.folder / name, os.O_RDWR | os.O_CREAT, 0o600)
    os.truncate(descriptor, size_bytes)
    return mmap.mmap(descriptor, size_bytes)


def _memory(work: Work) -> mmap.mmap:
    return map_file(work, "floor.memory", MEMORY_BYTES)


def _semaphore(work: Work, name: str) -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{work.topic}-{name}", posix_ipc.O_CREAT, mode=0o600)


PEER = Floor(Semaphores())
