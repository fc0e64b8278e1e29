"""A laser with SCIP 2.0 on a pseudo-terminal, written from the specification, without the driver's code."""

import os
import select
import tty
from threading import Thread

# The specification's example of an answer to PP; only its checksums are computed here.
PARAMETERS = {
    "MODL": "URG-04LX(Hokuyo Automatic Co., Ltd.)",
    "DMIN": "20",
    "DMAX": "5600",
    "ARES": "1024",
    "AMIN": "44",
    "AMAX": "725",
    "AFRT": "384",
    "SCAN": "600",
}


def summed(text: str) -> str:
    total = 0
    for character in text:
        total += ord(character)
    return text + chr(total % 64 + 48)


def three_characters(value: int) -> str:
    return "".join(chr(value // 64**place % 64 + 48) for place in (2, 1, 0))


def sweep(request: str, millimetres: list[int], status: str = "99", stamp: str = "0000") -> str:
    """Return the laser's bytes for a sweep."""
    two = request.startswith("MS")
    data = "".join(three_characters(value)[two:] for value in millimetres)
    blocks = [data[begin : begin + 64] for begin in range(0, len(data), 64)]
    lines = [request, summed(status)]
    if status == "99":
        lines += [summed(stamp), *map(summed, blocks)]
    return "\n".join(lines) + "\n\n"


class FakeHokuyo:
    """Answers commands in a thread; after MD it sends what it was given, and then nothing.

    The greeting comes before the first answer, like the rest of a stream.
    """

    def __init__(self, parameters: dict[str, str] = PARAMETERS, greeting: str = "") -> None:
        self.parameters = parameters
        self.to_send: list[str] = []
        self.heard: list[str] = []
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._wake_read, self._wake_write = os.pipe()
        self._greeting = greeting
        self._thread = Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        os.write(self._wake_write, b"x")
        self._thread.join()
        for descriptor in (self._master, self._slave, self._wake_read, self._wake_write):
            os.close(descriptor)

    def _serve(self) -> None:
        received = ""
        while True:
            ready, _, _ = select.select([self._master, self._wake_read], [], [])
            if self._wake_read in ready:
                return
            received += os.read(self._master, 4096).decode()
            *commands, received = received.split("\n")
            for command in commands:
                self.heard.append(command)
                self._send(self._answer(command).encode())

    def _send(self, data: bytes) -> None:
        """Send as the other side reads; give up when it is to end."""
        while data:
            woken, _, _ = select.select([self._wake_read], [self._master], [])
            if woken:
                return
            data = data[os.write(self._master, data[:256]) :]

    def _answer(self, command: str) -> str:
        if command == "SCIP2.0":
            return self._greeting + "SCIP2.0\n0\n\n"
        if command == "PP":
            lines = [summed(f"{name}:{value}") for name, value in self.parameters.items()]
            return "\n".join(["PP", "00P", *(f"{line[:-1]};{line[-1]}" for line in lines)]) + "\n\n"
        if command in ("QT", "BM"):
            return f"{command}\n00P\n\n"
        if command == "VV":
            return "VV\n00P\nSERI:H0706400;F\n\n"
        if command.startswith("M"):
            return f"{command}\n00P\n\n" + "".join(self.to_send)
        return f"{command}\n{summed('0D')}\n\n"
