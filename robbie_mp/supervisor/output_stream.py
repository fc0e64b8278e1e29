"""Reads one pipe of a child and cuts what comes into lines.

A child is never blocked for longer than `PAUSE_S` at a time: its pipe is read whenever it writes. A flood
costs the supervisor little, for then it reads one full pipe (64 KiB) in each pause.
"""

import codecs
import os
import time

from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.output import ChildOutput

READ_BYTES = 1 << 16
PAUSE_S = 0.01


class OutputStream:
    """One pipe of one incarnation, read when the event loop finds it readable."""

    def __init__(self, fd: int, name: str, output: ChildOutput, loop: EventLoop):
        """Watch the pipe from now on.

        Args:
            fd: its reading end, non-blocking; owned from now on.
            name: "stdout" or "stderr".
            output: gets the lines.
            loop: watches the pipe.
        """
        self._fd = fd
        self._name = name
        self._output = output
        self._loop = loop
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._partial = ""
        self._is_open = True
        self._is_watched = True
        loop.watch(fd, self._on_readable)

    def finish(self) -> None:
        """Take what is still in the pipe, a line without end included, and close it."""
        limit_s = time.monotonic() + PAUSE_S  # a descendant that escaped may go on writing
        while self._is_open and time.monotonic() < limit_s:
            data = self._receive()
            if data is None:
                break
            self._take(data)
        self._close()

    def _on_readable(self) -> None:
        data = self._receive()
        if data is None:
            return
        was_within_rate = self._take(data)
        if self._is_open and not was_within_rate:
            self._loop.unwatch(self._fd)
            self._is_watched = False
            self._loop.call_later(PAUSE_S, self._resume)

    def _resume(self) -> None:
        if self._is_open:
            self._loop.watch(self._fd, self._on_readable)
            self._is_watched = True

    def _receive(self) -> bytes | None:
        """Return what is in the pipe, empty at its end, None if there is nothing now."""
        try:
            return os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return None

    def _take(self, data: bytes) -> bool:
        if not data:
            self._close()
            return True
        *lines, self._partial = (self._partial + self._decoder.decode(data)).split("\n")
        longest = self._output.limits.line_characters
        pieces = [piece for line in lines for piece in _cut(line.removesuffix("\r"), longest)]
        if len(self._partial) > longest:
            *whole, self._partial = _cut(self._partial, longest)
            pieces += whole
        return self._output.add(self._name, pieces)

    def _close(self) -> None:
        if not self._is_open:
            return
        self._is_open = False
        if rest := self._partial + self._decoder.decode(b"", final=True):
            self._output.add(self._name, [rest])
        if self._is_watched:
            self._loop.unwatch(self._fd)
        os.close(self._fd)


def _cut(text: str, longest: int) -> list[str]:
    if len(text) <= longest:
        return [text]
    return [text[start : start + longest] for start in range(0, len(text), longest)]
