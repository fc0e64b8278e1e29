"""The rules of a module's loop, wherever it runs: in its own process, as a tool, or in a test."""

from collections.abc import Callable
from typing import Protocol

from robbie_mp.bus.transport.history import Event
from robbie_mp.module.module import Module, calls_of, check_period, tick_is_awaited
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.ticks import Ticks


class Mail(Protocol):
    """Where a module's messages come from."""

    def handle_next(self) -> bool:
        """Handle the next message; False if there is none."""

    def wait(self, timeout_s: float, /) -> bool:
        """Wait for messages; False if the module was not woken."""

    def room_was_made(self) -> bool:
        """Whether the messages that the module waits for have been released; True only once."""


class ModuleLoop:
    """Decides what a module does next, from its setup to its teardown. C takes the same turns.

    Args:
        module: the module.
        mail: where its messages come from.
        ticks: decides when its ticks are due.
        changes: changes its settings while it runs; None: nothing does.
    """

    def __init__(self, module: Module, mail: Mail, ticks: Ticks, changes: SettingChanges | None = None):
        self._module = module
        self._mail = mail
        self._calls = calls_of(module)
        self._ticks = ticks
        self._calls.timers.count = ticks.count
        self._changes = changes

    @property
    def ends(self) -> bool:
        """Whether the module is to end after the present handler or tick."""
        return self._module.stop_requested

    def work(self, run: Callable[[], None], _event: Event) -> None:
        """Do what is due now."""
        run()

    def set_up(self) -> None:
        """Run `setup()`.

        Raises:
            InvalidPeriod: the module's `period_s` cannot be used.
        """
        if self._changes is not None:
            self._changes.listen()
        self._module.setup()
        check_period(self._module)
        self._module.show_first_states()

    def begin(self) -> None:
        """Begin, when all modules are ready; the first tick is due now."""
        self._calls.begin()
        if self._changes is not None:
            self._changes.begin()
        self._ticks.begin()

    def turn(self) -> None:
        """Handle at most one message and run at most one tick, or wait for either."""
        was_one = self._mail.handle_next()
        if (was_one and self.ends) or (self.run_calls() and self.ends):
            return
        if self._ticks.are_due():
            self.work(self._ticks.run, Event.TICK)
        elif not was_one:
            self._wait()

    def run_calls(self) -> bool:
        """Do what is due for the module's calls and deadlines; False if nothing is."""
        are_due = self._calls.are_due()
        if are_due:
            self.work(self._calls.run, Event.CALLS)
        return are_due

    def _wait(self) -> None:
        woken = self._mail.wait(min(self._ticks.wait_s(), self._calls.wait_s()))
        if woken and self._mail.room_was_made():
            self._ticks.expedite()
        if woken and tick_is_awaited(self._module):
            self._ticks.expedite()

    def tear_down(self) -> None:
        """Run `teardown()`, as on an ordered stop."""
        if self._changes is not None:
            self._changes.end()
        self._module.teardown()
