"""The segments that one incarnation of a module shares with the core, mapped read-only and kept mapped."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import ModulePhase, SegmentKind
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.tables import ChannelName, DeclarationRow
from robbie_mp.bus.transport.words import WORD_BYTES

NO_WORDS = [0] * layout.OUT_DECLARATIONS


class Punctuality(NamedTuple):
    """How the messages of a subscription come: words that its process has written. Times are in ns."""

    newest_ns: int
    """When the newest one was published, monotonic clock; 0: none has come."""
    deadline_ns: int
    """Greatest age that is allowed; 0: any."""
    latenesses: int
    greatest_age_ns: int


class ModuleMemory:
    """The memory of one incarnation of a module that observers can read."""

    def __init__(self, run_id: str, slot: int, incarnation: int):
        self.incarnation = incarnation
        self._out = self._in = None
        if incarnation:
            self._out = _attach(names.outbound(run_id, slot, incarnation), SegmentKind.OUT)
            self._in = _attach(names.inbound(run_id, slot, incarnation), SegmentKind.IN)
        self._declared = 0
        self.publishes: list[ChannelName] = []
        self.needs: list[ChannelName] = []
        """Its subscriptions without the optional ones."""
        self._numbers: dict[ChannelName, int] = {}
        self.topics: dict[str, str] = {}
        """The names of its topics in the run, by its own names."""

    @property
    def is_there(self) -> bool:
        """Whether both segments could be mapped."""
        return self._out is not None and self._in is not None

    @property
    def is_ready(self) -> bool:
        """Whether the module has finished its setup."""
        return self._out is not None and self._out.words[layout.OUT_READY] == ModulePhase.READY

    def close(self) -> None:
        """Unmap the segments."""
        for segment in (self._out, self._in):
            if segment is not None:
                segment.close()

    def own_words(self) -> list[int]:
        """A copy of the words before the declarations, taken at one moment; zeros without a segment."""
        return self._out.copy(0, layout.OUT_DECLARATIONS) if self._out else NO_WORDS

    def histograms(self) -> NDArray[np.uint64]:
        """A copy of the histograms; empty without a segment."""
        if self._out is None:
            return np.zeros(0, np.uint64)
        at = layout.OUT_MESSAGE_FIGURES
        return np.frombuffer(self._out.buffer, np.uint64, layout.OUT_RING - at, at * WORD_BYTES).copy()

    def outbound(self, head: int) -> tuple[int, int]:
        """Records in the outbound ring that the core has not read yet, and the ring's capacity."""
        if self._out is None or self._in is None:
            return 0, 0
        capacity = (self._out.size // 8 - layout.OUT_RING) // layout.RECORD_WORDS
        waiting = head - self._in.words[layout.IN_OUTBOUND_TAIL]
        return min(max(waiting, 0), capacity), capacity

    def handler(self, number: int) -> str:
        """Name of the handler of one of the subscriptions."""
        if self._out is None:
            return ""
        return DeclarationRow.read(self._out.words, number % layout.DECLARATION_COUNT).handler

    def read_declarations(self) -> None:
        """Find channels and subscriptions that were declared since the last call."""
        if self._out is None:
            return
        for row in DeclarationRow.read_all(self._out.words, self._declared):
            self._declared += 1
            self.topics[row.own_topic] = row.name.topic
            if row.kind == Outbound.ADVERTISE:
                self.publishes.append(row.name)
                continue
            self._numbers[row.name] = row.number
            if not row.is_optional:
                self.needs.append(row.name)

    def punctuality(self, subscribed: ChannelName) -> Punctuality:
        """Return how a subscription's messages come; zeros for one that is not known."""
        number = self._numbers.get(subscribed)
        if self._out is None or number is None:
            return Punctuality(0, 0, 0, 0)
        return Punctuality(*self._out.copy(layout.newest_at(number), len(Punctuality._fields)))


def _attach(name: str, kind: SegmentKind) -> Segment | None:
    try:
        return Segment.attach(name, kind)
    except (SegmentMissing, SegmentMismatch):  # it ended, or destroyed its segment itself
        return None
