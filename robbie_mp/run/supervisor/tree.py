"""The supervisor's event loop: all children of a run, from the first start to the last end."""

import random
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.suggest import did_you_mean
from robbie_mp.run.profile.dependencies import with_dependents
from robbie_mp.run.profile.model import BLACK_BOX
from robbie_mp.run.supervisor.child_spec import ChildKind, ChildSpec, InvalidChild
from robbie_mp.run.supervisor.deadlines import RunningTime
from robbie_mp.run.supervisor.event_loop import EventLoop, signals_in_loop
from robbie_mp.run.supervisor.incarnations import Incarnations
from robbie_mp.run.supervisor.leftovers import OrphanReaper
from robbie_mp.run.supervisor.output import OutputStore
from robbie_mp.run.supervisor.restart import RestartBudget
from robbie_mp.run.supervisor.spares import Rehearsal, SpareCommand, SparePool
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.supervised_child import POLL_S, ChildServices, SupervisedChild, Then
from robbie_mp.run.trace.kinds import Kind


class Dependencies:
    """Knows which children are restarted together, from the `depends_on` of their specs.

    Similar to Erlang's `rest_for_one`, but for declared dependents only, and without waiting for their end.
    """

    def __init__(self, children: Sequence[SupervisedChild]):
        """Keep the list of all children, in the order of their start."""
        self._children = children

    def dependents(self, child: SupervisedChild) -> list[SupervisedChild]:
        """Return the children that depend on a child, directly or indirectly, in the order of their start."""
        reached = with_dependents(
            child.spec.name, {c.spec.name: c.spec.module.depends_on for c in self._children}
        )
        return [c for c in self._children if c.spec.name in reached and c is not child]

    def are_settled(self, child: SupervisedChild) -> bool:
        """Whether each child that this one depends on is RUNNING, FAILED or STOPPED."""
        return all(
            (other.state is ChildState.RUNNING and not other.is_stopping)
            or (other.state is not None and other.state.is_final)
            for other in self._children
            if other.spec.name in child.spec.module.depends_on
        )


class OrderedStop:
    """Stops children one after another, last started first: SIGTERM, then SIGKILL after the grace period."""

    def __init__(
        self, children: Sequence[SupervisedChild], then: Then, reason: str, clock: Callable[[], float]
    ):
        """Begin with the last.

        Args:
            children: in the order of their start.
            then: what follows for each.
            reason: why; see `SupervisedChild.will_stop`.
            clock: monotonic time in s.
        """
        for child in children:
            child.will_stop(then, reason)
        self._waiting = [(child, child.incarnation) for child in children]
        self._clock = clock
        self._current: tuple[SupervisedChild, int] | None = None
        self._kill_at_s = 0.0

    def step(self) -> None:
        """Do all work that is due now, without waiting."""
        while self._waiting and self._living() is None:
            self._current = self._waiting.pop()
            if child := self._living():
                self._kill_at_s = self._clock() + child.spec.module.stop_grace_s
                child.terminate()
        child = self._living()
        if child and self._clock() >= self._kill_at_s:
            child.kill(f"did not stop within {child.spec.module.stop_grace_s:g} s")

    @property
    def is_over(self) -> bool:
        """Whether all have ended."""
        return not self._waiting and self._living() is None

    def next_in_s(self) -> float | None:
        """Return how soon the current grace period ends; None if no child is waited for."""
        return max(0.0, self._kill_at_s - self._clock()) if self._living() else None

    def _living(self) -> SupervisedChild | None:
        """Return the child that is waited for, unless a later incarnation has taken its place."""
        if self._current is None:
            return None
        child, incarnation = self._current
        return child if child.pid is not None and child.incarnation == incarnation else None


IDLE_POLL_S = 0.1
CLOCK_STEP_S = 0.01
SAY_AWAITED_AFTER_S = 5.0
MAX_NAMED = 6
ECHO_S = 0.3
"""A signal that follows another one this soon was sent by the same event."""


class NoSuchChild(RobbieError, LookupError):
    """No child has that name.

    Example scenarios:
      - `robbie module restart lazer`
    """


class CannotControl(RobbieError, RuntimeError):
    """A child cannot be stopped or restarted now.

    Example scenarios:
      - the run is stopping
      - the child is stopped already
      - the child is the core, without which nothing runs
    """


class Tree:
    """Runs the children of one run, in the main thread, and returns when all have ended.

    The core starts first; when it is ready, all modules start at once. SIGINT, SIGTERM and SIGHUP stop the
    run in order; a second SIGINT or SIGTERM kills all remaining processes at once.

    Attributes:
        children: in the order of their start.
        output: what the children print.
        helper_pids: returns the pids of the supervisor's further processes.
        before_output_ends: called when all children have ended, while remarks can still be added.
        is_put_back: called with each change; whether a module on trial has ended and is replaced, so that the
            robot need not stop.
        stop_reason: why the run stops; empty while it does not.
    """

    def __init__(
        self,
        specs: Sequence[ChildSpec],
        run_id: str,
        incarnations: Incarnations,
        output: OutputStore,
        each_turn: Callable[[], None] = lambda: None,
        wall_clock: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
        spares: SpareCommand | None = None,
    ):
        """Prepare; nothing is started yet.

        Args:
            specs: the core and the modules; within each kind in the order of their start.
            run_id: marks the descendants of this run's children.
            incarnations: manages the shared memory.
            output: receives what the children print.
            each_turn: called in every iteration of the loop: at least every 0.1 s, more often on events.
            wall_clock: the clock of time stamps (CLOCK_REALTIME), in s.
            clock: monotonic time in s, for everything else.
            spares: starts spare interpreters for restarts; None: every process starts cold.

        Raises:
            InvalidChild: two children have the same name.
        """
        names = [spec.name for spec in specs]
        if len(set(names)) < len(names):
            raise InvalidChild(f"each child needs a unique name; the names are {', '.join(sorted(names))}")
        self.stop_reason = ""
        self._has_failed = False
        self._incarnations = incarnations
        self._each_turn = each_turn
        self.helper_pids: Callable[[], set[int]] = set
        self.before_output_ends: Callable[[], None] = lambda: None
        self.is_put_back: Callable[[SupervisedChild, StateChange], bool] = lambda _child, _change: False
        self._clock = RunningTime(clock)
        self._wall_clock = wall_clock
        self._clock_offset_s = wall_clock() - self._clock()
        self._loop = EventLoop(self._clock)
        self._stop: OrderedStop | None = None
        self._first_signal_s: float | None = None
        self._partial_stops: list[OrderedStop] = []
        self._was_all_started = False
        self._began_s = self._clock()
        self._say_awaited_after_s = SAY_AWAITED_AFTER_S
        ordered = sorted(specs, key=lambda spec: spec.kind is not ChildKind.CORE)
        self.output = output
        self._own_output = output.child("supervisor")
        self._spares = SparePool(spares, run_id, self._loop, self._own_output, self._clock)
        self.children: list[SupervisedChild] = []
        self._dependencies = Dependencies(self.children)
        self.children += [self._child(spec, output) for spec in ordered]

    @property
    def has_started(self) -> bool:
        """Whether every module has started or ended."""
        return self._was_all_started

    def run(self) -> int:
        """Run to the end and return the exit code.

        Returns:
            1 if a child is FAILED, never came up or did not end in order, or if the run itself has failed;
            else 0.
        """
        with ExitStack() as stack:
            stack.callback(self._loop.close)
            stack.callback(self._incarnations.close)
            orphans = stack.enter_context(OrphanReaper())
            stack.callback(self._close_output)
            stack.callback(self._end_helpers)
            stack.callback(self._spares.close)
            stack.callback(self._kill_remaining)
            signums = [signal.SIGINT, signal.SIGTERM]
            if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup(1)
                signums.append(signal.SIGHUP)
            stack.enter_context(signals_in_loop(self._loop, signums, self._on_signal))
            while self._turn():
                orphans.reap(self._known_pids())
            self._report_unfinished()
            self._report_never_up()
        is_failed = (
            child.state is ChildState.FAILED or child.unfinished or child.never_came_up
            for child in self.children
        )
        return int(self._has_failed or any(is_failed))

    def stop(self, reason: str, *, has_failed: bool = False) -> None:
        """Begin an ordered stop; further calls have no effect.

        Args:
            reason: why.
            has_failed: whether the run has failed, so that its exit code is 1.
        """
        if self._stop:
            return
        self.stop_reason = reason
        self._has_failed = has_failed
        self._say(f"the run stops: {reason}")
        self._stop = OrderedStop(self.children, Then.STOPPED, "", self._clock)
        self._partial_stops.clear()
        for child in self.children:
            child.do_not_restart(f"not started: {reason}")

    def kill_all(self, reason: str) -> None:
        """Kill all children at once and end the run."""
        self.stop(reason)
        if any(child.pid for child in self.children):
            self._say(f"all processes are killed: {reason}")
        for child in self.children:
            child.stop_now(reason)

    def child(self, name: str) -> SupervisedChild:
        """Return a child.

        Raises:
            NoSuchChild: no child has that name.
        """
        for child in self.children:
            if child.spec.name == name:
                return child
        names = [child.spec.name for child in self.children]
        near = did_you_mean(name, names) or f"; there are {', '.join(names)}"
        raise NoSuchChild(f"no module is named {name!r}{near}")

    def stop_child(self, name: str, reason: str) -> SupervisedChild:
        """Stop one child in order; it stays stopped until `restart_child` or `start_child`.

        Raises:
            NoSuchChild: no child has that name.
            CannotControl: it is the core, has already ended, or hangs in the kernel, or the run stops.
        """
        child = self._controlled(name)
        child.output.say(Kind.SYSTEM, f"to be {reason}")
        if child.spec.kind is ChildKind.CORE:
            raise CannotControl(
                "the core cannot be stopped alone, because nothing runs without it; stop the run"
            )
        if trouble := child.when_it_ends(Then.STOPPED, reason):
            raise CannotControl(f"{name}: {trouble}; {name} stays stopped when that process has ended")
        if child.state is not None and child.state.is_final and not child.awaits_retry:
            raise CannotControl(f"{name} is {child.state} already ({child.reason})")
        if child.pid is None:
            child.stay_stopped(reason)
        else:
            self._partial_stops.append(OrderedStop([child], Then.STOPPED, reason, self._clock))
        return child

    def restart_child(self, name: str, reason: str) -> SupervisedChild:
        """Stop one child in order if it has a process, then start it with a fresh budget.

        Raises:
            NoSuchChild: no child has that name.
            CannotControl: the run stops, or its process hangs in the kernel; it is then started as soon as
                that process has ended.
        """
        child = self._controlled(name)
        child.output.say(Kind.SYSTEM, f"to be {reason}")
        if trouble := child.when_it_ends(Then.RESTART, reason):
            raise CannotControl(f"{name}: {trouble}; {name} is started as soon as that process has ended")
        child.restart_now(reason)
        if child.pid is not None:
            self._partial_stops.append(OrderedStop([child], Then.RESTART, reason, self._clock))
        return child

    def start_child(self, name: str, reason: str) -> SupervisedChild:
        """Start a child that has ended or waits for a restart, with a fresh budget.

        Raises:
            NoSuchChild: no child has that name.
            CannotControl: it has a process already, or one that hangs in the kernel, or the run stops.
        """
        child = self._controlled(name)
        if child.pid is not None:
            raise CannotControl(f"{name} is {child.state} already; use `robbie module restart`")
        return self.restart_child(name, reason)

    def _controlled(self, name: str) -> SupervisedChild:
        if self._stop:
            raise CannotControl(f"the run is stopping: {self.stop_reason}")
        return self.child(name)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        """Have a spare interpreter find out whether a module could be started with its code of now."""
        self._spares.rehearse(rehearsal)

    def watch(self, fd: int, callback: Callable[[], None]) -> None:
        """Call back from the loop whenever a descriptor is readable."""
        self._loop.watch(fd, callback)

    def unwatch(self, fd: int) -> None:
        """Stop watching a descriptor. Call this before you close it."""
        self._loop.unwatch(fd)

    def say(self, kind: Kind, text: str) -> None:
        """Write an entry of the supervisor's own into the trace."""
        self._own_output.say(kind, text)

    def _say(self, text: str) -> None:
        self.say(Kind.SYSTEM, text)

    def _child(self, spec: ChildSpec, output: OutputStore) -> SupervisedChild:
        surroundings = ChildServices(
            self._incarnations,
            self._loop,
            self._clock,
            self._spares.start,
            self._known_pids,
            self._dependencies.are_settled,
            self._on_change,
        )
        budget = RestartBudget(spec.module.restart, self._clock, random.random)
        return SupervisedChild(spec, output.child(spec.name, spec.record), budget, surroundings)

    def _end_helpers(self) -> None:
        self.before_output_ends()

    def _known_pids(self) -> set[int]:
        return self._spares.pids.union(
            self.output.disk.pids, self.helper_pids(), *(child.pids for child in self.children)
        )

    def _turn(self) -> bool:
        """Run one iteration of the loop; return False when the run is over."""
        self._start_allowed()
        self._loop.turn(self._timeout_s())
        for child in self.children:
            child.poll()
        self._announce_all_started()
        self._say_who_is_awaited()
        self._check_clock_step()
        if news := self.output.turn():
            self.say(Kind.WARNING, news)
        self._each_turn()
        modules = [
            child
            for child in self.children
            if child.spec.kind is ChildKind.MODULE and child.spec.name != BLACK_BOX
        ]
        if all(child.state and child.state.is_final and not child.may_return for child in modules):
            self.stop("all modules have ended")
        for stop in [self._stop] if self._stop else self._partial_stops:
            stop.step()
        self._partial_stops = [stop for stop in self._partial_stops if not stop.is_over]
        self._spares.replenish(is_calm=not self._stop and self._is_calm())
        return not (self._stop and all(child.pid is None for child in self.children))

    def _timeout_s(self) -> float:
        waits = [child.poll_in_s() for child in self.children]
        waits += [stop.next_in_s() for stop in ([self._stop] if self._stop else self._partial_stops)]
        longest_s = IDLE_POLL_S if self._was_all_started else POLL_S
        return min([longest_s, *(wait for wait in waits if wait is not None)])

    def _start_allowed(self) -> None:
        for child in self.children:
            is_core = child.spec.kind is ChildKind.CORE
            if child.state is None and (is_core or self._is_core_ready()):
                child.start()

    def _is_core_ready(self) -> bool:
        return all(c.state is ChildState.RUNNING for c in self.children if c.spec.kind is ChildKind.CORE)

    def _is_calm(self) -> bool:
        """Whether no child is starting or stopping."""
        states = {child.state for child in self.children}
        return not self._partial_stops and not states & {None, ChildState.STARTING, ChildState.BACKOFF}

    def _announce_all_started(self) -> None:
        if self._was_all_started or self._stop or not all(child.was_settled for child in self.children):
            return
        if self._incarnations.are_subscribed():
            self._was_all_started = True
            self.say(Kind.INFO, "every module has started or ended: messages flow")
            self._incarnations.all_started()

    def _say_who_is_awaited(self) -> None:
        """Say which modules a start waits for: after 5 s, and again each time that has doubled."""
        waited_s = self._clock() - self._began_s
        if self._was_all_started or self._stop or waited_s < self._say_awaited_after_s:
            return
        self._say_awaited_after_s *= 2
        awaited = [
            f"{child.spec.name} ({child.state or 'waits for the core'})"
            for child in self.children
            if not child.was_settled
        ] or ["the core, which has yet to read what modules subscribe"]
        if len(awaited) > MAX_NAMED:
            awaited[MAX_NAMED:] = [f"{len(awaited) - MAX_NAMED} more"]
        self.say(Kind.INFO, f"after {waited_s:.0f} s, the start still waits for {', '.join(awaited)}")

    def _check_clock_step(self) -> None:
        """Say when the wall clock was set: the stamps of messages and of the trace jump with it."""
        offset_s = self._wall_clock() - self._clock()
        if abs(step_s := offset_s - self._clock_offset_s) > CLOCK_STEP_S:
            self._say(f"the wall clock was set by {step_s:+.3f} s")
        self._clock_offset_s = offset_s

    def _on_signal(self, signum: int) -> None:
        name = signal.Signals(signum).name
        self._say(f"got {name}")
        # `timeout` signals the supervisor, and at once its process group; a closing terminal may send SIGHUP
        # twice, with any pause. Neither is a request to hurry.
        first_s = self._first_signal_s
        if first_s is None or signum == signal.SIGHUP or self._clock() - first_s < ECHO_S:
            self._first_signal_s = self._clock() if first_s is None else first_s
            self.stop(name)
        else:
            self.kill_all(f"second signal, {name}")

    def _on_change(self, child: SupervisedChild, change: StateChange) -> None:
        name = child.spec.name
        if child.ended_run:
            self.stop(f"{name} ended the run")
        is_put_back = self.is_put_back(child, change)
        if change.new is ChildState.BACKOFF or (change.new is ChildState.RUNNING and child.is_retried):
            self._restart_dependents(child)
        if change.new is ChildState.FAILED and child.spec.is_needed and not is_put_back:
            self.stop(f"{name} is FAILED: {change.reason}")

    def _restart_dependents(self, child: SupervisedChild) -> None:
        """Stop the dependents of a child that is restarted; they wait in BACKOFF until it is RUNNING."""
        dependents = [c for c in self._dependencies.dependents(child) if c.pid is not None]
        if running := [dependent for dependent in dependents if not dependent.is_stopping]:
            reason = f"restarted with {child.spec.name}"
            for dependent in running:
                dependent.output.say(Kind.SYSTEM, f"to be {reason}")
            self._partial_stops.append(OrderedStop(running, Then.RESTART, reason, self._clock))

    def _report_unfinished(self) -> None:
        """Report the children that did not end in order: nobody has written their results."""
        for child in self.children:
            if not child.unfinished:
                continue
            name, is_core = child.spec.name, child.spec.kind is ChildKind.CORE
            missing = (
                "messages that were published after that" if is_core else "results that teardown() writes"
            )
            self.stop_reason += f"; {name} did not end in order"
            self.say(Kind.ERROR, f"{name} did not end in order: {child.unfinished}; {missing} are missing")

    def _report_never_up(self) -> None:
        """Report the children that never were RUNNING; one that is FAILED has its own report."""
        for child in self.children:
            if child.never_came_up and child.state is not ChildState.FAILED:
                self.stop_reason += f"; {child.spec.name} never came up"
                self.say(Kind.ERROR, f"{child.spec.name} never came up: {child.reason}")

    def _close_output(self) -> None:
        self._say("all children have ended")
        for child in self.children:
            child.output.close()
        self._own_output.close()
        self.output.close()

    def _kill_remaining(self) -> None:
        """Kill all children, whatever error ended the loop; those that cannot end are abandoned."""
        self.kill_all("the supervisor ends")
        while any(child.pid for child in self.children):
            self._loop.turn(POLL_S)
            for child in self.children:
                child.poll()
        for child in self.children:
            child.let_go()
