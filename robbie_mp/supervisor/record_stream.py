"""Takes the packets of a child's log channel; see `robbie_mp.trace.channel`."""

import contextlib
import socket

from robbie_mp.supervisor.child_stream import ChildStream
from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.output import ChildOutput
from robbie_mp.trace.channel import PACKET_BYTES

PACKETS_AT_ONCE = 64


class RecordStream(ChildStream):
    """The log channel of one incarnation."""

    def __init__(self, connection: socket.socket, output: ChildOutput, loop: EventLoop):
        """Watch the channel from now on.

        Args:
            connection: the supervisor's end; owned from now on.
            output: gets the packets.
            loop: watches the channel.
        """
        self._socket = connection
        self._output = output
        super().__init__(connection.fileno(), loop)

    def set_level(self, level: int) -> None:
        """Tell the child the lowest level that is to be logged; it looks when it gets SIGURG."""
        with contextlib.suppress(OSError):
            self._socket.send(b"%d" % level)

    def _read(self) -> bool | None:
        packets: list[bytes] = []
        while self._is_open and len(packets) < PACKETS_AT_ONCE:
            try:
                packet = self._socket.recv(PACKET_BYTES + 1)
            except BlockingIOError:
                break
            except ConnectionResetError:  # it ended before it read what we told it
                packet = b""
            if not packet:
                self._close()
                break
            packets.append(packet)
        if not packets:
            return None if self._is_open else True
        return self._output.add_records(packets)

    def _close(self) -> None:
        if self._is_open:
            super()._close()
            self._socket.detach()
