"""A port whose device is a function, for tests of how a driver starts its device."""

from collections.abc import Callable

from robbie_robots.hw.connection.port import Port


class ScriptedPort(Port):
    """Gives what `answer` returns for each thing that the driver writes; `answer` also gets the bit rate."""

    def __init__(self, answer: Callable[[bytes, int], bytes], bit_rate: int = 0) -> None:
        self.url = "scripted"
        self.bit_rate = bit_rate
        self.written: list[bytes] = []
        self.motor_lines: list[bool] = []
        self._answer = answer
        self._waiting = b""

    def opened(self, _url: str, bit_rate: int) -> Port:
        self.bit_rate = bit_rate
        return self

    def read(self, wait_s: float) -> bytes:
        data, self._waiting = self._waiting, b""
        return data

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self._waiting += self._answer(data, self.bit_rate)

    def drain(self, quiet_s: float, limit_s: float) -> None:
        self._waiting = b""

    def set_bit_rate(self, bit_rate: int) -> None:
        self.bit_rate = bit_rate

    def set_motor_line(self, is_high: bool) -> None:
        self.motor_lines.append(is_high)

    def close(self) -> None:
        pass
