"""All calls, services, deadlines and timers of one module, and what is due for them."""

import logging
import math
import threading
from collections.abc import Callable

from robbie_mp.module.bus import Bus
from robbie_mp.module.calls.client import ClientCalls
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.calls.errors import CalledInSetup, WrongThread
from robbie_mp.module.calls.server import ServiceCalls
from robbie_mp.module.clock import Clock
from robbie_mp.module.deadlines import Deadlines
from robbie_mp.module.health import Health
from robbie_mp.module.timers import Timers


class Calls:
    """The calls, services, deadlines and timers of one module.

    Args:
        bus: the module's bus.
        clock: the module's clock.
        log: the module's logger.
        health: the module's health.

    Attributes:
        client: the calls that it makes.
        server: the services that it offers.
        deadlines: of its subscriptions.
        timers: the functions that it calls periodically.
        due: when `run` has something to do next; a module that has never called or served pays for no more
            than a look at it.
        is_granted: whether time passes only by granted ticks, as in lockstep; then `run_granted` does what
            depends on the module's clock.
    """

    def __init__(self, bus: Bus, clock: Clock, log: logging.Logger, health: Health | None = None):
        self._bus = bus
        self.due = Due()
        self.client = ClientCalls(bus, clock, log, self.due)
        self.server = ServiceCalls(bus, log, self.due)
        self.deadlines = Deadlines(bus, clock, health or Health(log.warning), self.due)
        self.timers = Timers(bus, clock, self.due)
        self._later: list[tuple[int, Callable[[], None]]] = []
        self._thread = threading.get_ident()
        self.is_granted = False
        self._has_begun = False

    def check_thread(self) -> None:
        """Check that the module's main thread runs, which is about to call or serve.

        Raises:
            WrongThread: another thread does.
        """
        if threading.get_ident() != self._thread:
            raise WrongThread("call and serve only in the module's main thread, as handlers and ticks do")

    def check_begun(self) -> None:
        """Check that all modules are ready, and this thread is the module's main thread.

        Raises:
            CalledInSetup: they are not.
            WrongThread: another thread runs.
        """
        if not self._has_begun or threading.get_ident() != self._thread:
            self.check_thread()
            raise CalledInSetup("not every module serves yet; call from the first message or tick on")

    def begin(self) -> None:
        """Begin, when all modules are ready.

        Raises:
            ServedTwice: another module serves the same.
        """
        self._has_begun = True
        if self.server.are_any:
            self.server.check_rivals()
        self.deadlines.begin()
        self.timers.begin()

    def call_later(self, delay_s: float, action: Callable[[], None]) -> None:
        """Do something once, between two messages or ticks.

        Args:
            delay_s: when, from now on, by the machine's clock.
            action: what.
        """
        due_ns = self._bus.peers.now_ns() + round(delay_s * 1e9)
        self._later.append((due_ns, action))
        self.due.bring_forward(due_ns)

    def _run_later(self) -> int:
        """Do what was put off until now; return when the next action is due."""
        now_ns = self._bus.peers.now_ns()
        due = [action for due_ns, action in self._later if due_ns <= now_ns]
        self._later = [entry for entry in self._later if entry[0] > now_ns]
        for action in due:
            action()
        return min((due_ns for due_ns, _ in self._later), default=NEVER_NS)

    def wait_s(self) -> float:
        """Return how long the module may wait for messages, in s; infinite if nothing is due."""
        due_ns = self.due.ns
        return math.inf if due_ns == NEVER_NS else max(0.0, (due_ns - self._bus.peers.now_ns()) / 1e9)

    def are_due(self) -> bool:
        """Whether there may be something to do."""
        return self.due.ns != NEVER_NS and self._bus.peers.now_ns() >= self.due.ns

    def run(self) -> None:
        """Do what is due.

        Raises:
            ServedTwice: as for `begin`.
        """
        client, server = self.client, self.server
        if len(client):
            if client.is_look_due():
                if not self.is_granted:
                    client.expire()
                client.look()
            client.report()
        if server.are_any and self._bus.peers.now_ns() >= server.look_again_ns:
            server.check_rivals()
        later_ns = self._run_later() if self._later else NEVER_NS
        if not self.is_granted:
            self.deadlines.look()
            self.timers.run()
            later_ns = min(later_ns, self.deadlines.due_ns, self.timers.due_ns)
        self.due.ns = min(client.due_ns(), server.due_ns(), later_ns)

    def run_granted(self) -> None:
        """Do what is due by the module's clock, when a tick is granted."""
        if len(self.client):
            self.client.expire()
            self.client.report()
        self.deadlines.look()
        self.timers.run()

    def end_handling(self) -> None:
        """Report errors before other processes can see that a message was handled."""
        if self.client.has_failed_calls:
            self.client.report()
