"""Replacements for the objects that a player uses. They record all calls."""

from collections.abc import Sequence

from robbie_mp.logs.playback.log_time import LogTime
from robbie_mp.logs.playback.player import DueTick, Player
from robbie_mp.logs.playback.tape import Tape
from robbie_mp.logs.recording.reader import Log, LoggedMessage, select
from robbie_mp.module.clock import ManualClock

SECOND_NS = 1_000_000_000
SENDING_S = 1e-4
TICK_NS = 250_000_000


class RunClockRecorder:
    """A run's clock that is driven, and can be read at any real time."""

    def __init__(self, real: ManualClock):
        self._real = real
        self._at_ns = self._since_ns = 0
        self._rate = 0.0
        self._limit_ns = 1 << 62
        self.jumps: list[int] = []

    def play(self, at_ns: int, rate: float, limit_ns: int) -> None:
        self._set(at_ns, rate)
        self._limit_ns = limit_ns

    def pause(self, at_ns: int) -> None:
        self._set(at_ns, 0.0)

    def jump(self, at_ns: int) -> None:
        self.jumps.append(at_ns)
        self._at_ns, self._since_ns = at_ns, self._real.monotonic_ns()

    def _set(self, at_ns: int, rate: float) -> None:
        assert at_ns >= self.now_ns(), "the clock went back"
        self._at_ns, self._since_ns, self._rate = at_ns, self._real.monotonic_ns(), rate

    def now_ns(self) -> int:
        run_ns = self._at_ns + round((self._real.monotonic_ns() - self._since_ns) * self._rate)
        return min(run_ns, self._limit_ns) if self._rate else self._at_ns


class OutletRecorder:
    """Records the sent messages with the run's time. Messages stay in flight if the test wants that."""

    def __init__(self, clock: RunClockRecorder, real: ManualClock):
        self._clock = clock
        self._real = real
        self.room = 1000
        self.on_their_way = 0
        self.accepts = True
        self.sent: list[tuple[int, int]] = []
        """The number of each message in the log, and the time at which it was sent."""
        self.jumps: list[tuple[int, int, str]] = []
        self.ticks: list[DueTick] = []
        """In lockstep: each module's next."""
        self.free_ns: list[int] = []
        """In lockstep: when busy modules get what waits for them."""
        self.ticked: list[tuple[DueTick, int]] = []

    def send(self, message: LoggedMessage, *, is_given: bool = False) -> bool:
        if self.accepts:
            self.sent.append((message.sequence, self._clock.now_ns()))
            self._real.advance(SENDING_S)
        return self.accepts

    def has_room(self, size: int) -> bool:
        return self.on_their_way < self.room

    def is_empty(self) -> bool:
        return self.on_their_way == 0

    def next_tick(self) -> DueTick | None:
        return min(self.ticks, default=None)

    def next_free(self) -> DueTick | None:
        return DueTick(self.free_ns[0], "") if self.free_ns else None

    def send_tick(self, tick: DueTick) -> bool:
        self.ticked.append((tick, self._clock.now_ns()))
        if not tick.module:
            self.free_ns.remove(tick.due_ns)
            return True
        self.ticks.remove(tick)
        self.ticks.append(DueTick(tick.due_ns + TICK_NS, tick.module))
        return True

    def announce(self, before_ns: int, after_ns: int, reason: str) -> None:
        assert self._clock.now_ns() == after_ns
        self.jumps.append((before_ns, after_ns, reason))

    @property
    def numbers(self) -> list[int]:
        return [number for number, _ in self.sent]


class PlayerRig:
    """A player of a log with all objects that it uses."""

    def __init__(
        self,
        log: Log,
        rate: float | None = 1.0,
        *,
        loop: bool = False,
        paused: bool = False,
        lockstep: bool = False,
        gap_ns: int | None = None,
        topics: Sequence[str] = (),
    ):
        self.real = ManualClock()
        self.clock = RunClockRecorder(self.real)
        self.outlet = OutletRecorder(self.clock, self.real)
        chosen, _ = select(log.channels, topics)
        self.tape = Tape(log, chosen, log.start_ns, log.end_ns, gap_ns)
        self.time = LogTime(
            self.clock, self.real.monotonic_ns, log.start_ns, rate, paused=paused, lockstep=lockstep
        )
        self.player = Player(
            self.tape,
            self.time,
            self.outlet,
            self.real.monotonic_ns,
            log.start_ns,
            loop=loop,
        )

    def run(self, seconds: float, period_s: float = 0.01) -> None:
        """Let real time pass, with the player's turns in it."""
        self.player.play()
        for _ in range(round(seconds / period_s)):
            self.real.advance(period_s)
            self.player.play()
