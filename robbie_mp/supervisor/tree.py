"""The supervisor's event loop: all children of a run, from the first start to the last end."""

import random
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from robbie_mp.supervisor.child_spec import ChildKind, ChildSpec, InvalidChild
from robbie_mp.supervisor.event_loop import EventLoop, signals_in_loop
from robbie_mp.supervisor.incarnations import Incarnations
from robbie_mp.supervisor.leftovers import OrphanReaper
from robbie_mp.supervisor.ordered_stop import OrderedStop
from robbie_mp.supervisor.output import OutputStore
from robbie_mp.supervisor.restart import RestartBudget
from robbie_mp.supervisor.states import ChildState, StateChange
from robbie_mp.supervisor.supervised_child import POLL_S, SupervisedChild

IDLE_POLL_S = 0.1
CLOCK_STEP_S = 0.01


class Tree:
    """Runs the children of one run, in the main thread, and returns when all have ended.

    The core starts first; when it is ready, all modules start at once. SIGINT, SIGTERM and SIGHUP stop the
    run in order; a second SIGINT or SIGTERM kills all that is left at once.

    Attributes:
        children: in the order of their start.
        stop_reason: why the run stops, empty as long as it does not.
    """

    def __init__(
        self,
        specs: Sequence[ChildSpec],
        run_id: str,
        incarnations: Incarnations,
        output: OutputStore,
        each_turn: Callable[[], None] = lambda: None,
        wall_clock: Callable[[], float] = time.time,
    ):
        """Prepare; nothing is started yet.

        Args:
            specs: the core and the modules; within each kind in the order of their start.
            run_id: marks the descendants of this run's children.
            incarnations: the memory side.
            output: takes what the children print.
            each_turn: called every turn of the loop: at least every 0.1 s, more often when things happen.
            wall_clock: what waits of semaphores are measured by (CLOCK_REALTIME).

        Raises:
            InvalidChild: two children have the same name.
        """
        names = [spec.name for spec in specs]
        if len(set(names)) < len(names):
            raise InvalidChild(f"each child needs a name of its own, but they are {', '.join(sorted(names))}")
        self.stop_reason = ""
        self._incarnations = incarnations
        self._each_turn = each_turn
        self._clock = time.monotonic
        self._wall_clock = wall_clock
        self._clock_offset_s = wall_clock() - self._clock()
        self._loop = EventLoop(self._clock)
        self._stop: OrderedStop | None = None
        self._were_modules_started = False
        self._was_all_started = False
        ordered = sorted(specs, key=lambda spec: spec.kind is not ChildKind.CORE)
        self.children = [self._child(spec, run_id, output) for spec in ordered]

    def run(self) -> int:
        """Run to the end and return the exit code: 1 if a child is FAILED, else 0."""
        with ExitStack() as stack:
            stack.callback(self._loop.close)
            stack.callback(self._incarnations.close)
            orphans = stack.enter_context(OrphanReaper())
            stack.callback(self._kill_rest)
            signums = [signal.SIGINT, signal.SIGTERM]
            if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup(1)
                signums.append(signal.SIGHUP)
            stack.enter_context(signals_in_loop(self._loop, signums, self._on_signal))
            while self._turn():
                orphans.reap({child.pid for child in self.children if child.pid})
        return int(any(child.state is ChildState.FAILED for child in self.children))

    def stop(self, reason: str) -> None:
        """Begin an ordered stop; further calls change nothing."""
        if self._stop:
            return
        self.stop_reason = reason
        self._stop = OrderedStop(self.children, self._clock)
        for child in self.children:
            child.do_not_restart(f"not started: {reason}")

    def kill_all(self, reason: str) -> None:
        """Kill all children at once and end the run."""
        self.stop(reason)
        for child in self.children:
            child.stop_now(reason)

    def child(self, name: str) -> SupervisedChild:
        """Return a child, so that a watchdog can kill it or send it a signal.

        Raises:
            KeyError: there is none of that name.
        """
        for child in self.children:
            if child.spec.name == name:
                return child
        raise KeyError(f"no child is named {name!r}")

    def watch(self, fd: int, callback: Callable[[], None]) -> None:
        """Call back from the loop whenever a descriptor, such as a control socket, is readable."""
        self._loop.watch(fd, callback)

    def unwatch(self, fd: int) -> None:
        """Stop watching a descriptor; must come before it is closed."""
        self._loop.unwatch(fd)

    def _child(self, spec: ChildSpec, run_id: str, output: OutputStore) -> SupervisedChild:
        return SupervisedChild(
            spec,
            run_id,
            self._incarnations,
            output.child(spec.name),
            self._loop,
            RestartBudget(spec.restart, self._clock, random.random),
            self._clock,
            self._on_change,
        )

    def _turn(self) -> bool:
        """Go round the loop once; False when the run is over."""
        self._start_what_may()
        self._loop.turn(self._timeout_s())
        for child in self.children:
            child.poll()
        self._announce_all_started()
        self._check_clock_step()
        self._each_turn()
        if all(c.state and c.state.is_final for c in self.children if c.spec.kind is ChildKind.MODULE):
            self.stop("all modules have ended")
        if self._stop:
            self._stop.step()
        return not (self._stop and all(child.pid is None for child in self.children))

    def _timeout_s(self) -> float:
        waits = [child.poll_in_s() for child in self.children]
        if self._stop:
            waits.append(self._stop.next_in_s())
        return min([IDLE_POLL_S, *(wait for wait in waits if wait is not None)])

    def _start_what_may(self) -> None:
        for child in self.children:
            is_core = child.spec.kind is ChildKind.CORE
            if child.state is None and (is_core or self._is_core_ready()):
                child.start()

    def _is_core_ready(self) -> bool:
        return all(c.state is ChildState.RUNNING for c in self.children if c.spec.kind is ChildKind.CORE)

    def _announce_all_started(self) -> None:
        if not self._was_all_started and not self._stop and all(child.was_settled for child in self.children):
            self._was_all_started = True
            self._incarnations.all_started()

    def _check_clock_step(self) -> None:
        """Wake everyone when the wall clock was set: their timed waits would last as much too long."""
        offset_s = self._wall_clock() - self._clock()
        if abs(offset_s - self._clock_offset_s) > CLOCK_STEP_S:
            for child in self.children:
                child.wake()
        self._clock_offset_s = offset_s

    def _on_signal(self, signum: int) -> None:
        name = signal.Signals(signum).name
        # A closing terminal may send SIGHUP twice; that is nobody's impatience.
        if self._stop and signum != signal.SIGHUP:
            self.kill_all(f"second signal, {name}")
        else:
            self.stop(name)

    def _on_change(self, child: SupervisedChild, change: StateChange) -> None:
        name = child.spec.name
        if child.ended_run:
            self.stop(f"{name} ended the run")
        is_needed = child.spec.essential or child.spec.ends_run or child.spec.kind is ChildKind.CORE
        if change.new is ChildState.FAILED and is_needed:
            self.stop(f"{name} is FAILED: {change.reason}")

    def _kill_rest(self) -> None:
        """Leave no child behind, whatever error ended the loop; close their log files."""
        self.kill_all("the supervisor ends")
        while any(child.pid for child in self.children):
            self._loop.turn(POLL_S)
            for child in self.children:
                child.poll()
        for child in self.children:
            child.output.close()
