"""The campaign's message: it names its sender and shows whether it has arrived whole."""

import zlib

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Message
from robbie_mp.messages.primitives import Array, uint8, uint32, uint64

NOISE_BYTES = 2 << 20
WHOLE_BYTES = 2 << 20
SAMPLE_BYTES = 64 << 10
SAMPLED = 16
"""The checksum of a payload larger than WHOLE_BYTES covers only every sixteenth piece of SAMPLE_BYTES and
the last bytes. Full checksums of a camera's images would take all of the processors' time."""


class Numbered(Message, name="campaign_msgs/msg/Numbered", version=1):
    """A numbered message with a checksum."""

    publisher: str  # name of the module
    incarnation: uint64  # counts the publisher's processes, from 1
    number: uint64  # counts what this incarnation tried to publish, from 0
    checksum: uint32  # CRC-32 over everything else
    payload: Array[uint8]  # (N,) noise


def checksum(publisher: str, incarnation: int, number: int, payload: NDArray[np.uint8]) -> int:
    """Return the CRC-32 of a message's contents."""
    found = zlib.crc32(f"{publisher} {incarnation} {number} {len(payload)}".encode())
    if len(payload) <= WHOLE_BYTES:
        return zlib.crc32(payload.data, found)
    for start in range(0, len(payload), SAMPLED * SAMPLE_BYTES):
        found = zlib.crc32(payload[start : start + SAMPLE_BYTES].data, found)
    return zlib.crc32(payload[-SAMPLE_BYTES:].data, found)


def is_whole(message: Numbered) -> bool:
    """Return whether a message's contents agree with its checksum."""
    expected = checksum(message.publisher, message.incarnation, message.number, message.payload)
    return bool(message.checksum == expected)


class Noise:
    """Payloads that differ from message to message.

    Args:
        largest_bytes: maximum size of a payload.
    """

    def __init__(self, largest_bytes: int) -> None:
        self._noise = np.frombuffer(np.random.default_rng(1).bytes(NOISE_BYTES + largest_bytes), np.uint8)

    def payload(self, incarnation: int, number: int, size: int) -> NDArray[np.uint8]:
        """Return `size` bytes, (N,), that differ from those of the neighbouring numbers."""
        start = (incarnation * 104_729 + number * 7_919) % NOISE_BYTES
        return self._noise[start : start + size]
