"""The output of one incarnation of a child, read as it arrives and cut into lines.

A child is never blocked for longer than `PAUSE_S` at a time. A flood costs the supervisor little: while it
lasts, the supervisor reads once in each pause.
"""

import codecs
import os
import time

from robbie_mp.run.supervisor.event_loop import EventLoop
from robbie_mp.run.supervisor.output import ChildOutput
from robbie_mp.run.trace.channel import LINE_BYTES

PAUSE_S = 0.01
OUTPUT_READ_BYTES = 1 << 16
RECORD_READ_BYTES = 1 << 14


class ChildStream:
    """One descriptor that the event loop finds readable."""

    def __init__(self, fd: int, loop: EventLoop):
        """Watch the descriptor from now on.

        Args:
            fd: the reading end, non-blocking; this object closes it.
            loop: watches it.
        """
        self._fd = fd
        self._loop = loop
        self._is_open = True
        self._is_watched = True
        loop.watch(fd, self._on_readable)

    def finish(self) -> None:
        """Read the rest, including a partial line, and close."""
        limit_s = time.monotonic() + PAUSE_S  # an escaped descendant may continue to write
        while self._is_open and time.monotonic() < limit_s:
            if self._read() is None:
                break
        self._close()

    def _read(self) -> bool | None:
        """Read once: return True within the rate limit, False beyond it, None if nothing is there.

        Closes at the end of the stream.
        """
        raise NotImplementedError

    def _flush(self) -> None:
        """Keep a partial line; the stream has ended."""

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


class OutputStream(ChildStream):
    """Standard output or standard error of one incarnation."""

    def __init__(self, fd: int, name: str, output: ChildOutput, loop: EventLoop):
        """Watch the pipe from now on.

        Args:
            fd: the reading end, non-blocking; this object closes it.
            name: "stdout" or "stderr".
            output: receives the lines.
            loop: watches the pipe.
        """
        super().__init__(fd, loop)
        self._name = name
        self._output = output
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._partial = ""

    def _read(self) -> bool | None:
        try:
            data = os.read(self._fd, OUTPUT_READ_BYTES)
        except BlockingIOError:
            return None
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

    def _flush(self) -> None:
        if rest := self._partial + self._decoder.decode(b"", final=True):
            self._output.add(self._name, [rest])


def _cut(text: str, longest: int) -> list[str]:
    if len(text) <= longest:
        return [text]
    return [text[start : start + longest] for start in range(0, len(text), longest)]


class RecordStream(ChildStream):
    """The log channel of one incarnation; see `robbie_mp.run.trace.channel`."""

    def __init__(self, fd: int, output: ChildOutput, loop: EventLoop):
        """Watch the channel from now on.

        Args:
            fd: the supervisor's end; this object closes it.
            output: receives the records.
            loop: watches the channel.
        """
        super().__init__(fd, loop)
        self._output = output
        self._partial = b""

    def _read(self) -> bool | None:
        try:
            data = os.read(self._fd, RECORD_READ_BYTES)
        except BlockingIOError:
            return None
        if not data:
            self._close()
            return True
        *lines, self._partial = (self._partial + data).split(b"\n")
        if len(self._partial) > LINE_BYTES:  # our handler never sends such a line
            lines.append(self._partial)
            self._partial = b""
        return self._output.add_records(lines)

    def _flush(self) -> None:
        if self._partial:
            self._output.add_records([self._partial])
