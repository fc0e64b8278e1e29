"""One child over the whole run: its state and its transitions."""

import signal
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum, auto

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.proc import is_traced, read_wait_channel
from robbie_mp.bus.transport.layout import Activity
from robbie_mp.run.profile.model import HANDLER_DEADLINE_S
from robbie_mp.run.supervisor.child_spec import ChildKind, ChildSpec
from robbie_mp.run.supervisor.crash import CrashWatch
from robbie_mp.run.supervisor.deadlines import HangWatch, RunQueueTime
from robbie_mp.run.supervisor.event_loop import EventLoop
from robbie_mp.run.supervisor.incarnations import Doing, Incarnations
from robbie_mp.run.supervisor.leftovers import Leftovers, kill_child_leftovers
from robbie_mp.run.supervisor.output import ChildOutput
from robbie_mp.run.supervisor.process import ChildProcess, ExitStatus
from robbie_mp.run.supervisor.restart import GiveUp, Restart, RestartBudget
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.streams import ChildStream, OutputStream, RecordStream
from robbie_mp.run.trace.kinds import Kind

POLL_S = 0.015
SOON_S = 0.05
"""For this long after a restart is due, the child is polled often: the core will soon have reclaimed."""
OFTEN_S = 0.001
DUMP_S = 0.5
"""From the request for a stack dump to SIGKILL; a stopped process does not respond."""
UNKILLABLE_AFTER_S = 5.0
"""A process that has not ended this long after SIGKILL hangs in the kernel: in disk access or a driver."""
BY_ITSELF = "it ended by itself, and is not started again"
STOPPED = Doing(Activity.IDLE, -1, -1)
"""A child has no work, but a signal has stopped it, so it would do none either."""


class Then(Enum):
    """The next step when a child in an ordered stop has ended."""

    STOPPED = auto()
    RESTART = auto()


@dataclass(frozen=True)
class ChildServices:
    """Objects that all children of a run share."""

    incarnations: Incarnations
    loop: EventLoop
    clock: Callable[[], float]
    start: Callable[[ChildSpec, int], ChildProcess]
    """Starts the process of an incarnation; raises OSError if this fails."""
    known_pids: Callable[[], Collection[int]]
    """Pids of the processes that the supervisor has started."""
    may_start: Callable[["SupervisedChild"], bool]
    """Whether a restart need not wait for other children."""
    on_change: Callable[["SupervisedChild", StateChange], None]


class SupervisedChild:
    """Starts a process, watches it become ready and end, and restarts it according to its policy.

    Attributes:
        spec: the description of the child.
        state: None before the first start.
        incarnation: counts the starts.
        reason: why the state changed last.
        was_settled: whether it has left STARTING at least once.
        never_came_up: whether it has been in BACKOFF or FAILED and never RUNNING. A child that the end of
            the run meets in its first start has not failed.
        ended_run: whether it ended in the way that ends the run.
        awaits_retry: whether it is FAILED and will be retried.
        is_debugged: whether it stands at a breakpoint. So it is neither hung nor late, as if a debugger such
            as gdb holds it.
        unfinished: why it did not end in order when the run stopped, so that what it writes at its end, such
            as a map, is missing; '' if it did, or if it ended before it had run.
    """

    def __init__(
        self, spec: ChildSpec, output: ChildOutput, budget: RestartBudget, surroundings: ChildServices
    ):
        self.spec = spec
        self.state: ChildState | None = None
        self.incarnation = 0
        self.reason = ""
        self.was_settled = self._was_up = self.never_came_up = False
        self.ended_run = self.is_debugged = False
        self.output = output
        self._budget = budget
        self._around = surroundings
        self._incarnations = surroundings.incarnations
        self._clock = surroundings.clock
        self._process: ChildProcess | None = None
        self._hanging: ChildProcess | None = None
        """Its process, if it was killed but cannot end. Its memory is not reclaimed until it ends: the kernel
        may still write into it."""
        self._status: ExitStatus | None = None
        """Set when its process has ended, but not yet all processes that it forked."""
        self._leftovers: Leftovers | None = None
        self._run_queue: RunQueueTime | None = None
        self._streams: list[ChildStream] = []
        deadline_s = spec.module.handler_deadline_s
        deadline_s = HANDLER_DEADLINE_S if deadline_s is None else deadline_s
        self._hang_watch = HangWatch(deadline_s, spec.module.stop_grace_s)
        self._crash_watch = CrashWatch(spec.name, output, surroundings.incarnations, surroundings.clock)
        self._is_opened = False
        self._may_restart = True
        self._then: Then | None = None
        self._stop_reason = ""
        self._kill_reason = ""
        self._kill_at_s: float | None = None
        self._killed_s: float | None = None
        self._due_s = 0.0  # start deadline in STARTING, time of restart in BACKOFF and FAILED
        self._is_retried = False
        self.awaits_retry = False
        self.unfinished = ""
        self._owes_results = False
        """Whether it has run since an incarnation of it last ended cleanly."""

    @property
    def pid(self) -> int | None:
        """The pid of its process; None also while its process hangs in the kernel."""
        return self._process.pid if self._process else None

    @property
    def pids(self) -> set[int]:
        """Pids of its processes that are not reaped."""
        return {process.pid for process in (self._process, self._hanging) if process}

    @property
    def may_return(self) -> bool:
        """Whether it may run again without a command although it is FAILED or STOPPED."""
        return self._may_restart and (
            self.awaits_retry or (self._hanging is not None and self._then is not Then.STOPPED)
        )

    @property
    def is_retried(self) -> bool:
        """Whether its current start is a retry after FAILED."""
        return self._is_retried

    @property
    def is_stopping(self) -> bool:
        """Whether its process takes part in an ordered stop and still lives."""
        return self._process is not None and self._then is not None

    @property
    def is_ordered_to_end(self) -> bool:
        """Whether its present process, or the last one, has been told to end."""
        return self._then is not None

    @property
    def restarts(self) -> int:
        """How often it was started again."""
        return max(0, self.incarnation - 1)

    def start(self) -> None:
        """Start the next incarnation."""
        self.incarnation += 1
        self._is_retried, self.awaits_retry = self.awaits_retry, False
        self._then = None
        self._stop_reason = self._kill_reason = ""
        self.is_debugged = False
        self._kill_at_s = self._killed_s = None
        self._due_s = self._clock() + self.spec.module.start_deadline_s
        self.output.begin(self.incarnation)
        self._move(ChildState.STARTING, f"start {self.incarnation}")
        self._is_opened = False
        try:
            self._incarnations.open(self.spec.name, self.incarnation)
            self._is_opened = True
            self._process = self._around.start(self.spec, self.incarnation)
        except (RobbieError, OSError) as error:
            self._after_end(None, f"cannot be started: {error}")
            return
        self._crash_watch.begin(self.incarnation, self._process.pid)
        self._run_queue = RunQueueTime(self._process.pid)
        self._run_queue.begin(self._clock())
        self._incarnations.started(self.spec.name, self.incarnation, self._process.pid)
        loop = self._around.loop
        loop.watch(self._process.pidfd, self._on_exit)
        self._streams = [
            OutputStream(self._process.stdout, "stdout", self.output, loop),
            OutputStream(self._process.stderr, "stderr", self.output, loop),
            RecordStream(self._process.log_channel, self.output, loop),
        ]

    def poll(self) -> None:
        """Check deadlines and readiness; called every `POLL_S` in STARTING and BACKOFF, else less often."""
        now_s = self._clock()
        if self._killed_s is not None and self._process:
            if self._status is None:
                self._on_exit()  # while a debugger holds one of its threads, the pidfd does not tell its end
            if self._process and now_s - self._killed_s >= UNKILLABLE_AFTER_S:
                self._abandon()
        elif self._kill_at_s is not None and now_s >= self._kill_at_s:
            self.kill(self._kill_reason)
        elif self.state is ChildState.STARTING and self._kill_at_s is None:
            self._check_ready()
            if self._is_held(now_s >= self._due_s) or self._incarnations.awaits_time(self.spec.name):
                self._due_s = now_s + self.spec.module.start_deadline_s  # the delay is not its fault
            elif self.state is ChildState.STARTING and now_s >= self._due_s + self._starved_s(now_s):
                end = self.abort if self._then is None else self.kill  # in an ordered stop it is no crash
                end(f"not ready within {self.spec.module.start_deadline_s:g} s")
        elif self.state is ChildState.RUNNING:
            self._check_hang(now_s)
        elif self._waits_for_start() and now_s >= self._due_s and self._may_open():
            self.start()

    def poll_in_s(self) -> float | None:
        """Return how soon `poll` must be called; None: no deadline is pending."""
        match self.state:
            case ChildState.STARTING:
                return POLL_S
            case ChildState.BACKOFF | ChildState.FAILED if self._waits_for_start():
                wait_s = self._due_s - self._clock()
                return max(OFTEN_S, wait_s) if wait_s > -SOON_S else POLL_S
            case _:
                return None

    def will_stop(self, then: Then, reason: str) -> None:
        """Take part in an ordered stop: however its process ends from now on, `then` follows.

        Args:
            then: what follows.
            reason: why, shown with the next state; '': no reason is shown.
        """
        if self._process:
            self._then = then
            self._stop_reason = reason

    def terminate(self) -> None:
        """Ask its process to end: the ordered stop has reached it."""
        if self._process:
            self._process.terminate()
            self.wake()

    def stay_stopped(self, reason: str) -> None:
        """End BACKOFF, or the wait for the first start or a retry, in STOPPED."""
        if self.state is None or self._waits_for_start():
            self.awaits_retry = False
            self._move(ChildState.STOPPED, reason)

    def restart_now(self, reason: str) -> None:
        """Restart as soon as possible, from any state without a process, with a fresh budget."""
        self._budget.reset()
        if self._process is None and self.state is not None:
            self._due_s = self._clock()
            self.awaits_retry = False
            if self.state is not ChildState.BACKOFF:
                self._move(ChildState.BACKOFF, reason, restart_in_s=0.0)

    def abort(self, reason: str) -> None:
        """Have its process dump its stacks and end; the restart policy decides what follows.

        On SIGABRT, faulthandler prints the stacks of all threads on standard error, even inside a library
        call that never returns. A process that does not end by this is killed.
        """
        if self._process and self._killed_s is None and self._kill_at_s is None:
            self._kill_reason = reason
            self._kill_at_s = self._clock() + DUMP_S
            self._process.send_signal(signal.SIGABRT)

    def kill(self, reason: str) -> None:
        """Kill its process and all it forked; the restart policy decides what follows."""
        if self._process and self._killed_s is None:
            self._kill_reason = reason
            self._killed_s = self._clock()
            self._process.kill()

    def stop_now(self, reason: str) -> None:
        """Kill its process and all it forked, because the run ends."""
        self._then = Then.STOPPED
        self.kill(reason)

    def send_signal(self, signum: int) -> None:
        """Send a signal to its process, if there is one."""
        if self._process:
            self._process.send_signal(signum)

    def wake(self) -> None:
        """Wake its process, if there is one, from waiting for messages."""
        if self._process:
            self._incarnations.wake(self.spec.name, self.incarnation)

    def do_not_restart(self, reason: str) -> None:
        """Start no further incarnation: the run stops."""
        self._may_restart = False
        if self.state is ChildState.BACKOFF and self._owes_results:
            self.unfinished = f"it had ended ({self.reason}) and was not started again"
        if self.awaits_retry:
            self.awaits_retry = False  # it remains FAILED
        else:
            self.stay_stopped(reason)

    def when_it_ends(self, then: Then, reason: str) -> str:
        """Set what follows if its process, which hangs in the kernel, ever ends.

        Args:
            then: what follows.
            reason: why, shown with the next state.

        Returns:
            A description of the hanging process; '' if none hangs, and nothing was changed.
        """
        if self._hanging is None:
            return ""
        self._then, self._stop_reason = then, reason
        self._budget.reset()
        return self._describe_hanging()

    def let_go(self) -> None:
        """Stop watching a process that hangs in the kernel: the run is over."""
        if self._leftovers:
            self._leftovers.close()
        if self._hanging:
            if self._status is None:
                self._around.loop.unwatch(self._hanging.pidfd)
            self._hanging.reap()
            self._hanging = None

    def _waits_for_start(self) -> bool:
        return self.state is ChildState.BACKOFF or self.awaits_retry

    def _check_ready(self) -> None:
        if self._incarnations.is_ready(self.spec.name, self.incarnation):
            self._budget.running()
            self._owes_results = True
            self._move(ChildState.RUNNING, "ready")

    def _starved_s(self, now_s: float) -> float:
        """Return how long its process has waited for a processor; 0 before the deadline."""
        return self._run_queue.waited_s(now_s) if self._run_queue and now_s >= self._due_s else 0.0

    def _check_hang(self, now_s: float) -> None:
        if self._then is not None or self._process is None or self._run_queue is None:
            return  # in an ordered stop, the grace period is the deadline
        doing = None if self.is_debugged else self._incarnations.doing(self.spec.name, self.incarnation)
        if doing is None and self._process.is_stopped:
            doing = STOPPED
        hung_s = self._hang_watch.hung_for_s(doing, now_s, self._run_queue)
        if hung_s is not None and doing is not None and self._is_held():
            self._hang_watch.hung_for_s(None, now_s, self._run_queue)  # it has the whole time again
        elif hung_s is not None and doing is not None:
            self.abort(f"{self._describe(doing)} for {hung_s:.1f} s")

    def _describe(self, doing: Doing) -> str:
        if doing == STOPPED:
            return "stopped by a signal such as SIGSTOP"
        return self._incarnations.describe(self.spec.name, self.incarnation, doing)

    def _is_held(self, would_count: bool = True) -> bool:
        """Whether a module is held by a debugger, of whatever kind.

        Args:
            would_count: whether the module would count as hung or late otherwise; only then it is looked up
                whether a debugger such as gdb holds it. The core is not spared, because all modules need it.
        """
        if self.is_debugged or not would_count or self.spec.kind is ChildKind.CORE or self.pid is None:
            return self.is_debugged
        return is_traced(self.pid)

    def _may_open(self) -> bool:
        if not self._around.may_start(self):
            return False
        return not self._is_opened or self._incarnations.is_reclaimed(self.spec.name, self.incarnation)

    def _on_exit(self) -> None:
        """Kill what its dead process forked. The process stays a zombie until all of that has ended."""
        process = self._process or self._hanging
        if process is None or (status := process.exit_status()) is None:
            return
        self._status = status
        self._around.loop.unwatch(process.pidfd)
        self._kill_at_s = None
        if self._killed_s is None:
            self._killed_s = self._clock()
        self._leftovers = Leftovers(
            lambda: self._kill_leftovers(process),
            self._around.loop,
            lambda: self._on_gone(process, status),
        )
        self._leftovers.end()

    def _kill_leftovers(self, process: ChildProcess) -> dict[int, int]:
        try:
            return kill_child_leftovers(process.pid, process.marker, self._around.known_pids())
        except OSError:  # no descriptor is left: close its streams to get some
            self._finish_streams()
            return kill_child_leftovers(process.pid, process.marker, self._around.known_pids())

    def _on_gone(self, process: ChildProcess, status: ExitStatus) -> None:
        self._finish_streams()
        process.reap()
        hung = f", after it hung in the kernel for {self._killed_for_s():.0f} s" if self._hanging else ""
        self._process = self._hanging = self._leftovers = self._status = None
        self._killed_s = None
        if self.state is ChildState.STARTING and not self._kill_reason:
            self._check_ready()  # it may have become ready and ended since the last poll
        self._after_end(status, self._why(status) + hung)

    def _abandon(self) -> None:
        """Continue without a process that cannot end; if it ends later, the usual follows."""
        self._hanging, self._process = self._process, None
        self._finish_streams()
        self._kill_at_s = None
        reason = self._kill_reason or (self._why(self._status) if self._status else "")
        self._move(ChildState.FAILED, f"{reason}; but {self._describe_hanging()}")

    def _describe_hanging(self) -> str:
        pids = self._leftovers.pids if self._leftovers else tuple(self.pids)
        channel = read_wait_channel(pids[0]) if pids else ""
        where = f" in the kernel ({channel})" if channel else " in the kernel"
        return (
            f"process {', '.join(map(str, pids))}, killed {self._killed_for_s():.0f} s ago, hangs{where}, "
            "as on a disk that has stalled or in a broken driver"
        )

    def _killed_for_s(self) -> float:
        return self._clock() - self._killed_s if self._killed_s is not None else 0.0

    def _finish_streams(self) -> None:
        for stream in self._streams:
            stream.finish()
        self._streams = []
        self.output.report_dropped()

    def _why(self, status: ExitStatus) -> str:
        if self._kill_reason:
            return f"{self._kill_reason}: {status.reason}"
        if self._stop_reason:
            return f"{self._stop_reason}: {status.reason}"
        if status.is_clean and self.state is ChildState.STARTING and self._then is None:
            return f"{status.reason} before it was ready"
        if status.is_clean and self._then is None and not self._has_ended():
            return f"{status.reason}, but the module did not end: something in it has ended its process"
        return status.reason

    def _has_ended(self) -> bool:
        """Whether a child that was RUNNING has said that it ends."""
        return self.state is ChildState.RUNNING and self._incarnations.has_ended(
            self.spec.name, self.incarnation
        )

    def _after_end(self, status: ExitStatus | None, reason: str) -> None:
        is_clean = status is not None and status.is_clean and not self._kill_reason and self._has_ended()
        if status is not None and self._is_crash(status, is_clean=is_clean):
            self._crash_watch.report(status, reason, was_killed_by_us=bool(self._kill_reason))
        if self._is_opened:
            was_ordered = self._then is Then.RESTART
            self._incarnations.died(self.spec.name, self.incarnation, was_ordered=was_ordered)
        if status is not None and status.is_clean:
            self._owes_results = False
        if self._then is Then.RESTART and self._may_restart:
            self._due_s = self._clock()
            self._move(ChildState.BACKOFF, reason, status, 0.0)
            return
        if self._then is not None:
            is_owed = (
                self._owes_results or self._kill_reason
            )  # one that is killed in its setup() did not end in order
            if not self._may_restart and is_owed and not self._is_orderly(status):
                self.unfinished = reason
            self._move(ChildState.STOPPED, reason, status)
            return
        if is_clean and self.spec.module.ends_run:
            self.ended_run = True
            self._move(ChildState.STOPPED, f"{reason}: the run is over", status)
            return
        match self._budget.ended(clean=is_clean):
            case Restart(after_s=wait_s) if self._may_restart:
                self._due_s = self._clock() + wait_s
                self._move(ChildState.BACKOFF, reason, status, wait_s)
            case GiveUp(reason=why, retry_after_s=retry_s):
                if retry_s is not None and self._may_restart and not self.spec.is_needed:
                    self.awaits_retry = True
                    self._due_s = self._clock() + retry_s
                    self._move(ChildState.FAILED, f"{reason}; {why}", status, retry_s)
                else:
                    self._move(ChildState.FAILED, f"{reason}; {why}", status)
            case _:
                self._move(ChildState.STOPPED, f"{reason}: {BY_ITSELF}", status)

    def _is_orderly(self, status: ExitStatus | None) -> bool:
        """Whether an end in an ordered stop is one in order; not while it is only being started again."""
        if status is None or status.is_clean:
            return status is not None
        return status.signal == signal.SIGTERM and self.state is ChildState.RUNNING

    def _is_crash(self, status: ExitStatus, *, is_clean: bool) -> bool:
        if self._then is None:
            return not is_clean
        if status.signal == signal.SIGKILL:
            return not self._kill_reason  # somebody else killed it, such as the kernel for lack of memory
        return not status.is_clean and status.signal != signal.SIGTERM  # which the supervisor has sent

    def _move(
        self,
        new: ChildState,
        reason: str,
        status: ExitStatus | None = None,
        restart_in_s: float | None = None,
    ) -> None:
        failed = new is ChildState.FAILED or new is ChildState.BACKOFF
        change = StateChange(
            name=self.spec.name,
            incarnation=self.incarnation,
            old=self.state,
            new=new,
            reason=reason,
            wall_time_s=time.time(),
            restart_in_s=restart_in_s,
            exit_status=status,
            last_lines=self.output.last_lines if failed else (),
        )
        old = self.state or "new"
        again = f", again in {restart_in_s:.2f} s" if restart_in_s is not None else ""
        kind = Kind.ERROR if new is ChildState.FAILED else Kind.SYSTEM
        self.output.say(kind, f"{old} → {new}: {reason}{again}")
        self.was_settled = self.was_settled or new is not ChildState.STARTING
        self._was_up = self._was_up or new is ChildState.RUNNING
        self.never_came_up = not self._was_up and (self.never_came_up or failed)
        self.state = new
        self.reason = reason
        self._incarnations.state_changed(change)
        self._around.on_change(self, change)
