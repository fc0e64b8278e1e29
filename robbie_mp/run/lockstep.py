"""Lockstep: one message is handled at a time in the whole robot, and time stands still meanwhile.

The core keeps all but the next message back (see `robbie_mp.core.queues`). The module that turns the
clock sets the time, sends what happens then, and goes on when the core has nothing left to hand out: then
everything that its messages have caused is over. Ticks are such messages too. So what every module gets, and
in which order, depends on nothing but the messages: not on the machine's speed or load. Messages from
outside, as of people or of the supervisor, take their place whenever they come.
"""

import contextlib
from collections.abc import Callable, Mapping

from robbie_mp.module.module import Module
from robbie_mp.transport import layout, names
from robbie_mp.transport.board import Board
from robbie_mp.transport.layout import SegmentKind
from robbie_mp.transport.segment import Segment, SegmentMissing
from robbie_mp.transport.words import Words, new_fence


class Lockstep:
    """What the module that turns the clock knows of the others.

    Args:
        run_id: the run.
        out_words: this module's own words.
        in_words: the core's answer to them.
        board: who runs.
        wake_core: has the core look at its rings.
    """

    def __init__(
        self, run_id: str, out_words: Words, in_words: Words, board: Board, wake_core: Callable[[], None]
    ):
        self._run_id = run_id
        self._core_segment = Segment.attach(names.core(run_id), SegmentKind.CORE)
        self._core = self._core_segment.words
        self._out = out_words
        self._in = in_words
        self._board = board
        self._wake_core = wake_core
        self._fence = new_fence()
        self._names = board.modules()
        self._mapped: dict[int, tuple[int, Segment]] = {}
        """Incarnation and out segment of the modules, by slot."""
        self._periods = dict.fromkeys(self._names, 0)

    def is_settled(self) -> bool:
        """Whether everything that this module has sent, and all that it caused, has been handled."""
        if self._in[layout.IN_OUTBOUND_TAIL] != self._out[layout.OUT_HEAD]:
            return False  # the core has not seen it all
        self._fence()
        return self._core[layout.CORE_SETTLED] == self._core[layout.CORE_LAST_SEQUENCE]

    def wake_when_settled(self) -> None:
        """Have `tick()` run as soon as everything is settled."""
        self._out[layout.OUT_AWAITS_SETTLED] = 1
        self._wake_core()

    def has_just_settled(self) -> bool:
        """Whether what was waited for has come; says so once."""
        if not self._out[layout.OUT_AWAITS_SETTLED] or not self.is_settled():
            return False
        self._out[layout.OUT_AWAITS_SETTLED] = 0
        return True

    @property
    def is_awaited(self) -> bool:
        """Whether it is waited for that everything is settled."""
        return self._out[layout.OUT_AWAITS_SETTLED] != 0

    def periods(self) -> Mapping[str, int]:
        """Period in ns of each module that wants ticks, in the order of the profile.

        Of a module that is just being restarted, what its last incarnation wanted.
        """
        for slot in range(1, len(self._names) + 1):
            name, incarnation = self._names[slot - 1], self._board.incarnation(slot)
            mapped = self._mapped.get(slot)
            if mapped is None or mapped[0] != incarnation:
                mapped = self._map(slot, incarnation)
            if mapped is not None and mapped[1].words[layout.OUT_READY]:
                self._periods[name] = mapped[1].words[layout.OUT_TICK_PERIOD_NS]
        return {name: period_ns for name, period_ns in self._periods.items() if period_ns}

    def _map(self, slot: int, incarnation: int) -> tuple[int, Segment] | None:
        if (old := self._mapped.pop(slot, None)) is not None:
            old[1].close()
        with contextlib.suppress(SegmentMissing):
            segment = Segment.attach(names.outbound(self._run_id, slot, incarnation), SegmentKind.OUT)
            self._mapped[slot] = (incarnation, segment)
        return self._mapped.get(slot)

    def close(self) -> None:
        """Unmap what was mapped."""
        self._core_segment.close()
        for _, segment in self._mapped.values():
            segment.close()


class ClockSource(Module):
    """A module that can turn the run's clock, when the profile names it in `clock.source`."""

    lockstep: Lockstep | None = None
    """Set before `setup` if this module turns the clock of a run in lockstep."""


class TickSchedule:
    """Which module's tick is due next; of several at the same time, in the order of the profile.

    Args:
        start_ns: the time of everybody's first tick.

    Attributes:
        due_ns: when each module's next tick is due, by its name.
    """

    def __init__(self, start_ns: int):
        self._start_ns = start_ns
        self.due_ns: dict[str, int] = {}
        self._periods: dict[str, int] = {}

    def update(self, periods: Mapping[str, int], now_ns: int) -> None:
        """Take the modules' wishes into account.

        Args:
            periods: in ns, by the module's name.
            now_ns: whoever wants ticks for the first time has the first one now.
        """
        self._periods = dict(periods)
        self.due_ns = {name: self.due_ns.get(name, max(now_ns, self._start_ns)) for name in periods}

    def next(self) -> tuple[int, str] | None:
        """Time (ns) and module of the next tick; None if nobody wants any."""
        if not self.due_ns:
            return None
        name = min(self.due_ns, key=self.due_ns.__getitem__)  # the first of those due at the same time
        return self.due_ns[name], name

    def granted(self, name: str) -> None:
        """Note that a module has had its tick."""
        self.due_ns[name] += self._periods[name]

    def restart(self, now_ns: int) -> None:
        """Have everybody's next tick now: the time has been set to another one."""
        self.due_ns = dict.fromkeys(self.due_ns, now_ns)
