"""One child over the whole run: its state, and what each event makes of it."""

import time
from collections.abc import Callable

from robbie_mp.errors import RobbieError
from robbie_mp.supervisor.child_spec import ChildSpec
from robbie_mp.supervisor.event_loop import EventLoop
from robbie_mp.supervisor.incarnations import Incarnations
from robbie_mp.supervisor.leftovers import MARKER, kill_child_leftovers, marker
from robbie_mp.supervisor.output import ChildOutput
from robbie_mp.supervisor.output_stream import OutputStream
from robbie_mp.supervisor.process import ChildProcess, ExitStatus
from robbie_mp.supervisor.restart import GiveUp, Restart, RestartBudget
from robbie_mp.supervisor.states import ChildState, StateChange

POLL_S = 0.015
UNKILLABLE_AFTER_S = 5.0
"""A process that SIGKILL does not end hangs in the kernel, in a broken driver for example."""


class SupervisedChild:
    """Starts a process, sees it become ready and end, and starts it again as its policy says.

    Attributes:
        spec: what it runs.
        state: None before the first start.
        incarnation: counts the starts.
        reason: of the last change of state.
        pid: of its process, None without.
        was_settled: whether it has left STARTING at least once.
        ended_run: whether it ended in the way that ends the run.
    """

    def __init__(
        self,
        spec: ChildSpec,
        run_id: str,
        incarnations: Incarnations,
        output: ChildOutput,
        loop: EventLoop,
        budget: RestartBudget,
        clock: Callable[[], float],
        on_change: Callable[["SupervisedChild", StateChange], None],
    ):
        self.spec = spec
        self.state: ChildState | None = None
        self.incarnation = 0
        self.reason = ""
        self.was_settled = False
        self.ended_run = False
        self.output = output
        self._run_id = run_id
        self._incarnations = incarnations
        self._loop = loop
        self._budget = budget
        self._clock = clock
        self._on_change = on_change
        self._process: ChildProcess | None = None
        self._streams: list[OutputStream] = []
        self._is_opened = False
        self._may_restart = True
        self._was_asked_to_stop = False
        self._kill_reason = ""
        self._killed_s: float | None = None
        self._due_s = 0.0  # start deadline in STARTING, time of restart in BACKOFF

    @property
    def pid(self) -> int | None:
        """Its process."""
        return self._process.pid if self._process else None

    @property
    def restarts(self) -> int:
        """How often it was started again."""
        return max(0, self.incarnation - 1)

    def start(self) -> None:
        """Start the next incarnation."""
        self.incarnation += 1
        self._kill_reason = ""
        self._killed_s = None
        self._due_s = self._clock() + self.spec.start_deadline_s
        self.output.begin(self.incarnation)
        self._move(ChildState.STARTING, f"start {self.incarnation}")
        self._is_opened = False
        try:
            self._incarnations.open(self.spec.name, self.incarnation)
            self._is_opened = True
            self._process = ChildProcess.start(self.spec.argv, self._environment(), self.spec.folder)
        except (RobbieError, OSError) as error:
            self._after_end(None, f"cannot be started: {error}")
            return
        self._incarnations.started(self.spec.name, self.incarnation, self._process.pid)
        self._loop.watch(self._process.pidfd, self._on_exit)
        self._streams = [
            OutputStream(self._process.stdout, "stdout", self.output, self._loop),
            OutputStream(self._process.stderr, "stderr", self.output, self._loop),
        ]

    def poll(self) -> None:
        """Do what time brings; called every `POLL_S` in STARTING and BACKOFF, now and then otherwise."""
        now_s = self._clock()
        if self._killed_s is not None and self._process:
            if now_s - self._killed_s >= UNKILLABLE_AFTER_S:
                self._abandon()
        elif self.state is ChildState.STARTING:
            self._check_ready()
            if self.state is ChildState.STARTING and now_s >= self._due_s:
                self.kill(f"not ready within {self.spec.start_deadline_s:g} s")
        elif self.state is ChildState.BACKOFF and now_s >= self._due_s and self._is_reclaimed():
            self.start()

    def poll_in_s(self) -> float | None:
        """Return how soon `poll` has something to do; None: nothing that time alone brings."""
        match self.state:
            case ChildState.STARTING:
                return POLL_S
            case ChildState.BACKOFF:
                return max(POLL_S, self._due_s - self._clock())
            case _:
                return None

    def terminate(self) -> None:
        """Ask its process to end, for an ordered stop."""
        if self._process:
            self._was_asked_to_stop = True
            self._process.terminate()
            self.wake()

    def kill(self, reason: str) -> None:
        """Kill its process with all it forked; what follows is up to its restart policy."""
        if self._process and self._killed_s is None:
            self._kill_reason = reason
            self._killed_s = self._clock()
            self._process.kill()

    def stop_now(self, reason: str) -> None:
        """Kill its process with all it forked, for the end of the run."""
        self._was_asked_to_stop = True
        self.kill(reason)

    def send_signal(self, signum: int) -> None:
        """Send its process a signal, if it has one."""
        if self._process:
            self._process.send_signal(signum)

    def wake(self) -> None:
        """Wake its process from waiting for messages, if it has one."""
        if self._process:
            self._incarnations.wake(self.spec.name, self.incarnation)

    def do_not_restart(self, reason: str) -> None:
        """Start no further incarnation: the run stops."""
        self._may_restart = False
        if self.state in (None, ChildState.BACKOFF):
            self._move(ChildState.STOPPED, reason)

    def _environment(self) -> dict[str, str]:
        value = marker(self._run_id, self.spec.name, self.incarnation)
        return {**self.spec.environment, MARKER: value}

    def _check_ready(self) -> None:
        if self._incarnations.is_ready(self.spec.name, self.incarnation):
            self._budget.running()
            self._move(ChildState.RUNNING, "ready")

    def _is_reclaimed(self) -> bool:
        return not self._is_opened or self._incarnations.is_reclaimed(self.spec.name, self.incarnation)

    def _on_exit(self) -> None:
        process = self._process
        status = process.exit_status() if process else None
        if process is None or status is None:
            return
        kill_child_leftovers(process.pid, marker(self._run_id, self.spec.name, self.incarnation))
        self._release(process)
        if self.state is ChildState.STARTING and not self._kill_reason:
            self._check_ready()  # it may have become ready and ended since the last poll
        self._after_end(status, self._why(status))

    def _abandon(self) -> None:
        """Go on without a process that cannot be killed.

        Its memory is not reclaimed: the kernel may still be busy with a read into it.
        """
        if self._process:
            self._release(self._process)
            self._move(ChildState.FAILED, f"{self._kill_reason}; but it hangs in the kernel despite SIGKILL")

    def _release(self, process: ChildProcess) -> None:
        for stream in self._streams:
            stream.finish()
        self._streams = []
        self.output.report_dropped()
        self._loop.unwatch(process.pidfd)
        process.reap()
        self._process = None

    def _why(self, status: ExitStatus) -> str:
        if self._kill_reason:
            return f"{self._kill_reason}: {status.reason}"
        if status.is_clean and self.state is ChildState.STARTING and not self._was_asked_to_stop:
            return f"{status.reason} before it was ready"
        return status.reason

    def _after_end(self, status: ExitStatus | None, reason: str) -> None:
        is_clean = (
            status is not None
            and status.is_clean
            and self.state is ChildState.RUNNING
            and not self._kill_reason
        )
        if self._is_opened:
            self._incarnations.died(self.spec.name, self.incarnation)
        if self._was_asked_to_stop:
            self._move(ChildState.STOPPED, reason, status)
            return
        if is_clean and self.spec.ends_run:
            self.ended_run = True
            self._move(ChildState.STOPPED, f"{reason}: the run is over", status)
            return
        match self._budget.ended(clean=is_clean):
            case Restart(after_s=wait_s) if self._may_restart:
                self._due_s = self._clock() + wait_s
                self._move(ChildState.BACKOFF, reason, status, wait_s)
            case GiveUp(reason=why):
                self._move(ChildState.FAILED, f"{reason}; {why}", status)
            case _:
                self._move(ChildState.STOPPED, reason, status)

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
        self.was_settled = self.was_settled or new is not ChildState.STARTING
        self.state = new
        self.reason = reason
        self._incarnations.state_changed(change)
        self._on_change(self, change)
