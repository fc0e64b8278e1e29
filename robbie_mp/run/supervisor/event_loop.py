"""Waits for descriptors, timers and signals in one thread."""

import heapq
import itertools
import selectors
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

Callback = Callable[[], None]


class EventLoop:
    """Calls back when a descriptor is readable or a timer expires."""

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self._selector = selectors.DefaultSelector()
        self._timers: list[tuple[float, int, Callback]] = []
        self._order = itertools.count()

    def watch(self, fd: int, callback: Callback) -> None:
        """Call back whenever the descriptor is readable, until `unwatch`."""
        self._selector.register(fd, selectors.EVENT_READ, callback)

    def unwatch(self, fd: int) -> None:
        """Stop watching. Call this before you close the descriptor."""
        self._selector.unregister(fd)

    def call_later(self, delay_s: float, callback: Callback) -> None:
        """Call back once."""
        heapq.heappush(self._timers, (self._clock() + delay_s, next(self._order), callback))

    def turn(self, timeout_s: float) -> None:
        """Wait for the first event, at most `timeout_s`, and make all calls that are due."""
        if self._timers:
            timeout_s = min(timeout_s, self._timers[0][0] - self._clock())
        watched = self._selector.get_map()
        for key, _ in self._selector.select(max(0.0, timeout_s)):
            # An earlier callback may have closed this descriptor, and its number may have been reused.
            if watched.get(key.fd) is key:
                key.data()
        now_s = self._clock()
        while self._timers and self._timers[0][0] <= now_s:
            heapq.heappop(self._timers)[2]()

    def close(self) -> None:
        """Close the selector; watched descriptors stay open."""
        self._selector.close()


@contextmanager
def signals_in_loop(
    loop: EventLoop, signums: Sequence[int], callback: Callable[[int], None]
) -> Iterator[None]:
    """While entered, replace the handling of these signals: the loop calls back for each of them.

    Python allows this in the main thread only. A signal handler may run between any two instructions, so it
    only writes a byte (signal.set_wakeup_fd), which the loop reads.
    """
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)

    def read() -> None:
        for signum in reader.recv(4096):
            if signum in signums:
                callback(signum)

    loop.watch(reader.fileno(), read)
    previous_fd = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    previous = {signum: signal.signal(signum, lambda *_: None) for signum in signums}
    try:
        yield
    finally:
        for signum, handler in previous.items():
            signal.signal(signum, handler)
        signal.set_wakeup_fd(previous_fd)
        loop.unwatch(reader.fileno())
        reader.close()
        writer.close()
