"""Damages frames and feeds them to a decoder, with intact ones behind."""

from collections.abc import Callable, Sequence
from random import Random
from typing import Any, NamedTuple, Protocol

MAX_LOST_FRAMES = 2
CLEAN_FRAMES = 5
MAX_FAILURES = 10


class FuzzedDecoder(Protocol):
    """Anything that takes bytes and returns what they mean."""

    def feed(self, data: bytes, /) -> Sequence[Any]:
        """Add bytes; return the frames that are now complete."""


class DecoderUnderTest(NamedTuple):
    """A decoder under test.

    Attributes:
        decoder: makes one.
        frame: returns the bytes of an intact frame.
    """

    decoder: Callable[[], FuzzedDecoder]
    frame: Callable[[Random], bytes]


class DecoderResult(NamedTuple):
    """The result for one decoder.

    Attributes:
        damaged_bytes: bytes of damaged frames that the decoder received.
        rounds: how often frames were damaged.
        most_lost: the most intact frames that were lost after one damage.
        failures: what went wrong, in words; at most `MAX_FAILURES`.
    """

    damaged_bytes: int
    rounds: int
    most_lost: int
    failures: list[str]


def fuzz(subject: DecoderUnderTest, damaged_bytes: int, seed: int = 0) -> DecoderResult:
    """Feed one decoder with damaged frames, and each time with intact ones behind.

    Every intact frame behind the first `MAX_LOST_FRAMES` must come out as soon as its last byte goes in.
    """
    random, decoder = Random(seed), subject.decoder()
    fed = rounds = most_lost = 0
    failures: list[str] = []
    while fed < damaged_bytes and len(failures) < MAX_FAILURES:
        damaged = damage(b"".join(subject.frame(random) for _ in range(random.randint(1, 3))), random)
        clean = [subject.frame(random) for _ in range(CLEAN_FRAMES)]
        rounds += 1
        fed += len(damaged)
        try:
            for piece in _pieces(damaged, random):
                decoder.feed(piece)
            witness = subject.decoder()
            came = [_same(decoder.feed(frame), witness.feed(frame)) for frame in clean]
        except Exception as error:
            failures.append(f"round {rounds}: {error!r} after {damaged.hex(' ')}")
            decoder = subject.decoder()
            continue
        lost = len(came) - came[::-1].index(False) if False in came else 0
        most_lost = max(most_lost, lost)
        if lost > MAX_LOST_FRAMES:
            failures.append(f"round {rounds}: {lost} intact frames lost after {damaged.hex(' ')}")
    return DecoderResult(fed, rounds, most_lost, failures)


def damage(data: bytes, random: Random) -> bytes:
    """Return the bytes with up to four faults of a line: flipped, lost, repeated or foreign bytes."""
    damaged = bytearray(data)
    for _ in range(random.randint(1, 4)):
        position = random.randrange(len(damaged) + 1)
        length = random.randint(1, 8)
        match random.randrange(6):
            case 0 if position < len(damaged):
                damaged[position] ^= 1 << random.randrange(8)
            case 1:
                del damaged[position : position + length]
            case 2:
                damaged[position:position] = damaged[position : position + length]
            case 3:
                damaged[position:position] = random.randbytes(length)
            case 4:
                damaged[position : position + length] = bytes([random.choice((0, 0xFF))]) * length
            case _:
                # The beginning of a frame, which promises more than comes.
                damaged[position:position] = data[:length]
    return bytes(damaged)


def _same(found: Sequence[Any], expected: Sequence[Any]) -> bool:
    """Return whether the newest frame is the expected one; after damage, older ones may come before it."""
    return bool(found and expected) and repr(found[-1]) == repr(expected[-1])


def _pieces(data: bytes, random: Random) -> list[bytes]:
    """Return the bytes cut at a random place, as a serial port may deliver them."""
    cut = random.randrange(len(data) + 1)
    return [data[:cut], data[cut:]]
