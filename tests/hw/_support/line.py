"""A line without a device: a test plays the device."""

from collections.abc import Callable

LIMIT_S = 10.0


class ScriptedDevice:
    """Answers to exact bytes, and keeps what it was sent. It serves as a port of the driver."""

    descriptor: int | None = None

    def __init__(self, answers: dict[bytes, bytes] | None = None) -> None:
        self.answers = answers or {}
        self.written = b""
        self.is_broken = False
        self.wait: Callable[[float], None] = lambda wait_s: None
        """Passes the time for which a read without data waits."""
        self._to_read = b""

    def read(self, wait_s: float) -> bytes:
        if self.is_broken:
            raise OSError("pulled out")
        data, self._to_read = self._to_read, b""
        if not data:
            self.wait(wait_s)
        return data

    def write(self, data: bytes) -> None:
        if self.is_broken:
            raise OSError("pulled out")
        self.written += data
        self._to_read += self.answers.get(data, b"")

    def send(self, data: bytes) -> None:
        """Let the driver read this."""
        self._to_read += data

    def taken(self) -> bytes:
        """Return what was written since the last call."""
        written, self.written = self.written, b""
        return written

    def drain(self, quiet_s: float, limit_s: float) -> None:
        self._to_read = b""

    def close(self) -> None:
        pass


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def pass_time(self, passed_s: float) -> None:
        self.now_s += max(0.0, passed_s)
