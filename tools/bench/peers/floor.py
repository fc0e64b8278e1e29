"""The floor of brokered messages: three processes wake one another by semaphores; 64 bytes lie in memory."""

import contextlib
import mmap
import os
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle

import posix_ipc

from tools.bench.peers.peer import Handle, Peer, Send
from tools.bench.work import END, Work

PROBE = struct.Struct("qqdddddd")
NUMBER = struct.Struct("q")
MEMORY_BYTES = 1 << 20
PLACES = range(0, MEMORY_BYTES, PROBE.size)
"""Where messages lie, one after another: enough of them that none is overwritten before it is read."""


class Floor(Peer):
    """No framework can do less and still have a process of its own between publisher and subscriber."""

    title = "floor: 3 processes, 2 semaphores"
    how = "posix_ipc semaphores; 64 bytes packed into and unpacked from mapped memory; bare Python loops"
    has_relay = True
    most_subscribers = 1

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Pack, and wake the relay."""
        memory, relay, places = _memory(work), _semaphore(work, "relay"), cycle(PLACES)

        def send(number: int) -> None:
            stamp_ns = time.monotonic_ns()
            PROBE.pack_into(memory, next(places), number, stamp_ns, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
            relay.release()

        yield send

    def relay(self, work: Work) -> None:
        """Wake the subscriber whenever woken."""
        memory, own, subscriber = _memory(work), _semaphore(work, "relay"), _semaphore(work, "subscriber")
        number, places = 0, cycle(PLACES)
        while number != END:
            own.acquire()
            subscriber.release()
            (number,) = NUMBER.unpack_from(memory, next(places))

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait to be woken, and unpack."""
        memory, own = _memory(work), _semaphore(work, "subscriber")
        ended, places = False, cycle(PLACES)
        while not ended:
            own.acquire()
            number, stamp_ns, *_ = PROBE.unpack_from(memory, next(places))
            ended = handle(number, stamp_ns)

    def clean(self, work: Work) -> None:
        """Remove the semaphores."""
        for name in ("relay", "subscriber"):
            with contextlib.suppress(posix_ipc.ExistentialError):
                posix_ipc.unlink_semaphore(f"/{work.topic}-{name}")


def _memory(work: Work) -> mmap.mmap:
    descriptor = os.open(work.folder / "floor.memory", os.O_RDWR | os.O_CREAT, 0o600)
    os.truncate(descriptor, MEMORY_BYTES)
    return mmap.mmap(descriptor, MEMORY_BYTES)


def _semaphore(work: Work, name: str) -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{work.topic}-{name}", posix_ipc.O_CREAT, mode=0o600)


PEER = Floor()
