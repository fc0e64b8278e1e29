"""Looks at a run from outside: maps board, core tables and the modules' own words read-only.

Watching costs the robot nothing, and works while the core is down.
"""

from dataclasses import dataclass

import psutil

from robbie_mp.core.directory import ROW_OPEN
from robbie_mp.core.tables import CoreTables
from robbie_mp.transport import layout, names
from robbie_mp.transport.board import Board
from robbie_mp.transport.layout import LINE_WORDS, NAME_WORDS, Activity, SegmentKind
from robbie_mp.transport.records import MessageHandling
from robbie_mp.transport.segment import Segment, SegmentMismatch, SegmentMissing
from robbie_mp.transport.words import Words, read_text

_ACTIVITIES = {int(activity): activity.name.lower() for activity in Activity}


@dataclass(frozen=True)
class SubscriptionFigures:
    """The books of one subscription: routed = delivered + replaced + dropped + lost + waiting."""

    type_name: str
    topic: str
    handling: str
    routed: int
    delivered: int
    replaced: int
    dropped: int
    lost: int

    @property
    def waiting(self) -> int:
        """Messages that wait or are being handled."""
        return self.routed - self.delivered - self.replaced - self.dropped - self.lost


@dataclass(frozen=True)
class ModuleFigures:
    """What is known of one module, over all its incarnations."""

    name: str
    state: int
    """Place of its state in the supervisor's order, counted from 1; 0: never started."""
    pid: int
    incarnation: int
    restarts: int
    started_ns: int
    """Start of this incarnation, monotonic clock."""
    reason: str
    """Why it is in this state."""
    cpu_s: float
    published: int
    """Messages handed to the core."""
    refused: int
    """Messages that memory, ring or tables had no room for."""
    handled: int
    waiting: int
    waiting_peak: int
    pinned: int
    """Messages it has handled but still looks at."""
    segment_bytes: int
    """Its data segments."""
    status: str
    """Of a module that has ended: the last it had."""
    activity: str
    subscriptions: tuple[SubscriptionFigures, ...]

    def total(self, column: str) -> int:
        """Sum of a column over its subscriptions."""
        return sum(getattr(entry, column) for entry in self.subscriptions)


@dataclass(frozen=True)
class ChannelFigures:
    """What has passed through one channel."""

    type_name: str
    version: int
    topic: str
    messages: int
    bytes: int


class RunObserver:
    """A run's figures, read whenever asked.

    Args:
        run_id: the run.

    Raises:
        SegmentMissing: there is no such run.
    """

    def __init__(self, run_id: str):
        self._run_id = run_id
        self._board_segment = Segment.attach(names.board(run_id), SegmentKind.BOARD)
        self._core_segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self._board = Board(self._board_segment.words)
        self._words = self._core_segment.words
        self._tables = CoreTables.attach(self._words)

    def close(self) -> None:
        """Unmap the run."""
        self._board_segment.close()
        self._core_segment.close()

    @property
    def routed(self) -> int:
        """Messages the core has routed."""
        return self._words[layout.CORE_LAST_SEQUENCE]

    def modules(self) -> list[ModuleFigures]:
        """Figures of all modules in start order; the supervisor comes first, the core last.

        Before the core come the tools that are attached now.
        """
        subscriptions = self._subscriptions()
        return [
            self._module(slot, subscriptions.get(slot, ()))
            for slot in range(self._board.slots)
            if not self._board.is_left_by_tool(slot)
        ]

    def channels(self) -> list[ChannelFigures]:
        """Figures of all channels."""
        found = []
        for index in range(self._tables.sizes.channels):
            at = self._tables.channel(index)
            if self._words[at + layout.CHANNEL_STATE] != ROW_OPEN:
                break
            found.append(
                ChannelFigures(
                    read_text(self._words, at + layout.CHANNEL_TYPE, NAME_WORDS),
                    self._words[at + layout.CHANNEL_VERSION],
                    read_text(self._words, at + layout.CHANNEL_TOPIC, NAME_WORDS),
                    self._words[at + layout.CHANNEL_MESSAGES],
                    self._words[at + layout.CHANNEL_BYTES],
                )
            )
        return found

    def _subscriptions(self) -> dict[int, tuple[SubscriptionFigures, ...]]:
        found: dict[int, tuple[SubscriptionFigures, ...]] = {}
        words = self._words
        for index in range(self._tables.sizes.subscriptions):
            at = self._tables.subscription(index)
            if not words[at + layout.SUBSCRIPTION_STATE]:
                break
            slot = words[at + layout.SUBSCRIPTION_SLOT]
            figures = SubscriptionFigures(
                read_text(words, at + layout.SUBSCRIPTION_TYPE, NAME_WORDS),
                read_text(words, at + layout.SUBSCRIPTION_TOPIC, NAME_WORDS),
                MessageHandling(words[at + layout.SUBSCRIPTION_HANDLING]).name,
                *(words[at + layout.SUBSCRIPTION_ROUTED + column] for column in range(5)),
            )
            found[slot] = (*found.get(slot, ()), figures)
        return found

    def _module(self, slot: int, subscriptions: tuple[SubscriptionFigures, ...]) -> ModuleFigures:
        row = self._board.read(slot)
        last = self._own_words(slot, row.incarnation)
        own = last if row.pid else [0] * layout.OUT_DECLARATIONS  # a dead one's counts are in the row
        is_core = slot == self._board.slots - 1
        queue = [0] * layout.PUBLISHER_WORDS
        if not is_core:
            at = self._tables.publisher(slot)
            queue = [self._words[at + column] for column in range(layout.PUBLISHER_WORDS)]
        core_refused = queue[layout.PUBLISHER_REFUSED] >> layout.REFUSED_TAG_BITS
        return ModuleFigures(
            name=row.name,
            state=row.state,
            pid=row.pid,
            incarnation=row.incarnation,
            restarts=row.restarts,
            started_ns=row.started_ns,
            reason=row.reason,
            cpu_s=row.past.cpu_ns / 1e9 + _cpu_s(row.pid),
            published=row.past.published + own[layout.OUT_PUBLISHED],
            refused=row.past.refused + own[layout.OUT_REFUSED] + core_refused,
            handled=row.past.handled + own[layout.OUT_HANDLED],
            waiting=queue[layout.PUBLISHER_WAITING],
            waiting_peak=queue[layout.PUBLISHER_WAITING_PEAK],
            pinned=queue[layout.PUBLISHER_PINNED],
            segment_bytes=own[layout.OUT_SEGMENT_BYTES],
            status=read_text(last, layout.OUT_STATUS, LINE_WORDS),
            activity=_ACTIVITIES.get(own[layout.OUT_ACTIVITY] & 0xFF, "unknown"),
            subscriptions=subscriptions,
        )

    def _own_words(self, slot: int, incarnation: int) -> Words:
        """A copy of the words a module itself writes; zeros if it has none now."""
        try:
            segment = Segment.attach(names.outbound(self._run_id, slot, incarnation), SegmentKind.OUT)
        except (SegmentMissing, SegmentMismatch):  # gone, or destroyed by the module itself
            return [0] * layout.OUT_DECLARATIONS
        own = [segment.words[index] for index in range(layout.OUT_DECLARATIONS)]
        segment.close()
        return own


def _cpu_s(pid: int) -> float:
    if not pid:
        return 0.0
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return times.user + times.system
