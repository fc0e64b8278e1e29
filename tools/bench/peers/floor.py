"""The lower bound for brokered messages: three processes wake one another, with 64 bytes in mapped memory."""

import contextlib
import mmap
import os
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle

import posix_ipc

from tools.bench.peers.peer import Peer, Send
from tools.bench.record import OnMessage
from tools.bench.work import END, Work

PROBE = struct.Struct("qqdddddd")
NUMBER = struct.Struct("q")
MEMORY_BYTES = 1 << 20
PLACES = range(0, MEMORY_BYTES, PROBE.size)
"""The places of messages in memory: enough that no message is overwritten before it is read."""

RELAY, SUBSCRIBER = "relay", "subscriber"


class Floor(Peer):
    """The least that any framework with a process between publisher and subscriber must do."""

    title = "floor: 3 processes with 2 semaphores"
    how = "posix_ipc semaphores; 64 bytes packed into and unpacked from mapped memory; bare Python loops"
    has_relay = True

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Pack messages, and wake the relay."""
        memory, wake_relay, places = _memory(work), _semaphore(work, RELAY).release, cycle(PLACES)

        def send(number: int) -> None:
            stamp_ns = time.monotonic_ns()
            PROBE.pack_into(memory, next(places), number, stamp_ns, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
            wake_relay()

        yield send

    def relay(self, work: Work) -> None:
        """Wake the subscriber each time the publisher wakes this process."""
        memory, wait = _memory(work), _semaphore(work, RELAY).acquire
        wake_subscriber = _semaphore(work, SUBSCRIBER).release
        number, places = 0, cycle(PLACES)
        while number != END:
            wait()
            wake_subscriber()
            (number,) = NUMBER.unpack_from(memory, next(places))

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Wait until the relay wakes this process, and unpack the message."""
        memory, wait = _memory(work), _semaphore(work, SUBSCRIBER).acquire
        ended, places = False, cycle(PLACES)
        while not ended:
            wait()
            number, stamp_ns, *_ = PROBE.unpack_from(memory, next(places))
            ended = handle(number, stamp_ns)

    def clean(self, work: Work) -> None:
        """Remove the semaphores' names."""
        for name in (RELAY, SUBSCRIBER):
            with contextlib.suppress(posix_ipc.ExistentialError):
                posix_ipc.unlink_semaphore(f"/{work.topic}-{name}")


def _memory(work: Work) -> mmap.mmap:
    """Map a file in the work's folder. Create it if it does not exist."""
    descriptor = os.open(work.folder / "floor.memory", os.O_RDWR | os.O_CREAT, 0o600)
    os.truncate(descriptor, MEMORY_BYTES)
    return mmap.mmap(descriptor, MEMORY_BYTES)


def _semaphore(work: Work, name: str) -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{work.topic}-{name}", posix_ipc.O_CREAT, mode=0o600)


PEER = Floor()
