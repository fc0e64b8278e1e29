"""Decides what the core must do with a record, from the meaning of records and without the core's code."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.bus.transport.words import WORD_MAX

MESSAGE_BYTES = 1 << 20
"""The largest message that the simulated run allows."""
OFFSET_MAX = WORD_MAX >> 1


class Verdict(Enum):
    """The verdict that the core must give."""

    RIGHT = "take the record, and do not fault its module"
    WRONG = "fault the module, and do nothing else"
    OPEN = "either of these; it depends on how full the tables are"


@dataclass
class Standing:
    """The declarations and messages of an incarnation of the hostile module while its records were valid."""

    source: int
    """The source with which it must publish, with segment 0."""
    declared: int
    """Number of valid rows in its declarations, counted from the first."""
    advertised: set[int] = field(default_factory=set)
    """Numbers of the rows that it has advertised to the core as channels."""
    held: dict[int, int] = field(default_factory=dict)
    """References that it received and has not released, with their sequences."""
    done: set[int] = field(default_factory=set)
    """The held references that it has handled."""

    def judge(self, record: Sequence[int]) -> Verdict:
        """Judge a record."""
        kind, first, second, third, fourth, *_ = record
        match kind:
            case Outbound.READY | Outbound.WAIT_FREED | Outbound.MAKE_ROOM:
                return Verdict.RIGHT
            case Outbound.ADVERTISE | Outbound.SUBSCRIBE:
                return Verdict.OPEN if first < self.declared else Verdict.WRONG
            case Outbound.PUBLISH:
                is_own = second & layout.SOURCE_OF_INCARNATION == self.source
                fits = third <= OFFSET_MAX and fourth <= MESSAGE_BYTES
                return _verdict(first in self.advertised and is_own and fits)
            case Outbound.DONE:
                return _verdict(self.held.get(first) == second and first not in self.done)
            case Outbound.RELEASE:
                return _verdict(self.held.get(first) == second)
        return Verdict.WRONG

    def take(self, record: Sequence[int]) -> None:
        """Apply the changes of a record that the core took."""
        kind, first, *_ = record
        if kind == Outbound.ADVERTISE:
            self.advertised.add(first)
        elif kind == Outbound.DONE:
            self.done.add(first)
        elif kind == Outbound.RELEASE:
            del self.held[first]
            self.done.discard(first)


def _verdict(is_right: bool) -> Verdict:
    return Verdict.RIGHT if is_right else Verdict.WRONG
