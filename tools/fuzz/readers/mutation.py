"""Damages valid inputs: faults of a line, numbers that lie, other words, blocks that moved or are missing."""

from random import Random

from tools.fuzz.decoders.fuzz import damage

LYING = (0, 1, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, (1 << 63) - 1, (1 << 64) - 1)
FAULTS = (1, 1, 1, 2, 4)
"""Mostly one: an input with many is refused at the first."""
WORDS = (
    b"nan",
    b"-inf",
    b"1e999",
    b"-1",
    b"0",
    b"",
    b"9" * 40,
    b"1_000",
    b"\xff\xfe",
    b"\0",
    b"\r\n",
    b"../",
)


def mutated(data: bytes, random: Random, tokens: tuple[bytes, ...]) -> bytes:
    """Return a valid input with a few faults.

    Args:
        data: the valid input.
        random: decides.
        tokens: words that mean something to the reader.
    """
    for _ in range(random.choice(FAULTS)):
        match random.randrange(6):
            case 0 | 1:
                data = damage(data, random)
            case 2:
                data = _with_lying_number(data, random)
            case 3:
                data = _with_word(data, random, (*WORDS, *tokens))
            case 4:
                data = _with_moved_block(data, random)
            case _ if not random.randrange(4):
                data = data[: random.randrange(len(data) + 1)]
    return data


def _with_lying_number(data: bytes, random: Random) -> bytes:
    size, number = random.choice((1, 2, 4, 8)), random.choice(LYING)
    at = random.randrange(len(data) + 1)
    coded = (number & ((1 << 8 * size) - 1)).to_bytes(size, random.choice(("little", "big")))
    return data[:at] + coded + data[at + size :]


def _with_word(data: bytes, random: Random, words: tuple[bytes, ...]) -> bytes:
    """Put a word in the place of another, as far as the input has words."""
    at = random.randrange(len(data) + 1)
    end = at
    while end < len(data) and end - at < 20 and data[end : end + 1].isalnum():
        end += 1
    return data[:at] + random.choice(words) + data[end:]


def _with_moved_block(data: bytes, random: Random) -> bytes:
    begin, length = random.randrange(len(data) + 1), random.randint(1, 200)
    block, at = data[begin : begin + length], random.randrange(len(data) + 1)
    return data[:at] + block * random.randint(1, 3) + data[at:]
