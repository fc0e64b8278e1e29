"""Decides when each message of a log is published, and follows control requests meanwhile."""

import math
from collections.abc import Callable
from operator import attrgetter
from typing import NamedTuple, Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.playback.log_time import LATEST_NS, LogTime
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.recording.reader import LoggedMessage
from robbie_mp.logs.recording.time_jumps import LogTimeJump

GAP = "gap"
"""Reason of a jump of the log's own time."""
LONGEST_TURN_NS = 20_000_000
"""Longest time that it publishes without looking for control requests."""


class PlaybackRefused(RobbieError, ValueError):
    """A playback cannot carry out a control request.

    Example scenarios:
      - seek to 80 s in a log of 60 s
      - a rate of 0
    """


class DueTick(NamedTuple):
    """A tick of a module, in lockstep."""

    due_ns: int
    module: str
    """'' if no module ticks: a module is not busy any more at that time, and gets a message that waits."""


class Outlet(Protocol):
    """The outlet of the messages, which also counts those in flight."""

    def send(self, message: LoggedMessage, *, is_given: bool = False) -> bool:
        """Publish a message; False if there is no room for it now.

        Args:
            message: the message.
            is_given: whether it is from before the position, on a latched channel.
        """

    def has_room(self, size: int) -> bool:
        """Whether few enough messages are in flight for one more of this size."""

    def is_empty(self) -> bool:
        """Whether everything sent has been handled."""

    def next_tick(self) -> DueTick | None:
        """Return the tick to grant next; None if modules tick by their own clock."""

    def next_free(self) -> DueTick | None:
        """Return when a busy module gets a message that waits for it; None if none waits for that."""

    def send_tick(self, tick: DueTick) -> bool:
        """Grant a tick; False if there is no room for it now."""

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        """Announce that the time has jumped."""


class Player:
    """Plays a tape.

    Args:
        tape: the messages to play.
        time: the position of the playback.
        outlet: where messages go.
        monotonic_ns: returns real time.
        origin_ns: the moment from which seek positions are counted.
        loop: start again at the end.

    Attributes:
        played: number of messages sent so far, without those that are given again after a jump.
        jumps: number of time jumps so far.
        ended: whether the tape is at its end and will not start again.
    """

    def __init__(
        self,
        tape: Tape,
        time: LogTime,
        outlet: Outlet,
        monotonic_ns: Callable[[], int],
        origin_ns: int,
        *,
        loop: bool = False,
    ):
        self.tape = tape
        self.time = time
        self.loop = loop
        self.played = 0
        self.jumps = 0
        self._outlet = outlet
        self._monotonic_ns = monotonic_ns
        self._origin_ns = origin_ns
        self._steps = 0
        self._jump: tuple[int, str] | None = None
        """The target of a jump and its reason, to be carried out once everything sent has been handled."""

    @property
    def ended(self) -> bool:
        """Whether the tape is at its end and will not start again."""
        return self.tape.next is None and self._jump is None and not self._begins_again

    @property
    def _begins_again(self) -> bool:
        return self.loop and self.played > 0

    # -- control requests --------------------------------------------------------------------------------

    def control(self, command: str, value: float) -> None:
        """Carry out a control request; see `PlaybackControl`.

        Raises:
            ControlRefused: the request cannot be carried out; nothing has changed.
        """
        match command:
            case "pause":
                self.time.paused = True
            case "resume":
                self.time.paused = False
                self._steps = 0
            case "step":
                self._step()
            case "seek":
                self._seek(value)
            case "rate":
                self._set_rate(value)
            case _:
                raise PlaybackRefused(f"expected pause, resume, step, seek or rate; got {command!r}")

    def _step(self) -> None:
        if self.ended:
            raise PlaybackRefused("there is no message left to step to; seek back first")
        self.time.paused = True
        self._steps += 1

    def _seek(self, to_s: float) -> None:
        first_s, last_s = ((at - self._origin_ns) / 1e9 for at in (self.tape.begin_ns, self.tape.end_ns))
        if not first_s <= to_s <= last_s:
            raise PlaybackRefused(
                f"cannot seek to {to_s:g} s: what is played are {first_s:g} to {last_s:g} s"
            )
        self._jump = self._origin_ns + round(to_s * 1e9), "seek"
        self._steps = 0

    def _set_rate(self, rate: float) -> None:
        if not rate > 0:
            raise PlaybackRefused(f"a rate must be greater than 0, or infinity; got {rate:g}")
        self.time.rate = None if math.isinf(rate) else rate

    # -- playback ----------------------------------------------------------------------------------------

    def play(self) -> None:
        """Send the messages that are due. Return after a while even if more are due."""
        self.time.renew()
        until_ns = self._monotonic_ns() + LONGEST_TURN_NS
        while self._play_one() and self._monotonic_ns() < until_ns:
            pass

    def _play_one(self) -> bool:
        """Send one message, grant a tick, or jump; False if there is nothing to do now."""
        event = self.tape.next
        goes_on = not self.time.paused or self._steps > 0 or self.tape.gives > 0
        if event is None and self._jump is None and self._begins_again and goes_on:
            self._jump = self.tape.begin_ns, "loop"
        free = self._outlet.next_free() if event is None or self._jump is not None else None
        if free is not None and (goes_on or self._jump is not None):
            return self._send_tick(free)  # what waits for busy modules is handled before the end and a jump
        if self._jump is not None:
            return self._make_jump(*self._jump)
        if event is None or not goes_on:
            self.time.held = event is None
            return False
        return self._play_next(event)

    def _play_next(self, event: LoggedMessage | LogTimeJump) -> bool:
        """Play what is next on the tape, or a tick that is due before it; False if that is impossible now."""
        if isinstance(event, LogTimeJump):
            at_ns, size = _shown(event.before_ns), 0
        elif self.tape.gives:
            return self._give(event)
        else:
            at_ns, size = _shown(event.time_ns), len(event.data)
        tick = self._tick_until(at_ns)
        if not self._is_due(tick.due_ns if tick else at_ns):
            self.time.held = False
            return False
        if not self._outlet.has_room(size):
            self.time.held = True
            return False
        # Again: in lockstep, only now is it certain which modules are busy, and which want ticks.
        tick = self._tick_until(at_ns)
        if not self._is_due(tick.due_ns if tick else at_ns):
            return False
        if tick:
            return self._send_tick(tick)
        return self._leap(event) if isinstance(event, LogTimeJump) else self._send(event)

    def _leap(self, jump: LogTimeJump) -> bool:
        """Have the time jump, if the clock can show that."""
        self.time.advance_to(_shown(jump.before_ns))
        if _shown(jump.after_ns) == self.time.position_ns:
            self.tape.take()
        else:
            self._jump = jump.after_ns, GAP
        return True

    def _send(self, message: LoggedMessage) -> bool:
        self.time.advance_to(_shown(message.time_ns))
        is_sent = self._outlet.send(message)
        self.time.held = not is_sent
        if is_sent:
            self.tape.take()
            self.played += 1
            self._steps = max(0, self._steps - 1)
        return is_sent

    def _give(self, message: LoggedMessage) -> bool:
        """Send a message of a latched channel that was the newest at this position; no time passes."""
        is_sent = self._outlet.has_room(len(message.data)) and self._outlet.send(message, is_given=True)
        self.time.held = not is_sent
        if is_sent:
            self.tape.take()
        return is_sent

    def _send_tick(self, tick: DueTick) -> bool:
        """Send a tick if that is possible now."""
        if not self._outlet.has_room(0):
            self.time.held = True
            return False
        self.time.advance_to(tick.due_ns)
        is_sent = self._outlet.send_tick(tick)
        self.time.held = not is_sent
        return is_sent

    def _tick_until(self, until_ns: int) -> DueTick | None:
        """Return the next tick to grant, if it is due by then."""
        ticks = [tick for tick in (self._outlet.next_free(), self._outlet.next_tick()) if tick]
        tick = min(ticks, key=attrgetter("due_ns"), default=None)
        return tick if tick and tick.due_ns <= until_ns else None

    def _is_due(self, at_ns: int) -> bool:
        return self._steps > 0 or self.time.rate is None or at_ns <= self.time.position_ns

    def _make_jump(self, to_ns: int, reason: str) -> bool:
        if not self._outlet.is_empty():
            self.time.held = True
            return False
        self._jump = None
        before_ns = self.time.position_ns
        if reason == GAP:
            self.tape.take()
        else:
            self.tape.seek(to_ns)
        self.time.jump(_shown(to_ns))
        self.time.held = False
        self.jumps += 1
        self._outlet.announce(before_ns, _shown(to_ns), reason)
        return True


def _shown(log_ns: int) -> int:
    """Return the run's time at a time of the log."""
    return min(log_ns, LATEST_NS)
