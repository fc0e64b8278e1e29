"""The main loop of a module's process: wait, take, dispatch, release."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.endpoint import Endpoint
from robbie_mp.bus.transport.histogram import WorkFigures
from robbie_mp.bus.transport.layout import Activity
from robbie_mp.bus.transport.records import Delivery, Outbound
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.bus.transport.words import WORD_BYTES, Words, row_writer
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.module import Module, calls_of, check_period, tick_is_awaited
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.ticks import MAX_WAIT_S, Ticks, TimedTicks

if TYPE_CHECKING:
    from robbie_mp.bus._hot.native import TickTimes

# Looked up once, not for every message.
_HANDLER, _IDLE = int(Activity.HANDLER), int(Activity.IDLE)
_ACTIVITY = layout.OUT_ACTIVITY
_ACTIVITY_AT = layout.OUT_ACTIVITY_SINCE_NS * WORD_BYTES


MAX_IDLE_WAITS = 10
"""How often a stopping module waits for messages that the core has not delivered yet."""


class ModuleRunner:
    """Runs one module from setup to teardown.

    Args:
        module: what to run.
        endpoint, inbox, outbox: its connection to the core.
        wakeup: what wakes it.
        words: its out segment.
        may_go: whether every module of the run is ready.
        changes: changes its settings while it runs.
        ticks: decides when its ticks are due.
        something_waits: whether messages wait for it in the core.
        has_just_settled: for the module that turns the clock of a run in lockstep: whether what it waits for
            has just come; None for all other modules.
        after_setup: called once, when `setup()` is over and its threads have been started.
        native: what is written in C, which the others use as well; None: Python does it.
    """

    def __init__(
        self,
        module: Module,
        endpoint: Endpoint,
        inbox: Inbox,
        outbox: Outbox,
        wakeup: Wakeup,
        words: Words,
        may_go: Callable[[], bool],
        changes: SettingChanges,
        ticks: Ticks,
        something_waits: Callable[[], bool],
        has_just_settled: Callable[[], bool] | None = None,
        after_setup: Callable[[], None] = lambda: None,
        native: Native | None = None,
    ):
        self._module = module
        self._calls = calls_of(module)
        self._endpoint = endpoint
        self._inbox = inbox
        self._outbox = outbox
        self._wakeup = wakeup
        self._words = words
        self._write_activity = row_writer(words, 2)
        self._may_go = may_go
        self._changes = changes
        self._stopping = False
        self._messages = WorkFigures(words, layout.OUT_MESSAGE_FIGURES)
        self._ticks = ticks
        self._something_waits = something_waits
        self._has_just_settled = has_just_settled
        self._after_setup = after_setup
        self._turn_in_c: Callable[[], bool] | None = None
        """Takes a turn of the common form; None, or its answer False: Python does it."""
        if (
            native is not None
            and isinstance(ticks, TimedTicks)
            and ticks.follow_the_machine
            and has_just_settled is None
            and wakeup.sleeps_in_c
        ):
            self._turn_in_c = native.Loop(
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

    def run(self) -> None:
        """Run the module until it is stopped or stops itself."""
        self._begin(Activity.SETUP)
        self._changes.listen()
        self._module.setup()
        self._after_setup()
        check_period(self._module)
        self._ticks.begin()
        self._idle()
        self._words[layout.OUT_READY] = 1
        self._endpoint.send(Outbound.READY)
        while not self.ends and not self._may_go():
            self._wakeup.wait(MAX_WAIT_S)
        self._calls.begin()
        self._changes.begin()
        self._ticks.begin()
        self._take_turns()
        if self._module.patience_s:
            self._handle_the_rest()
        self._begin(Activity.TEARDOWN)
        self._changes.end()
        self._module.teardown()
        self._idle()
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
                self._turn()

    def _turn(self) -> None:
        """Handle at most one message and run at most one tick, or wait for either."""
        was_one = self._inbox.handle_next()
        if was_one is None:
            delivery = self._inbox.take()
            was_one = delivery is not None
            if delivery is not None:
                self._handle(delivery)
        if was_one and self.ends:
            return
        if self._calls.are_due():
            self._begin(Activity.TICK)
            self._calls.run()
            self._idle()
            if self.ends:
                return
        if self._ticks.are_due():
            self._begin(Activity.TICK)
            self._ticks.run()
            self._idle()
        elif not was_one:
            self._wait()

    def _handle(self, delivery: Delivery) -> None:
        begun_ns = self._begin(_HANDLER | delivery.declaration << 8)
        self._inbox.handle(delivery)
        self._idle()
        self._messages.record(begun_ns - delivery.stamp_ns, time.monotonic_ns() - begun_ns)

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
                self._handle(delivery)
            elif not self._wakeup.wait(MAX_WAIT_S):
                if not self._something_waits():
                    return
                idle += 1

    def _wait(self) -> None:
        wait_s = min(self._ticks.wait_s(), self._calls.wait_s())
        woken = self._wakeup.wait(wait_s)
        if woken and self._outbox.awaits_room and self._outbox.room_was_made():
            self._ticks.expedite()
        if woken and tick_is_awaited(self._module):
            self._ticks.expedite()
        if self._has_just_settled is not None and self._has_just_settled():
            self._ticks.expedite()

    def _begin(self, activity: int) -> int:
        now_ns = time.monotonic_ns()
        self._write_activity(_ACTIVITY_AT, now_ns, activity)
        return now_ns

    def _idle(self) -> None:
        self._words[_ACTIVITY] = _IDLE
