"""Faults of a line between a device and its host, to order."""

import random
from dataclasses import dataclass

BITS_OF_A_BYTE = 8


@dataclass
class Faults:
    """Faults on the way from the device to the host. By default there are none.

    You can change each attribute at any time. Shares lie between 0 and 1.

    Attributes:
        cut_share: share of frames that lose a part, somewhere in them.
        bit_error_rate: share of the bits that arrive wrong.
        noise_share: share of frames with noise before them.
        noise_bytes: length of that noise.
        garbage_at_start: what a host receives first after it has opened the line.
        is_silent: the device hears nothing and sends nothing.
        bytes_per_s: speed of the line; None: as fast as the host reads.
        jitter_s: a frame is late by a random time between 0 and this.
        late_share: share of frames that are late by `late_s` besides.
        late_s: how much later they are.
        has_wrong_rate: the device's bit rate is not the host's, whatever either sets.
    """

    cut_share: float = 0.0
    bit_error_rate: float = 0.0
    noise_share: float = 0.0
    noise_bytes: int = 20
    garbage_at_start: bytes = b""
    is_silent: bool = False
    bytes_per_s: float | None = None
    jitter_s: float = 0.0
    late_share: float = 0.0
    late_s: float = 0.03
    has_wrong_rate: bool = False


class FaultyWay:
    """Applies faults to frames. The same seed gives the same faults."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self.faults = faults
        self.damaged = 0
        """Frames that did not arrive as they were sent."""
        self._random = random.Random(seed)

    def damage(self, frame: bytes) -> bytes:
        """Return what arrives of a frame: noise before it, a part missing, bits changed."""
        faults, chance = self.faults, self._random.random
        arrived = frame
        if frame and chance() < faults.cut_share:
            first, last = sorted(self._random.randrange(len(frame) + 1) for _ in range(2))
            arrived = frame[:first] + frame[max(last, first + 1) :]
        arrived = self._with_bit_errors(arrived)
        self.damaged += arrived != frame
        if chance() < faults.noise_share:
            arrived = self._random.randbytes(faults.noise_bytes) + arrived
        return arrived

    def delay_s(self) -> float:
        """Return how late the next frame is."""
        faults = self.faults
        late_s = faults.late_s if self._random.random() < faults.late_share else 0.0
        return late_s + self._random.uniform(0.0, faults.jitter_s)

    def scramble(self, data: bytes) -> bytes:
        """Return what a receiver makes of bytes that were sent at another bit rate."""
        return bytes(byte ^ self._random.randrange(1, 256) for byte in data)

    def _with_bit_errors(self, data: bytes) -> bytes:
        rate = self.faults.bit_error_rate
        if not rate:
            return data
        changed = bytearray(data)
        # The gaps between errors are geometrically distributed: no need to ask for each bit.
        at = int(self._random.expovariate(rate))
        while at < len(changed) * BITS_OF_A_BYTE:
            changed[at // BITS_OF_A_BYTE] ^= 1 << at % BITS_OF_A_BYTE
            at += 1 + int(self._random.expovariate(rate))
        return bytes(changed)
