"""The form of an input: steps of eight bytes, so that a mutation changes one step and not the others."""

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

STEP_BYTES = 8
MAX_STEPS = 100


class Do(IntEnum):
    """The kind of a step. Larger numbers are taken modulo."""

    RECORD = 0
    """Push a record with up to two words changed, and check how the core judges it."""
    SCRIBBLE = 1
    """Write any word to any place in the hostile module's segment."""
    CORE = 2
    PUBLISH = 3
    """The innocent publisher publishes."""
    HANDLE = 4
    """The innocent subscriber handles its messages."""
    BEHAVE = 5
    """The hostile module publishes and handles messages correctly."""
    DECLARE = 6
    CORE_DIES = 7
    """The core dies in its next steps; a word is overwritten before the next core reads it."""
    RESTART_CORE = 8
    RESTART_HOSTILE = 9


class Step(NamedTuple):
    """One step: what it does, and up to seven numbers of one byte each."""

    what: Do
    numbers: bytes

    def encode(self) -> bytes:
        """Return the step as bytes."""
        return bytes([self.what]) + self.numbers[: STEP_BYTES - 1].ljust(STEP_BYTES - 1, b"\xff")


def step(what: Do, *numbers: int) -> Step:
    """Make a step. Numbers that are not given are 255, which means unused."""
    return Step(what, bytes(numbers).ljust(STEP_BYTES - 1, b"\xff"))


def encode(*steps: Step) -> bytes:
    """Make an input from steps."""
    return b"".join(one.encode() for one in steps)


def decode(data: bytes) -> Iterator[Step]:
    """Yield the steps of an input. An incomplete last step is ignored."""
    for at in range(0, min(len(data) // STEP_BYTES, MAX_STEPS) * STEP_BYTES, STEP_BYTES):
        yield Step(Do(data[at] % len(Do)), data[at + 1 : at + STEP_BYTES])
