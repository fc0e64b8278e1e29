"""Lockstep: the whole robot handles one message at a time, and time stands still meanwhile.

The core holds back all messages but the next one (see `robbie_mp.bus.core.queues`). The module that controls
the clock sets the time, sends the messages of that time, and continues when the core has no message left to
deliver: then everything that its messages caused is finished. Ticks are such messages, too. So the messages
of each module and their order depend only on the messages, and not on the machine's speed or load. Messages
from outside, such as those of users or the supervisor, take their place in the order whenever they arrive.
"""

import contextlib
from collections.abc import Callable, Mapping

from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.board import Board
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment, SegmentMissing
from robbie_mp.bus.transport.tables import CoreTables
from robbie_mp.bus.transport.words import Words, new_fence
from robbie_mp.module.module import Module


class Lockstep:
    """The view of the other modules for the module that controls the clock.

    Args:
        run_id: the run.
        out_words: the words of this module's outbound segment.
        in_words: the words of the core's answer.
        board: the board, which shows the running modules.
        wake_core: wakes the core, so that it reads the rings.
    """

    def __init__(
        self, run_id: str, out_words: Words, in_words: Words, board: Board, wake_core: Callable[[], None]
    ):
        self._run_id = run_id
        self._core_segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self._core = self._core_segment.words
        self._tables = CoreTables.attach(self._core)
        self._out = out_words
        self._in = in_words
        self._board = board
        self._wake_core = wake_core
        self._fence = new_fence()
        self._names = board.modules()
        self._mapped: dict[int, tuple[int, Segment]] = {}
        """Incarnation and outbound segment of each module, by slot."""
        self._periods = dict.fromkeys(self._names, 0)

    def is_settled(self) -> bool:
        """Whether all messages of this module, and everything that they caused, have been handled."""
        if self._in[layout.IN_OUTBOUND_TAIL] != self._out[layout.OUT_HEAD]:
            return False  # the core has not read all of them
        self._fence()
        return self._core[layout.CORE_SETTLED] == self._core[layout.CORE_LAST_SEQUENCE]

    def wake_when_settled(self) -> None:
        """Request a call of `tick()` as soon as everything is settled."""
        self._out[layout.OUT_AWAITS_SETTLED] = 1
        self._wake_core()

    def has_just_settled(self) -> bool:
        """Return whether the awaited state has been reached. Returns True only once."""
        if not self._out[layout.OUT_AWAITS_SETTLED] or not self.is_settled():
            return False
        self._out[layout.OUT_AWAITS_SETTLED] = 0
        return True

    @property
    def is_awaited(self) -> bool:
        """Whether the module waits until everything is settled."""
        return self._out[layout.OUT_AWAITS_SETTLED] != 0

    def periods(self) -> Mapping[str, int]:
        """Return the tick period in ns of each module that wants ticks, in the order of the profile.

        For a module that is just being restarted, this is the period of its last incarnation.
        """
        for slot in range(1, len(self._names) + 1):
            mapped = self._mapped_now(slot)
            if mapped is not None and mapped.words[layout.OUT_READY]:
                self._periods[self._names[slot - 1]] = mapped.words[layout.OUT_TICK_PERIOD_NS]
        return {name: period_ns for name, period_ns in self._periods.items() if period_ns}

    def next_free_ns(self, now_ns: int) -> int | None:
        """Return when the next module that is busy by the run's clock gets a message that waits for it.

        Call this when all is settled. Modules are busy only if the profile charges them for their handlers.

        Args:
            now_ns: the run's time.
        """
        free_ns = [
            until_ns
            for slot in range(1, len(self._names) + 1)
            if (until_ns := self._busy_until_ns(slot, now_ns)) is not None
            and self._core[self._tables.publisher(slot) + layout.PUBLISHER_WAITING]
        ]
        return min(free_ns, default=None)

    def _busy_until_ns(self, slot: int, now_ns: int) -> int | None:
        mapped = self._mapped_now(slot)
        if mapped is None:
            return None
        since_ns, charged_ns = mapped.words[layout.OUT_CHARGED_SINCE_NS], mapped.words[layout.OUT_CHARGED_NS]
        return since_ns + charged_ns if since_ns <= now_ns < since_ns + charged_ns else None

    def _mapped_now(self, slot: int) -> Segment | None:
        """Return the outbound segment of a module's present incarnation; None if it has none."""
        incarnation = self._board.incarnation(slot)
        mapped = self._mapped.get(slot)
        if mapped is None or mapped[0] != incarnation:
            mapped = self._map(slot, incarnation)
        return mapped[1] if mapped else None

    def _map(self, slot: int, incarnation: int) -> tuple[int, Segment] | None:
        if (old := self._mapped.pop(slot, None)) is not None:
            old[1].close()
        with contextlib.suppress(SegmentMissing):
            segment = Segment.attach(names.outbound(self._run_id, slot, incarnation), SegmentKind.OUT)
            self._mapped[slot] = (incarnation, segment)
        return self._mapped.get(slot)

    def close(self) -> None:
        """Unmap all segments."""
        self._core_segment.close()
        for _, segment in self._mapped.values():
            segment.close()


class ClockSource(Module):
    """A module that can control the run's clock, if the profile names it in `clock.source`."""

    lockstep: Lockstep | None = None
    """Set before `setup` if this module controls the clock of a run in lockstep."""


class TickSchedule:
    """Decides which module's tick is due next. Ticks at the same time are in the order of the profile.

    Args:
        start_ns: the time of all modules' first tick.

    Attributes:
        due_ns: the time of each module's next tick, by its name.
    """

    def __init__(self, start_ns: int):
        self._start_ns = start_ns
        self.due_ns: dict[str, int] = {}
        self._periods: dict[str, int] = {}

    def update(self, periods: Mapping[str, int], now_ns: int) -> None:
        """Update the modules that want ticks.

        Args:
            periods: their periods in ns, by name.
            now_ns: the present time. Modules that are new here get their first tick now.
        """
        self._periods = dict(periods)
        self.due_ns = {name: self.due_ns.get(name, max(now_ns, self._start_ns)) for name in periods}

    def next(self) -> tuple[int, str] | None:
        """Return time (ns) and module of the next tick, or None if no module wants ticks."""
        if not self.due_ns:
            return None
        name = min(self.due_ns, key=self.due_ns.__getitem__)  # the first of those due at the same time
        return self.due_ns[name], name

    def granted(self, name: str) -> None:
        """Record that a module has had its tick."""
        self.due_ns[name] += self._periods[name]

    def restart(self, now_ns: int) -> None:
        """Make the next tick of all modules due now, because the time has been set to another one."""
        self.due_ns = dict.fromkeys(self.due_ns, now_ns)
