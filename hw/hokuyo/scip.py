"""SCIP 2.0 to 2.2, the protocol of Hokuyo's laser range finders.

Source: Hokuyo Automatic Co., Communication Protocol Specification for SCIP2.0 Standard, C-42-03320B (2006 to
2008), sections 6 (encoding), 7 (checksums) and 8 (commands).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.connection.errors import DeviceFault

# The longest reply: 1440 steps with range and intensity take 9 kB.
MAX_REPLY_BYTES = 20_000
BLOCK_BYTES = 64
STATUS_BYTES = 2
OLDEST_COMMAND = b"SCIP2.0"
# The laser counts milliseconds in 24 bits.
STAMP_BITS = 24

# What the statuses mean (section 8 and appendix of the specification).
STATUSES = {
    "00": "accepted",
    "0A": "the laser cannot switch on",
    "0C": "the command is too short",
    "0D": "the command is too long",
    "0E": "no such command",
    "0F": "no such parameter",
    "0G": "no such user string",
    "0H": "the laser has broken down",
    "0L": "the laser does not work as it should",
    "10": "the laser refuses the command in its present state",
    "99": "a sweep follows",
}


class DamagedLine(DeviceFault):
    """A line was damaged in transmission: characters were lost or changed."""


@dataclass(frozen=True)
class ScipReply:
    """A reply of the laser, up to an empty line.

    Attributes:
        echo: the command that it answers; a sweep tells how many remain.
        status: two characters.
        lines: all further lines, with their checksums.
        arrived_s: when its first byte arrived.
    """

    echo: str
    status: str
    lines: list[bytes]
    arrived_s: float


@dataclass(frozen=True)
class Measurement:
    """The data of one sweep.

    Attributes:
        stamp_ms: by the laser's clock, which begins again after 2**24 ms.
        ranges_mm: (N,); below the laser's least range: an error code.
        intensities: (N,), or None if they were not asked for.
    """

    stamp_ms: int
    ranges_mm: NDArray[np.int64]
    intensities: NDArray[np.int64] | None


class ReplyReader:
    """Cuts what the laser sends into replies; what is damaged is counted and left out."""

    def __init__(self) -> None:
        self.damaged = 0
        self.skipped_bytes = 0
        self._buffer = b""
        self._began_s = 0.0

    def feed(self, data: bytes, arrived_s: float) -> list[ScipReply]:
        """Take bytes in pieces of any length; return the replies that are whole now."""
        if not self._buffer.strip(b"\n"):
            self._began_s = arrived_s
        *whole, self._buffer = (self._buffer + data).split(b"\n\n")
        replies = []
        for text in whole:
            try:
                replies.append(reply_of(text.lstrip(b"\n"), self._began_s))
            except DamagedLine:
                self.damaged += 1
                self.skipped_bytes += len(text)
            self._began_s = arrived_s
        if len(self._buffer) > MAX_REPLY_BYTES:
            self.damaged += 1
            self.forget()
        return replies

    def forget(self) -> None:
        """Forget half a reply."""
        self.skipped_bytes += len(self._buffer)
        self._buffer = b""


def reply_of(text: bytes, arrived_s: float = 0.0) -> ScipReply:
    """Return a reply from its lines.

    Raises:
        DamagedLine: there is no status, or its checksum is wrong.
    """
    echo, *lines = text.split(b"\n")
    if not lines:
        raise DamagedLine(f"a reply without a status: {text[:80]!r}")
    # SCIP 1.1 lasers answer with a status without checksum.
    status = lines[0] if echo == OLDEST_COMMAND else without_checksum(lines[0])
    if len(status) != STATUS_BYTES and echo != OLDEST_COMMAND:
        raise DamagedLine(f"a status of {len(status)} characters")
    return ScipReply(echo.decode("ascii", "replace"), status.decode("ascii", "replace"), lines[1:], arrived_s)


def measurement(reply: ScipReply) -> Measurement:
    """Return the data of a sweep: GD, GS, MD, MS, GE or ME, told by its echo.

    Raises:
        DamagedLine: a checksum or a character is wrong, or one is missing.
    """
    if not reply.lines:
        raise DamagedLine("a sweep without a time stamp")
    stamp = numbers(without_checksum(reply.lines[0]), 4)
    if len(stamp) != 1:
        raise DamagedLine(f"a time stamp of {len(reply.lines[0]) - 1} characters")
    if any(len(line) != BLOCK_BYTES + 1 for line in reply.lines[1:-1]):
        raise DamagedLine("a block of data has lost characters")
    data = b"".join(map(without_checksum, reply.lines[1:]))
    kind = reply.echo[1:2]
    values = numbers(data, 2 if kind == "S" else 3)
    if kind != "E":
        return Measurement(int(stamp[0]), values, None)
    if len(values) % 2:
        raise DamagedLine("a range without an intensity")
    return Measurement(int(stamp[0]), values[0::2], values[1::2])


def meaning(status: str) -> str:
    """Return what a status means, in plain words."""
    known = STATUSES.get(status)
    return f"status {status}" + (f" ({known})" if known else "")


def checksum(text: bytes) -> bytes:
    """Return the checksum character of a text: the lowest six bits of its sum."""
    return bytes([(sum(text) & 0x3F) + 0x30])


def without_checksum(line: bytes) -> bytes:
    """Return a line without the checksum at its end.

    Raises:
        DamagedLine: the checksum is wrong.
    """
    text, told = line[:-1], line[-1:]
    if checksum(text) != told:
        raise DamagedLine(f"damaged line from the laser: {line!r} should end with {checksum(text)!r}")
    return text


def numbers(text: bytes, characters: int = 3) -> NDArray[np.int64]:
    """Decode numbers of some characters each, six bits in each character.

    Raises:
        DamagedLine: a character is missing, or one is not a valid digit.
    """
    digits = np.frombuffer(text, np.uint8).astype(np.int64) - 0x30
    if len(digits) % characters or (len(digits) and not 0 <= digits.min() <= digits.max() < 64):
        raise DamagedLine(
            f"{len(text)} characters from the laser are not numbers of {characters} characters each"
        )
    values: NDArray[np.int64] = digits.reshape(-1, characters) @ (64 ** np.arange(characters)[::-1])
    return values


def parameters(lines: Iterable[bytes]) -> dict[str, str]:
    """Parse the answer to the commands PP, VV or II: `NAME:value;` and a checksum in each line.

    Raises:
        DamagedLine: a line has another form or checksum.
    """
    found = {}
    for line in lines:
        text, separator, told = line.rpartition(b";")
        name, colon, value = text.partition(b":")
        if not (separator and colon) or checksum(text) != told:
            raise DamagedLine(f"damaged parameter from the laser: {line!r}")
        found[name.decode("ascii", "replace")] = value.decode("ascii", "replace").strip()
    return found
