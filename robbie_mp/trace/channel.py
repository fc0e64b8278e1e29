"""How log records go from a child to the supervisor whole: one packet each, beside the child's output.

The child's end of a socket pair (SOCK_SEQPACKET) comes as an inherited descriptor whose number is in the
variable `ROBBIE_LOG_CHANNEL`. A packet goes or does not: a process that is killed leaves no half of one. A
child never waits for the supervisor: what finds no room is counted, and the count goes with the next packet.
Errors find room for longer than everything else, for they tell why a child ends.

The other way come packets with the lowest level that is to be logged, a number in ASCII; SIGURG, which does
nothing to who does not expect it, says that there is one.
"""

import array
import fcntl
import json
import logging
import os
import signal
import socket
import termios
import threading

CHANNEL_VARIABLE = "ROBBIE_LOG_CHANNEL"
BUFFER_BYTES = 212992
"""What an ordinary process may ask for on Linux (net.core.wmem_max); the kernel doubles it."""
DEFAULT_LEVEL = logging.INFO
"""What is logged as long as the supervisor has said nothing."""
PACKET_BYTES = 1 << 15
LEVEL_BYTES = 16
TEXT_CHARACTERS = 4096
TRACEBACK_CHARACTERS = 12288


def open_channel() -> tuple[socket.socket, socket.socket]:
    """Return the supervisor's end and the child's end, both non-blocking."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
    ours.setblocking(False)
    theirs.setblocking(False)
    return ours, theirs


class ChannelHandler(logging.Handler):
    """Sends log records to the supervisor.

    Attributes:
        dropped: records that found no room and are not reported yet.
    """

    def __init__(self, connection: socket.socket):
        super().__init__()
        self._socket = connection
        self._room_bytes = connection.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
        self._waiting_bytes = array.array("i", [0])
        self.dropped = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record or count it."""
        try:
            packet = self._packet(record)
        except Exception:  # its arguments do not fit its text, as logging allows
            self.handleError(record)
            return
        if record.levelno < logging.ERROR and self._is_filling():
            self.dropped += 1
        else:
            self.send(packet)

    def send(self, packet: bytes) -> bool:
        """Send a packet; False if it did not go, and was counted."""
        try:
            self._socket.send(packet)
        except OSError:
            self.dropped += 1
            return False
        self.dropped = 0
        return True

    def read_level(self) -> None:
        """Log from now on as the supervisor has last said, if it has."""
        try:
            while packet := self._socket.recv(LEVEL_BYTES):
                logging.getLogger().setLevel(int(packet))
        except OSError:
            return

    def close(self) -> None:
        """Say how many records were dropped at last; the socket stays open for who still logs."""
        if self.dropped:
            self.send(json.dumps({"dropped": self.dropped}).encode())
        super().close()

    def _is_filling(self) -> bool:
        fcntl.ioctl(self._socket.fileno(), termios.TIOCOUTQ, self._waiting_bytes)
        return self._waiting_bytes[0] > self._room_bytes // 4 * 3

    def _packet(self, record: logging.LogRecord) -> bytes:
        data: dict[str, object] = {
            "time_s": record.created,
            "level": record.levelno,
            "level_name": record.levelname,
            "logger": record.name,
            "where": f"{record.filename}:{record.lineno}",
        }
        if record.threadName != threading.main_thread().name:
            data["thread"] = record.threadName
        if self.dropped:
            data["dropped"] = self.dropped
        text, trace = record.getMessage(), _traceback(record)
        packet, longest = b"", TEXT_CHARACTERS
        while not packet or len(packet) > PACKET_BYTES:
            data["text"] = _head(text, longest)
            if trace:
                data["traceback"] = _tail(trace, longest * TRACEBACK_CHARACTERS // TEXT_CHARACTERS)
            # Half a surrogate pair is legal in a Python text; escaped like this it is so in JSON as well.
            packet = json.dumps(data, ensure_ascii=False).encode(errors="backslashreplace")
            longest //= 2
        return packet


def log_to_supervisor() -> ChannelHandler | None:
    """Have this process's log records sent to the supervisor; None if nobody has opened a channel for it.

    Also what the warnings module says, and exceptions that end a thread.
    """
    number = os.environ.pop(CHANNEL_VARIABLE, None)
    if number is None:
        return None
    connection = socket.socket(fileno=int(number))
    connection.set_inheritable(False)
    handler = ChannelHandler(connection)
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(DEFAULT_LEVEL)
    signal.signal(signal.SIGURG, lambda _signal, _frame: handler.read_level())
    handler.read_level()
    logging.captureWarnings(True)
    threading.excepthook = _log_thread_exception
    return handler


def _log_thread_exception(arguments: threading.ExceptHookArgs) -> None:
    if arguments.exc_type is SystemExit or arguments.exc_value is None:
        return
    name = arguments.thread.name if arguments.thread else "?"
    logging.getLogger("threading").error(
        "thread %s ended by an exception",
        name,
        exc_info=(arguments.exc_type, arguments.exc_value, arguments.exc_traceback),
    )


def _traceback(record: logging.LogRecord) -> str:
    parts = []
    if record.exc_info and record.exc_info != (None, None, None):
        parts.append(logging.Formatter().formatException(record.exc_info))
    if record.stack_info:
        parts.append(record.stack_info)
    return "\n".join(parts)


def _head(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[:longest]}… ({len(text) - longest} characters cut)"


def _tail(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"({len(text) - longest} characters cut) …{text[-longest:]}"
