"""A publisher and a subscriber over the test build's memory: in C, or in Python with the same clock."""

import contextlib
import math
import os
from collections.abc import Callable
from itertools import count
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from robbie_mp import Array, Message, MessageHandling, int32, uint8
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.channels import ChannelNames
from robbie_mp.bus.transport.run_memory import make_block_store, make_views
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.messages import message as message_module
from robbie_mp.module.calls.due import NEVER_NS, Due
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.runner import ModuleRunner
from robbie_mp.module.ticks import TimedTicks
from tests.bus.core._support.simulated_run import SimulatedRun

PUBLISHER, SUBSCRIBER = 1, 2
LIMIT_BYTES = 1 << 18
KEPT = object()
"""In place of a period that stays as it is."""
TOPICS = ("", "left", "right")

_runs = count()


def parcel_class(built: ModuleType) -> type[Message]:
    """Return a class of messages whose codec is that of the test build."""
    before = message_module._NATIVE
    message_module._NATIVE = built
    try:

        class Parcel(Message, name="test_msgs/msg/Parcel", version=1):
            number: int32
            data: Array[uint8]

    finally:
        message_module._NATIVE = before
    return Parcel


class Exchange:
    """What a test does with both modules, step by step; the subscriber keeps arrays if the test asks for it.

    Args:
        built: the test build.
        parcel: the class of the messages.
    """

    def __init__(self, built: ModuleType, parcel: Any):
        native = SimulatedRun.memory.native
        built.set_clock(10**10)
        self.run_id = f"test{os.getpid()}x{next(_runs)}"
        self.built = built
        self.parcel = parcel
        self.kept: list[Any] = []
        self.lent: list[Any] = []
        self.keeps: Callable[[Any], object] | None = None
        self.next_period_s: object = KEPT
        self.ticks = 0
        self.run = SimulatedRun(queue_messages=100, handles=300)
        sender, receiver = self.run.start(PUBLISHER), self.run.start(SUBSCRIBER)
        make_folder(self.run_id)
        blocks = make_block_store(self.run_id, PUBLISHER, 1, 1 << 14, LIMIT_BYTES, native)
        tick = built.tick
        clock: Any = SimpleNamespace(
            monotonic_ns=tick, jumps=0, machine_s_until=lambda due_ns: max(0.0, (due_ns - tick()) / 1e9)
        )
        self.outbox = Outbox(sender.endpoint, blocks, sender.out, clock, native)
        self.views = make_views(self.run_id, native)
        self.inbox = Inbox(receiver.endpoint, self.views, receiver.out, ChannelNames(self.run.words), native)
        for topic in TOPICS[:2]:
            self.inbox.subscriptions.subscribe(parcel, self._handle, MessageHandling.ALWAYS_DELIVER, topic)
        self.due = Due()
        self.calls_period_ns = NEVER_NS
        self.calls: Any = SimpleNamespace(
            due=self.due,
            are_due=self._are_calls_due,
            wait_s=self._calls_wait_s,
            run=self._run_calls,
            timers=SimpleNamespace(),
        )
        self.calls_run = 0
        module: Any = SimpleNamespace(
            stop_requested=False, period_s=None, _calls=self.calls, tick=self._tick, _is_tick_awaited=False
        )
        self.module = changes = module
        self.wakeup = Wakeup.create(names.wakeup(self.run_id, 0, 0), native)
        ticks = TimedTicks(module, clock, receiver.out, 0.0, native)
        place: Any = SimpleNamespace(
            endpoint=receiver.endpoint,
            words=receiver.out,
            memory=SimpleNamespace(wakeup=self.wakeup),
            native=native,
        )
        self.runner = ModuleRunner(module, place, self.inbox, self.outbox, ticks, changes)
        sender.ready()
        receiver.ready()
        self.run.run_core()

    def _handle(self, parcel: Any) -> None:
        if self.keeps is not None:
            self.kept.append(self.keeps(parcel.data))

    def publish(self, topic: int, size: int) -> None:
        self.outbox.publish(self.parcel(number=size, data=np.zeros(size, np.uint8)), TOPICS[topic])

    def publish_encoded(self, topic: int, size: int) -> None:
        data = self.parcel(number=size, data=np.zeros(size, np.uint8)).encode()
        self._publish_bytes(data, TOPICS[topic])

    def _publish_bytes(self, data: bytes, topic: str) -> None:
        self.outbox.publish(EncodedMessage("test_msgs/msg/Parcel", 1, memoryview(data)), topic)

    def lend(self, topic: int, size: int, how: int) -> None:
        """Lend a message: 0 fills it, 1 fails, 2 still refers to its array afterwards."""
        fields = {"number": size, "data": size}
        with (
            contextlib.suppress(ZeroDivisionError),
            self.outbox.loan(self.parcel, TOPICS[topic], fields) as lent,
        ):
            lent.data[:] = how
            if how == 2:
                self.lent.append(lent.data)
            if how == 1:
                raise ZeroDivisionError

    def publish_damaged(self) -> None:
        self._publish_bytes(b"\0\1\0\0no parcel", "")

    def _tick(self) -> None:
        self.ticks += 1
        if self.next_period_s is not KEPT:
            self.module.period_s = self.next_period_s

    def take_turns(self, turns: int) -> None:
        for _ in range(turns):
            self.wakeup.post()  # so no turn waits
            if self.runner._turn_in_c is None or not self.runner._turn_in_c():
                self.runner.turn()

    def set_period(self, period_s: object, then_s: object = KEPT) -> None:
        """Let the receiver tick.

        Args:
            period_s: the period from now on.
            then_s: the period from the next tick on.
        """
        self.module.period_s, self.next_period_s = period_s, then_s

    def await_tick(self) -> None:
        self.module._is_tick_awaited = True

    def use_calls(self, period_ns: int) -> None:
        """Let something be due for the receiver's calls at once, and then once in each period."""
        self.calls_period_ns = period_ns
        self.due.ns = 0

    def _are_calls_due(self) -> bool:
        return bool(self.due.ns != NEVER_NS and self.built.tick() >= self.due.ns)

    def _calls_wait_s(self) -> float:
        due_ns = self.due.ns
        return math.inf if due_ns == NEVER_NS else max(0.0, (due_ns - self.built.tick()) / 1e9)

    def _run_calls(self) -> None:
        self.calls_run += 1
        never = self.calls_period_ns == NEVER_NS
        self.due.ns = NEVER_NS if never else self.built.tick() + self.calls_period_ns

    def await_room(self, messages: int) -> None:
        self.outbox.wake_after_freed(messages)

    def keep(self, how: int) -> None:
        self.keeps = (None, lambda data: data, lambda data: data[1:], bytes)[how]

    def drop(self, number: int) -> None:
        for kept in (self.kept, self.lent):
            if kept:
                del kept[number % len(kept)]

    def core(self) -> None:
        self.run.run_core()

    def outstanding(self) -> None:
        assert self.outbox.outstanding >= 0

    def die_after(self, slot: int, stores: int) -> None:
        """Kill a module before its next store after this number of stores."""
        words: Any = self.run.modules[slot, 1].out
        words.fuse = self.run.memory.fuse()
        words.fuse.deaths = [stores]

    def bury(self, slot: int) -> None:
        """Let the core know that a module is dead."""
        words: Any = self.run.modules[slot, 1].out
        words.fuse = None
        self.run.kill(self.run.modules[slot, 1])

    def restart_core(self) -> None:
        self.run.restart_core()

    def close(self) -> None:
        self.kept.clear()
        self.lent.clear()
        self.keeps = None
        self.outbox.close()
        self.inbox.close()
        self.views.close()
        self.wakeup.close()
        remove_names(self.run_id)
