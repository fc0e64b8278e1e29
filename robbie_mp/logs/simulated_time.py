"""Simulated time without a log: the run's clock advances as fast as the modules can, or at a set rate."""

import time
from pathlib import Path

from robbie_mp.messages import Tick, Time
from robbie_mp.module.module import setting
from robbie_mp.module.settings import SettingError
from robbie_mp.run.lockstep import ClockSource, TickSchedule
from robbie_mp.run.run_clock import ClockWriter
from robbie_mp.run.shared_time import STALE_S, SharedTime

STEPS_AT_ONCE = 100
"""Maximum number of ticks granted in a row before this module checks its own messages."""
POLL_S = 0.0005
"""Time between looks at other runs that are behind."""


class SimulatedTime(ClockSource):
    """Advances the clock of a simulation from one module's tick to the next.

    It works only in lockstep: set `clock: {source: time, lockstep: true}` if the module is named `time`. A
    seeded simulation then runs the same way every time, regardless of the load on the machine.

    After a restart it continues where it was; the modules' next ticks are then due at once.
    """

    period_s: float = setting(0.05, "time between checks of the machine's clock", minimum=0.001)
    start_s: float = setting(1e9, "the time at which the simulation begins, s since the epoch", minimum=0.0)
    rate: float | None = setting(
        None, "maximum speed as a multiple of real time; null: as fast as the modules can", minimum=0.01
    )
    duration_s: float | None = setting(
        None, "simulated time after which this module ends; null: never", minimum=0.0
    )
    shared: Path | None = setting(
        None, "folder by which runs on this machine share one simulated time: none runs ahead of the others"
    )
    waits_for: int = setting(
        1, "with `shared`: runs that must be there, this one included, before time passes", minimum=1
    )
    gives_up_s: float = setting(
        STALE_S, "with `shared`: time goes on without a run that has sent nothing for this long", minimum=0.1
    )

    def setup(self) -> None:
        """Start, or continue where a killed incarnation stopped."""
        if self.lockstep is None:
            raise SettingError(f"set clock.source to {self.name} and clock.lockstep to true", "start_s")
        self.clock_writer = ClockWriter.attach(self.run_id)
        self.began_ns: int = self.restored or round(self.start_s * 1e9)
        now_ns = self.clock_writer.now_ns
        if now_ns is None:
            now_ns = self.began_ns
            self.clock_writer.jump(now_ns)
            self.checkpoint(now_ns)
        self.began_machine_s = time.monotonic()
        """The machine's time at which the simulation started, or would have started at this rate."""
        if self.rate is not None:
            self.began_machine_s -= (now_ns - self.began_ns) / 1e9 / self.rate
        self.schedule = TickSchedule(now_ns)
        self.ticks = 0
        self.shared_time: SharedTime | None = None
        if self.shared is not None:
            # After a restart, the others have been there, and may have ended since.
            waits_for = self.waits_for if now_ns == self.began_ns else 1
            self.shared_time = SharedTime(self.shared, self.run_id or "run", waits_for, self.gives_up_s)
        self.missing: set[str] = set()
        """Runs that share this time and are dead."""

    def tick(self) -> None:
        """Advance for as long as everything is settled."""
        assert self.lockstep is not None
        for _ in range(STEPS_AT_ONCE):
            if not self.lockstep.is_settled():
                break
            if not self._step():
                return
        self.lockstep.wake_when_settled()

    def _step(self) -> bool:
        """Grant the next tick; False if it is not due yet, or no module has requested one."""
        assert self.lockstep is not None
        now_ns = self.clock_writer.now_ns or 0
        self.schedule.update(self.lockstep.periods(), now_ns)
        following = self.schedule.next()
        free_ns = self.lockstep.next_free_ns(now_ns)
        if free_ns is not None and (following is None or free_ns <= following[0]):
            following = free_ns, ""  # a message waits for a module that is busy until then
        simulated_s = (now_ns - self.began_ns) / 1e9
        self.status = f"{simulated_s:.1f} s simulated, {self.ticks} ticks{self._without()}"
        if self.duration_s is not None and simulated_s >= self.duration_s:
            self.stop()
            return False
        if following is None:
            return False
        due_ns, name = following
        if self.rate is not None:
            passed_s = (time.monotonic() - self.began_machine_s) * self.rate
            if (due_ns - self.began_ns) / 1e9 > passed_s:
                return False
        if self.shared_time is not None and not self.shared_time.may_go_to(due_ns):
            return self._wait_for_others(self.shared_time, due_ns)
        self.clock_writer.pause(due_ns)
        if self.publish(Tick(due=Time.from_nanoseconds(due_ns)), topic=name) and name:
            self.schedule.granted(name)
            self.ticks += 1
        return True

    def _without(self) -> str:
        """Return which runs this time goes on without, for the status; say in the log if that has changed."""
        shared = self.shared_time
        if shared is None:
            return ""
        for run in shared.missing - self.missing:
            self.log.warning(
                "run %s, which shares this time, has sent nothing for %.1f s; time goes on without it",
                run,
                self.gives_up_s,
            )
        for run in self.missing - shared.missing:
            self.log.info("run %s shares this time again", run)
        self.missing = set(shared.missing)
        return f", without {shared.given_up} dead runs" if shared.given_up else ""

    def _wait_for_others(self, shared: SharedTime, due_ns: int) -> bool:
        """Wait for the runs behind this one, but no longer than a period; False if they still are."""
        end_s = time.monotonic() + self.period_s
        while not (may_go := shared.may_go_to(due_ns)) and time.monotonic() < end_s:
            time.sleep(POLL_S)
        if not shared.has_begun:
            self.status = f"waiting until {self.waits_for} runs share this time"
        if self.rate is not None:  # what has been waited for is not made up for by a higher rate
            earliest_s = time.monotonic() - (due_ns - self.began_ns) / 1e9 / self.rate
            self.began_machine_s = max(self.began_machine_s, earliest_s)
        return may_go

    def teardown(self) -> None:
        """Release the clock: it stops. Other runs that share it go on."""
        if self.shared_time is not None:
            self.shared_time.leave()
        self.clock_writer.close()
