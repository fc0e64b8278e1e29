"""The run's clock, set by a module that plays a log or steps a simulation.

A profile names that module (`clock.source`). All other modules use the run's time for stamps, periods and
`self.clock`. It may run faster or slower than the machine's time, stand still, or be set to another time. It
goes back only by such a *jump*, and jumps are counted.
"""

import math
import time
from bisect import bisect_right
from typing import NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX, Words, new_fence, row_reader, row_writer

RATE_ONE = 1 << 32
MAX_RATE = 1e6


class InvalidRate(RobbieError, ValueError):
    """The rate of a clock is negative, not a number, or too high."""


class _Row(NamedTuple):
    """One setting of the clock: it was `run_ns` at `machine_ns` and continues at `rate`."""

    machine_ns: int
    run_ns: int
    rate: int
    limit_ns: int
    jumps: int
    smooth_since_ns: int

    def at(self, machine_ns: int) -> int:
        """Return the run's time at a moment of the machine's monotonic time.

        For moments before the clock ran at this rate, return the time at which that began: extrapolating back
        at the present rate could give any time, even a negative one.
        """
        run_ns = self.run_ns + ((machine_ns - self.machine_ns) * self.rate >> 32)
        return max(self.smooth_since_ns, min(run_ns, self.limit_ns))

    def goes_on_smoothly(self, machine_ns: int, rate: int) -> bool:
        """Whether time continues at an unchanged rate, without having stopped."""
        return 0 < rate == self.rate and self.at(machine_ns) < self.limit_ns


class _Rows:
    """The rows of the clock's segment, written in rotation. The newest is valid; older ones hold the past."""

    def __init__(self, words: Words):
        self._words = words
        self._read = row_reader(words, len(_Row._fields))
        self._write = row_writer(words, len(_Row._fields))
        self._fence = new_fence()

    def read(self) -> _Row | None:
        """Return the newest row; None before the run's time has begun."""
        while number := self._words[layout.CLOCK_NUMBER]:
            self._fence()
            row = _Row(*self._read(_offset(number)))
            self._fence()
            if self._words[layout.CLOCK_NUMBER] == number:
                return row
        return None

    def read_at(self, machine_ns: int) -> _Row | None:
        """Return the row that was valid at a moment, or the oldest one; None as for `read`."""
        row = self.read()
        while row is not None and machine_ns < row.machine_ns and row.at(machine_ns) <= row.smooth_since_ns:
            # The writer may be writing the row after the newest, in the place of the oldest.
            newest = self._words[layout.CLOCK_NUMBER]
            oldest = max(1, newest - layout.CLOCK_ROW_COUNT + 2)
            after = bisect_right(range(oldest, newest + 1), machine_ns, key=self._machine_ns)
            number = max(oldest, oldest + after - 1)
            found = _Row(*self._read(_offset(number)))
            self._fence()
            if self._words[layout.CLOCK_NUMBER] - number <= layout.CLOCK_ROW_COUNT - 2:
                return found
        return row

    def _machine_ns(self, number: int) -> int:
        return self._words[_offset(number) // WORD_BYTES]

    def write(self, row: _Row) -> None:
        """Write a row, then make it the newest; a partly written row never becomes valid."""
        number = self._words[layout.CLOCK_NUMBER] + 1
        self._write(_offset(number), *row)
        self._fence()
        self._words[layout.CLOCK_NUMBER] = number


def _offset(number: int) -> int:
    place = number % layout.CLOCK_ROW_COUNT
    return (layout.CLOCK_ROWS + place * layout.CLOCK_ROW_WORDS) * WORD_BYTES


class RunClock:
    """Reads the run's time; see `robbie_mp.module.clock.Clock`.

    Both readings are the same for a run's clock: nanoseconds since the epoch.

    Args:
        segment: the run's clock.
    """

    def __init__(self, segment: Segment):
        self._segment = segment
        self._rows = _Rows(segment.words)
        self._latest = 0, 0
        """Jumps and time as last returned."""

    @classmethod
    def attach(cls, run_id: str) -> "RunClock":
        """Map the clock of a run."""
        return cls(Segment.attach(names.clock(run_id), SegmentKind.CLOCK))

    @property
    def has_begun(self) -> bool:
        """Whether the time has been set for the first time."""
        return self._rows.read() is not None

    @property
    def jumps(self) -> int:
        """How often the time has been set to another one."""
        row = self._rows.read()
        return row.jumps if row else 0

    def now_ns(self) -> int:
        """Nanoseconds since the epoch; before the run's time has begun, 0.

        The writer may stop the clock at a time that has just passed, because it reads the machine's clock
        shortly before its row becomes valid. This method never returns an earlier time for that reason.
        """
        row = self._rows.read()
        if row is None:
            return 0
        latest = self._latest = max(self._latest, (row.jumps, row.at(time.monotonic_ns())))
        return latest[1]

    monotonic_ns = now_ns
    """The same; it goes back only by a jump."""

    def at(self, machine_ns: int) -> int:
        """The run's time at a moment of the machine's monotonic time.

        If the clock has been set a thousand times since then, this is the time after the first of these.
        """
        row = self._rows.read_at(machine_ns)
        return row.at(machine_ns) if row else 0

    def machine_s_until(self, run_ns: int) -> float:
        """Return the time until the run reaches a time at the present rate; infinite if it stands still."""
        row = self._rows.read()
        if row is None:
            return math.inf
        left_ns = run_ns - row.at(time.monotonic_ns())
        if left_ns <= 0:
            return 0.0
        return left_ns * RATE_ONE / row.rate / 1e9 if row.rate else math.inf

    def close(self) -> None:
        """Unmap it."""
        self._segment.close()


class ClockWriter:
    """Sets the run's clock. Only the module that the profile names has one.

    A new incarnation of that module finds the clock as the previous one left it.

    Args:
        segment: the run's clock, mapped for writing.
    """

    def __init__(self, segment: Segment):
        self._segment = segment
        self._rows = _Rows(segment.words)

    @classmethod
    def attach(cls, run_id: str) -> "ClockWriter":
        """Map the clock of a run for writing."""
        return cls(Segment.attach(names.clock(run_id), SegmentKind.CLOCK, write=True))

    @property
    def now_ns(self) -> int | None:
        """Return the run's time; None if it has not begun."""
        row = self._rows.read()
        return row.at(time.monotonic_ns()) if row else None

    def play(self, at_ns: int, rate: float = 1.0, limit_ns: int = WORD_MAX) -> None:
        """Let time continue from `at_ns`.

        Args:
            at_ns: not earlier than the present time; see `jump`.
            rate: seconds of the run per second of the machine.
            limit_ns: time stops there unless this is called again before. So time stops soon after the module
                that sets the clock has crashed.

        Raises:
            InvalidRate: the rate is negative, not a number, or too high.
        """
        if not 0 <= rate <= MAX_RATE:
            raise InvalidRate(
                f"time cannot run at {rate} times real time; give a rate from 0 to {MAX_RATE:g}"
            )
        self._write(at_ns, round(rate * RATE_ONE), limit_ns, is_jump=False)

    def pause(self, at_ns: int) -> None:
        """Stop time at `at_ns`; call this repeatedly to step it."""
        self._write(at_ns, 0, WORD_MAX, is_jump=False)

    def jump(self, at_ns: int) -> None:
        """Set another time, earlier or later, and stop there."""
        self._write(at_ns, 0, WORD_MAX, is_jump=True)

    def _write(self, at_ns: int, rate: int, limit_ns: int, *, is_jump: bool) -> None:
        before, machine_ns = self._rows.read(), time.monotonic_ns()
        jumps = before.jumps if before else 0
        since_ns = at_ns
        if before and not is_jump:
            since_ns = at_ns = max(at_ns, before.at(machine_ns))
            if before.goes_on_smoothly(machine_ns, rate):
                since_ns = before.smooth_since_ns
        self._rows.write(_Row(machine_ns, at_ns, rate, max(limit_ns, at_ns), jumps + is_jump, since_ns))

    def close(self) -> None:
        """Unmap it."""
        self._segment.close()
