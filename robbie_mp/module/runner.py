"""Runs a module in its own process."""

import os
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.history import Event, OwnHistory, record_nothing
from robbie_mp.bus.transport.layout import Activity, ModulePhase
from robbie_mp.bus.transport.records import Outbound
from robbie_mp.messages import SettingChange
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.loop import ModuleLoop
from robbie_mp.module.membership import Membership
from robbie_mp.module.module import Module
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.ticks import MAX_WAIT_S, Ticks, TimedTicks

if TYPE_CHECKING:
    from robbie_mp.bus._hot.native import TickTimes

ROOM_WAIT_S = 0.01
"""Wait between two looks whether the core has made room for what did not fit into the ring."""
MAX_IDLE_WAITS = 10
"""How often a stopping module waits for messages that the core has not delivered yet."""


class ModuleRunner(ModuleLoop):
    """Runs one module from setup to teardown.

    Args:
        module: what to run.
        place: its memory, and its connection to the core.
        inbox, outbox: its messages.
        ticks: decides when its ticks are due.
        changes: changes its settings while it runs.
        has_just_settled: for the module that turns the clock of a run in lockstep: whether what it waits for
            has just come; None for all other modules.
        history: what it has handled; None: that is not kept.
    """

    def __init__(
        self,
        module: Module,
        place: Membership,
        inbox: Inbox,
        outbox: Outbox,
        ticks: Ticks,
        changes: SettingChanges,
        has_just_settled: Callable[[], bool] | None = None,
        history: OwnHistory | None = None,
    ):
        super().__init__(module, self, ticks, changes)
        self._place = place
        self._inbox = inbox
        self._outbox = outbox
        self._wakeup = wakeup = place.memory.wakeup
        self._record: Callable[..., None] = record_nothing if history is None else history.append
        self._prepare = record_nothing if history is None else history.prepare
        self._stopping = False
        self.handle_next = inbox.handle_next
        self._has_just_settled = has_just_settled
        self._turn_in_c: Callable[[], bool] | None = None
        """Takes a turn of the common form; None, or its answer False: Python does it."""
        if (
            place.native is not None
            and isinstance(ticks, TimedTicks)
            and ticks.follow_the_machine
            and has_just_settled is None
            and wakeup.sleeps_in_c
        ):
            self._turn_in_c = place.native.Loop(
                self,
                inbox.native,
                inbox,
                outbox,
                module,
                self._calls,
                ticks,
                cast("TickTimes", ticks.times),
                wakeup.post,
                round(MAX_WAIT_S * 1e9),
            ).turn

    def request_stop(self) -> None:
        """End the loop after the present handler or tick; safe in a signal handler."""
        self._stopping = True

    def set_up(self) -> None:
        """Run `setup()`, and show it."""
        self._set_up_ns = self._inbox.show(Activity.SETUP)
        threads = threading.active_count()
        super().set_up()
        if not self.ends and threading.active_count() <= threads and self._is_idle():
            self._module.log.warning(
                "%s does nothing: it has no subscription, service, timer, thread or tick()",
                type(self._module).__name__,
            )
        self._inbox.show_idle()

    def _is_idle(self) -> bool:
        """Whether nothing will ever call the module, and it has not published anything either."""
        cls, module = type(self._module), self._module
        is_called = any(one.name.type_name != SettingChange.type_name for one in self._inbox.subscriptions)
        return not (
            is_called
            or module.period_s is not None
            or len(self._calls.timers)
            or cls.setting_changed is not Module.setting_changed
            or self._place.words[layout.OUT_PUBLISHED]
        )

    def run(self) -> None:
        """Run the module, which has been set up, until it is stopped or stops itself.

        Its last act is to say that it has ended as it was meant to: a library may end its process, too.
        """
        own_pid = os.getpid()
        try:
            self._run()
        except SystemExit:
            if os.getpid() == own_pid:  # not in a process that a handler has forked
                self._place.words[layout.OUT_READY] = ModulePhase.ENDED
            raise
        self._place.words[layout.OUT_READY] = ModulePhase.ENDED

    def _run(self) -> None:
        self._ticks.begin()
        # In this order: a module that is stopped in between is STARTING, and has a deadline.
        self._place.endpoint.send(Outbound.READY)
        self._place.words[layout.OUT_READY] = ModulePhase.READY
        while not self.ends and not self._place.peers.may_go:
            # The start waits until the core has read all declarations.
            is_all_pushed = self._place.endpoint.push_backlog()
            self._wakeup.wait(MAX_WAIT_S if is_all_pushed else ROOM_WAIT_S)
        self._record(Event.BEGUN, time.monotonic_ns(), self._set_up_ns)
        self.begin()
        self._take_turns()
        if self._module.patience_s:
            self._handle_the_rest()
        self._record(Event.TEARDOWN, self._inbox.show(Activity.TEARDOWN))
        self.tear_down()
        self._inbox.show_idle()
        self._inbox.release_unreferenced()
        self._outbox.close()

    @property
    def ends(self) -> bool:
        """Whether the module is to end after the present handler or tick."""
        return self._stopping or self._module.stop_requested

    def _take_turns(self) -> None:
        module, turn_in_c = self._module, self._turn_in_c
        while not (self._stopping or module.stop_requested):  # `ends`, without a call
            if turn_in_c is None or not turn_in_c():
                self.turn()

    def _handle_the_rest(self) -> None:
        """Handle the messages that were published before the stop and that `patience_s` kept waiting.

        The core may deliver them late, and not in the order in which different rings were written. So this
        continues until a little after the stop, and while messages wait in the core.
        """
        until_ns = time.monotonic_ns() + round(MAX_WAIT_S * 1e9)
        stamp_ns = idle = 0
        while stamp_ns <= until_ns and idle < MAX_IDLE_WAITS:
            delivery = self._inbox.take()
            if delivery is not None:
                stamp_ns, idle = delivery.stamp_ns, 0
                self._inbox.handle(delivery)
            elif not self._wakeup.wait(MAX_WAIT_S):
                if not self._place.peers.have_sent_more():
                    return
                idle += 1

    def wait(self, timeout_s: float) -> bool:
        """Wait for messages; False if the module was not woken."""
        self._prepare()
        woken = self._wakeup.wait(timeout_s)
        if self._has_just_settled is not None and self._has_just_settled():
            self._ticks.expedite()
        return woken

    def room_was_made(self) -> bool:
        """Whether the messages that the module waits for have been released; True only once."""
        return self._outbox.awaits_room and self._outbox.room_was_made()

    def work(self, run: Callable[[], None], event: Event) -> None:
        """Do what is due now, and show it."""
        self._record(event, self._inbox.show(Activity.TICK))
        run()
        self._inbox.show_idle()
