"""The form of an input: steps of eight bytes, so that a mutation changes one step and leaves the others."""

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

STEP_BYTES = 8
MAX_STEPS = 100


class Do(IntEnum):
    """What a step does; other numbers are taken modulo."""

    RECORD = 0
    """Push a record that is right but for up to two of its words, and see that the core judges it rightly."""
    SCRIBBLE = 1
    """Write any word anywhere into the hostile module's segment."""
    CORE = 2
    PUBLISH = 3
    """The innocent publisher publishes."""
    HANDLE = 4
    """The innocent subscriber handles what it has."""
    BEHAVE = 5
    """The hostile module publishes and handles in due form."""
    DECLARE = 6
    CORE_DIES = 7
    """In its next steps, with a word written over before its successor looks."""
    RESTART_CORE = 8
    RESTART_HOSTILE = 9


class Step(NamedTuple):
    """One step: what, and up to seven numbers of one byte each."""

    what: Do
    numbers: bytes

    def encode(self) -> bytes:
        """Return its bytes."""
        return bytes([self.what]) + self.numbers[: STEP_BYTES - 1].ljust(STEP_BYTES - 1, b"\xff")


def step(what: Do, *numbers: int) -> Step:
    """Make a step; numbers that are not given are 255, which means nothing."""
    return Step(what, bytes(numbers).ljust(STEP_BYTES - 1, b"\xff"))


def encode(*steps: Step) -> bytes:
    """Make an input."""
    return b"".join(one.encode() for one in steps)


def decode(data: bytes) -> Iterator[Step]:
    """Read an input; a last step that is cut short does not count."""
    for at in range(0, min(len(data) // STEP_BYTES, MAX_STEPS) * STEP_BYTES, STEP_BYTES):
        yield Step(Do(data[at] % len(Do)), data[at + 1 : at + STEP_BYTES])
