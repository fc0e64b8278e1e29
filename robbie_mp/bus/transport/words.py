"""Shared memory as an array of 8-byte words, of which every shared structure consists.

Processes read and write shared state one aligned word at a time, through an object that is indexed like a
list. In a robot that object is a memoryview over a segment, which stores a word with one machine instruction.
In a test it may count the stores, or stop after one.
"""

import struct
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Protocol

from robbie_mp.base.errors import RobbieError

WORD_BYTES = 8
WORD_MAX = (1 << 64) - 1


class UnsuitableMachine(RobbieError, RuntimeError):
    """This Python cannot read and write words of 64 bits in one step, with the byte order that others expect.

    Example scenarios:
      - a Python of 32 bits, as on 32-bit Raspberry Pi OS, also where the processor has 64
    """


def check_machine() -> None:
    """Check that this Python stores a word of shared memory in one step, in little-endian byte order.

    Raises:
        UnsuitableMachine: it does not.
    """
    if sys.byteorder != "little" or sys.maxsize.bit_length() + 1 < 8 * WORD_BYTES:
        raise UnsuitableMachine(
            f"this is a {sys.byteorder}-endian Python of {sys.maxsize.bit_length() + 1} bits, which may see "
            "half of what another process writes into shared memory; install a little-endian system and "
            "Python of 64 bits, as x86-64 or aarch64"
        )


class Words(Protocol):
    """An indexable array of unsigned 64-bit integers."""

    def __getitem__(self, index: int, /) -> int: ...
    def __setitem__(self, index: int, value: int, /) -> None: ...
    def __len__(self) -> int: ...


def new_fence() -> Callable[[], None]:
    """Return a memory fence: other processes see stores before a call earlier than stores after it.

    It orders loads likewise. CPython's lock is a POSIX semaphore or an atomic word; a post and a wait on it
    synchronise memory (POSIX.1-2017, 4.12). Python has no other way to order memory on every processor.
    Writer and reader both need a fence: the writer between a record and the head that publishes it, the
    reader between the head and the record. Each thread needs its own.
    """
    private = threading.Lock()
    private.acquire()
    post, wait = private.release, private.acquire

    def fence() -> None:
        post()
        wait()

    return fence


def row_writer(words: Words, count: int) -> Callable[..., None]:
    """Return `write(offset_bytes, *values)`, which stores `count` consecutive words in order.

    Over a memoryview this is one call of `struct`, whose native format stores each word in one step. It takes
    a third of the time of single stores.
    """
    if isinstance(words, memoryview):
        return partial(struct.Struct(f"@{count}Q").pack_into, words)

    def write(offset_bytes: int, *values: int) -> None:
        for at, value in enumerate(values, offset_bytes // WORD_BYTES):
            words[at] = value

    return write


def row_reader(words: Words, count: int) -> Callable[[int], tuple[int, ...]]:
    """Return `read(offset_bytes)`, which loads `count` consecutive words."""
    if isinstance(words, memoryview):
        return partial(struct.Struct(f"@{count}Q").unpack_from, words)

    def read(offset_bytes: int) -> tuple[int, ...]:
        at = offset_bytes // WORD_BYTES
        return tuple([words[index] for index in range(at, at + count)])

    return read


def write_text(words: Words, at: int, capacity_words: int, text: str) -> None:
    """Write a text into `capacity_words` words from `at`, cut off after the last character that fits.

    Half of a surrogate pair, as in a file name that is not UTF-8, is written as a Python escape: a status
    line must not end the process that shows it.
    """
    data = text.encode(errors="backslashreplace")[: (capacity_words - 1) * WORD_BYTES]
    data = data.decode(errors="ignore").encode()
    padded = data + bytes(-len(data) % WORD_BYTES)
    for index in range(0, len(padded), WORD_BYTES):
        words[at + 1 + index // WORD_BYTES] = int.from_bytes(padded[index : index + WORD_BYTES], "little")
    words[at] = len(data)


def read_text(words: Words, at: int, capacity_words: int) -> str:
    """Read a text. Any content of the memory gives a string of at most the capacity."""
    size = min(words[at], (capacity_words - 1) * WORD_BYTES)
    if not size:  # as most are, of those that the supervisor reads each second
        return ""
    count = (size + WORD_BYTES - 1) // WORD_BYTES
    data = b"".join(words[at + 1 + index].to_bytes(WORD_BYTES, "little") for index in range(count))
    return data[:size].decode(errors="replace")
