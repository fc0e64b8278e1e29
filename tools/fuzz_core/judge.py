"""What the core must make of a record: said again here, from what the records mean and not from the core."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from robbie_mp.transport import layout
from robbie_mp.transport.records import Outbound
from robbie_mp.transport.words import WORD_MAX

MESSAGE_BYTES = 1 << 20
"""The largest message that the simulated run allows."""
OFFSET_MAX = WORD_MAX >> 1


class Verdict(Enum):
    """What must follow."""

    RIGHT = "it is taken, and its module is not faulted"
    WRONG = "its module is faulted, and nothing else happens"
    OPEN = "either; it depends on how full the tables are"


@dataclass
class Standing:
    """What an incarnation of the hostile module has said and been given, as long as all of that was right."""

    source: int
    """As it must name itself, segment 0."""
    declared: int
    """Rows of its declarations that make sense, the first ones."""
    advertised: set[int] = field(default_factory=set)
    """Numbers of those that the core was told of as channels."""
    held: dict[int, int] = field(default_factory=dict)
    """References and sequences that it was given and has not let go of."""
    done: set[int] = field(default_factory=set)
    """Those of them that it has handled."""

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
        """Note what a record that was taken has changed."""
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
