"""The protocol of Slamtec's RPLidar A and S series: requests, answers and scan modes.

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
GET_CONFIGURATION = 0x84
MOTOR_PWM = 0xF0

DESCRIPTOR_BYTES = 7
LENGTH_BITS = 30
INFO, HEALTH, SAMPLE_TIMES, CONFIGURATION = 0x04, 0x06, 0x15, 0x20
NODES, CAPSULES, HQ_CAPSULES, ULTRA_CAPSULES, DENSE_CAPSULES = 0x81, 0x82, 0x83, 0x84, 0x85

# What GET_CONFIGURATION can ask for; all but the first two also need the number of a scan mode.
MODE_COUNT, TYPICAL_MODE = 0x70, 0x7C
MODE_SAMPLE_TIME, MODE_ANSWER, MODE_NAME = 0x71, 0x75, 0x7F
# Sample times of scan modes are told in 1/256 microseconds.
SAMPLE_TIME_UNIT_S = 1e-6 / 256


@dataclass(frozen=True)
class ScanMode:
    """A way in which a laser can measure.

    Attributes:
        number: by which it is started.
        name: as the laser tells it: "Standard", "Boost", "DenseBoost".
        answer: the kind of its stream: `NODES`, `CAPSULES` and so on.
        sample_s: time between samples.
    """

    number: int
    name: str
    answer: int
    sample_s: float


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


def _xor(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
    return value
