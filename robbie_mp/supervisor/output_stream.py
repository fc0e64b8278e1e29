"""Cuts what comes through a pipe of a child into lines."""

import codecs
import os

from robbie_mp.supervisor.child_stream import ChildStream
from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.output import ChildOutput

READ_BYTES = 1 << 16


class OutputStream(ChildStream):
    """Standard output or standard error of one incarnation."""

    def __init__(self, fd: int, name: str, output: ChildOutput, loop: EventLoop):
        """Watch the pipe from now on.

        Args:
            fd: its reading end, non-blocking; owned from now on.
            name: "stdout" or "stderr".
            output: gets the lines.
            loop: watches the pipe.
        """
        super().__init__(fd, loop)
        self._name = name
        self._output = output
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._partial = ""

    def _read(self) -> bool | None:
        try:
            data = os.read(self._fd, READ_BYTES)
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
