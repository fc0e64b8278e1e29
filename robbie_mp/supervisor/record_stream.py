"""Cuts what comes through a child's log channel into lines; see `robbie_mp.trace.channel`."""

import os

from robbie_mp.supervisor.child_stream import ChildStream
from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.output import ChildOutput
from robbie_mp.trace.channel import LINE_BYTES

READ_BYTES = 1 << 14


class RecordStream(ChildStream):
    """The log channel of one incarnation."""

    def __init__(self, fd: int, output: ChildOutput, loop: EventLoop):
        """Watch the channel from now on.

        Args:
            fd: the supervisor's end; owned from now on.
            output: gets the records.
            loop: watches the channel.
        """
        super().__init__(fd, loop)
        self._output = output
        self._partial = b""

    def _read(self) -> bool | None:
        try:
            data = os.read(self._fd, READ_BYTES)
        except BlockingIOError:
            return None
        if not data:
            self._close()
            return True
        *lines, self._partial = (self._partial + data).split(b"\n")
        if len(self._partial) > LINE_BYTES:  # which no handler of ours sends
            lines.append(self._partial)
            self._partial = b""
        return self._output.add_records(lines)

    def _flush(self) -> None:
        if self._partial:
            self._output.add_records([self._partial])
