"""The protocol of Slamtec's RPLidar A and S series.

Source: Shanghai Slamtec, RPLIDAR Interface Protocol and Application Notes.
"""

from dataclasses import dataclass

START = b"\xa5"
REPLY = b"\xa5\x5a"
STOP = 0x25
RESET = 0x40
SCAN = 0x20
GET_INFO = 0x50
GET_HEALTH = 0x52
GET_SAMPLE_TIMES = 0x59
EXPRESS_SCAN = 0x82
MOTOR_PWM = 0xF0

DESCRIPTOR_BYTES = 7
LENGTH_BITS = 30
INFO, HEALTH, SAMPLE_TIMES, NODES, CAPSULES = 0x04, 0x06, 0x15, 0x81, 0x82
NODE_BYTES = 5
CAPSULE_BYTES = 84
CABINS = 16
SAMPLES_OF_A_CAPSULE = 2 * CABINS
FULL_TURN_DEG = 360.0
# Nodes in a row that must look right before the reader believes to be in step: noise often looks like one.
NODES_IN_STEP = 3


@dataclass(frozen=True)
class Sample:
    """One measurement.

    Attributes:
        angle_deg: clockwise seen from above, 0 ahead.
        distance_mm: 0: no return.
        quality: strength of the return, 0 to 63; 0 if it is not told.
        is_first: a new turn begins here.
    """

    angle_deg: float
    distance_mm: float
    quality: int
    is_first: bool


@dataclass(frozen=True)
class Descriptor:
    """The kind of reply that follows."""

    length: int
    is_stream: bool
    kind: int


def request(command: int, payload: bytes = b"") -> bytes:
    """Return the bytes of a command."""
    frame = START + bytes([command])
    if not payload:
        return frame
    frame += bytes([len(payload)]) + payload
    return frame + bytes([_xor(frame)])


def descriptor(data: bytes) -> Descriptor | None:
    """Return what the seven bytes of a reply's descriptor say, or None if they are none."""
    if len(data) < DESCRIPTOR_BYTES or not data.startswith(REPLY):
        return None
    word = int.from_bytes(data[2:6], "little")
    return Descriptor(word & ((1 << LENGTH_BITS) - 1), word >> LENGTH_BITS == 1, data[6])


class NodeReader:
    """Cuts the stream of SCAN into samples of five bytes. They have two check bits and no checksum."""

    def __init__(self) -> None:
        self.damaged = 0
        self.skipped_bytes = 0
        self._buffer = b""
        self._is_in_step = False

    def feed(self, data: bytes) -> list[Sample]:
        """Take bytes in pieces of any length; return the samples that are whole now."""
        buffer = self._buffer + data
        samples, at = [], 0
        while len(buffer) - at >= NODE_BYTES * (1 if self._is_in_step else NODES_IN_STEP):
            nodes = 1 if self._is_in_step else NODES_IN_STEP
            if all(_is_node(buffer, at + NODE_BYTES * number) for number in range(nodes)):
                self._is_in_step = True
                samples.append(_node(buffer, at))
                at += NODE_BYTES
                continue
            self.damaged += self._is_in_step
            self._is_in_step = False
            self.skipped_bytes += 1
            at += 1
        self._buffer = buffer[at:]
        return samples

    def forget(self) -> None:
        """Forget half a sample."""
        self.skipped_bytes += len(self._buffer)
        self._buffer, self._is_in_step = b"", False


class CapsuleReader:
    """Cuts the stream of EXPRESS_SCAN into capsules of 32 samples, which have a checksum.

    The angles of a capsule's samples lie between its own and that of the next one, so a capsule's samples
    come when the next one is there.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self.skipped_bytes = 0
        self._buffer = b""
        self._last: bytes | None = None

    def feed(self, data: bytes) -> list[Sample]:
        """Take bytes in pieces of any length; return the samples whose angles are known now."""
        buffer = self._buffer + data
        samples: list[Sample] = []
        at = 0
        while len(buffer) - at >= CAPSULE_BYTES:
            capsule = buffer[at : at + CAPSULE_BYTES]
            if not _is_capsule(capsule):
                if capsule[0] >> 4 == 0xA and capsule[1] >> 4 == 0x5:
                    self.damaged += 1
                    self._last = None
                self.skipped_bytes += 1
                at += 1
                continue
            if capsule[3] & 0x80:
                self._last = None  # the scan has started anew
            if self._last is not None:
                samples += _samples(self._last, capsule)
            self._last = capsule
            at += CAPSULE_BYTES
        self._buffer = buffer[at:]
        return samples

    def forget(self) -> None:
        """Forget half a capsule."""
        self.skipped_bytes += len(self._buffer)
        self._buffer, self._last = b"", None


def _is_node(data: bytes, at: int) -> bool:
    first, second = data[at], data[at + 1]
    if first & 1 == first >> 1 & 1 or not second & 1:
        return False
    # 360 degrees in steps of 1/64.
    return (second >> 1 | data[at + 2] << 7) <= FULL_TURN_DEG * 64


def _node(data: bytes, at: int) -> Sample:
    angle = (data[at + 1] >> 1 | data[at + 2] << 7) / 64
    distance = int.from_bytes(data[at + 3 : at + 5], "little") / 4
    return Sample(angle, distance, data[at] >> 2, bool(data[at] & 1))


def _is_capsule(capsule: bytes) -> bool:
    if capsule[0] >> 4 != 0xA or capsule[1] >> 4 != 0x5:
        return False
    return _xor(capsule[2:]) == (capsule[0] & 15 | (capsule[1] & 15) << 4)


def _samples(capsule: bytes, following: bytes) -> list[Sample]:
    """Return the 32 samples of a capsule.

    Each cabin holds two: distances in mm with 14 bits above two bits, and offsets of the angles in eighths of
    a degree, signed, whose low four bits come last.
    """
    start = _start_deg(capsule)
    step = (_start_deg(following) - start) % FULL_TURN_DEG / SAMPLES_OF_A_CAPSULE
    samples, before = [], start
    for number in range(SAMPLES_OF_A_CAPSULE):
        at = 4 + NODE_BYTES * (number // 2)
        half = number % 2
        word = int.from_bytes(capsule[at + 2 * half : at + 2 * half + 2], "little")
        low = capsule[at + 4] >> 4 * half & 15
        offset = (word & 1) << 4 | low
        sign = -1 if word >> 1 & 1 else 1
        swept = start + step * number
        # Whole turns are counted by the direction of the beam, which only grows.
        is_first = int(swept // FULL_TURN_DEG) > int(before // FULL_TURN_DEG)
        before = swept
        samples.append(Sample((swept - sign * offset / 8) % FULL_TURN_DEG, word >> 2, 0, is_first))
    if start + step * SAMPLES_OF_A_CAPSULE >= FULL_TURN_DEG > before and not any(
        sample.is_first for sample in samples
    ):
        # The turn ends exactly between two capsules.
        samples[-1] = Sample(samples[-1].angle_deg, samples[-1].distance_mm, 0, True)
    return samples


def _start_deg(capsule: bytes) -> float:
    return ((capsule[2] | capsule[3] << 8) & 0x7FFF) / 64


def _xor(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
    return value
