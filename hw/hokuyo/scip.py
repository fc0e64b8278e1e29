"""SCIP 2.0, the protocol of Hokuyo's laser range finders.

Source: Hokuyo Automatic Co., Communication Protocol Specification for SCIP2.0 Standard, C-42-03320B (2006 to
2008), sections 6 (encoding), 7 (checksums) and 8 (commands).
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray


class LaserFault(OSError):
    """The laser reports an error, or its answer is not valid."""


class DamagedLine(LaserFault):
    """A line was damaged in transmission: characters were lost or changed."""


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


def numbers(text: bytes) -> NDArray[np.int64]:
    """Decode numbers of three characters each, six bits in each character.

    Raises:
        DamagedLine: a character is missing, or one is not a valid digit.
    """
    digits = np.frombuffer(text, np.uint8).astype(np.int64) - 0x30
    if len(digits) % 3 or (len(digits) and not 0 <= digits.min() <= digits.max() < 64):
        raise DamagedLine(f"{len(text)} characters from the laser are not numbers of three characters each")
    values: NDArray[np.int64] = digits.reshape(-1, 3) @ np.array([4096, 64, 1])
    return values


def parameters(lines: Iterable[bytes]) -> dict[str, str]:
    """Parse the answer to the command PP: `NAME:value;` and a checksum in each line.

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
