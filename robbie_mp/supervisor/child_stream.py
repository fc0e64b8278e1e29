"""Reads what one incarnation of a child sends, whenever it sends: the part that all streams have in common.

A child is never blocked for longer than `PAUSE_S` at a time. A flood costs the supervisor little, for then
it reads once in each pause.
"""

import os
import time

from robbie_mp.supervisor.event_loop import EventLoop

PAUSE_S = 0.01


class ChildStream:
    """One descriptor that the event loop finds readable."""

    def __init__(self, fd: int, loop: EventLoop):
        """Watch the descriptor from now on.

        Args:
            fd: the reading end, non-blocking; owned from now on.
            loop: watches it.
        """
        self._fd = fd
        self._loop = loop
        self._is_open = True
        self._is_watched = True
        loop.watch(fd, self._on_readable)

    def finish(self) -> None:
        """Take what is still there, half a line included, and close."""
        limit_s = time.monotonic() + PAUSE_S  # a descendant that escaped may go on writing
        while self._is_open and time.monotonic() < limit_s:
            if self._read() is None:
                break
        self._close()

    def _read(self) -> bool | None:
        """Read once and keep it: True within the rate, False beyond, None if there is nothing now.

        Closes at the end of the stream.
        """
        raise NotImplementedError

    def _flush(self) -> None:
        """Keep what was read in part; the stream has ended."""

    def _on_readable(self) -> None:
        if self._read() is False and self._is_open:
            self._loop.unwatch(self._fd)
            self._is_watched = False
            self._loop.call_later(PAUSE_S, self._resume)

    def _resume(self) -> None:
        if self._is_open:
            self._loop.watch(self._fd, self._on_readable)
            self._is_watched = True

    def _close(self) -> None:
        if not self._is_open:
            return
        self._is_open = False
        self._flush()
        if self._is_watched:
            self._loop.unwatch(self._fd)
        os.close(self._fd)
