"""The process of a shadow: runs the variant with what it is given, and says what it would have published.

It has no part in the run: it maps none of its memory, and its only connection is the socket on its standard
input. So it cannot move the robot, answer a call, or delay anybody.
"""

import logging
import os
import random
import resource
import socket
import sys
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.prctl import die_with_parent, set_process_name
from robbie_mp.base.linux.priority import lower_priority
from robbie_mp.bus.checkpoint.image import decode
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.shadow.confinement import be_the_first_to_go, confine
from robbie_mp.logs.shadow.frames import (
    Begin,
    Done,
    EndedByError,
    Given,
    OfShadow,
    Ready,
    Said,
    Start,
    ToShadow,
    Wants,
    packed,
    received,
)
from robbie_mp.messages import Message
from robbie_mp.messages.errors import MessageError
from robbie_mp.module.bus import CopyingBus
from robbie_mp.module.calls.peers import Server
from robbie_mp.module.clock import ManualClock
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.harness import HarnessBus, HarnessPeers, ModuleHarness
from robbie_mp.module.module import Module
from robbie_mp.module.wiring import Wiring
from robbie_mp.run.profile.check import load_class
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames
from robbie_mp.run.variant import put_first

NICE = 15
"""Its share of a busy processor is a thirtieth of another process's."""


class ModuleStops(RobbieError, RuntimeError):
    """The module of a shadow has called `stop()`."""


class ShadowPeers(HarnessPeers):
    """No module at all: nobody answers the calls of a shadow."""

    def __init__(self, name: str, clock: ManualClock):
        super().__init__(name, clock)
        self.has_server = False
        self.calls = 0

    def find_server(self, service: ChannelName) -> Server | None:
        """Count a call that is made."""
        self.calls += 1
        return super().find_server(service)


class ShadowBus(HarnessBus):
    """A bus from which nothing goes to the run.

    Args:
        clock: the time of the shadow.
        name: of the module.
        wiring: the names of its topics.
        tell: sends a frame.
    """

    def __init__(self, clock: ManualClock, name: str, wiring: Wiring, tell: Any):
        super().__init__(clock, name, wiring)
        self.peers: ShadowPeers = ShadowPeers(name, clock)
        self._tell = tell

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Say what would have been published."""
        is_done = super().publish(message, topic, latched)
        while self.published_encoded:
            type_name, version, data, actual = self.published_encoded.pop()
            self._tell(Said(self._clock.now_ns(), type_name, version, actual, data))
        return is_done

    def _collect(self, message: Message, topic: str) -> bytes:
        data = message.encode()
        self._tell(Said(self._clock.now_ns(), message.type_name, message.version, topic, data))
        return data

    def lose(self, error: MessageError) -> None:
        """Count a message that could not be decoded, as in a robot."""
        CopyingBus.lose(self, error)


class Shadow(ModuleHarness[Module]):
    """The variant in this process.

    Args:
        module_class: its class.
        begin: what it is.
        start: from when on, and with which state.
        connection: where its frames go.
    """

    checks_class = False  # it does what it does in a robot, which has checked it

    def __init__(self, module_class: type[Module], begin: Begin, start: Start, connection: socket.socket):
        self._start = start
        self._connection = connection
        self._told = -1
        """Number of subscriptions of which the other end knows."""
        super().__init__(
            module_class,
            begin.settings,
            output_directory=Path(begin.folder),
            name=begin.name,
            restored=None if start.checkpoint is None else decode(start.checkpoint).state,
            topics=begin.topics,
            namespace=begin.namespace,
            folder=Path(begin.workspace),
        )

    def make_clock(self) -> ManualClock:
        """Return the clock, which shows the time of what the shadow is given."""
        return ManualClock(self._start.begin_ns)

    def make_bus(self, name: str, wiring: Wiring) -> ShadowBus:
        """Return the bus from which nothing goes to the run."""
        self.shadow_bus = ShadowBus(self.clock, name, wiring, self.tell)
        return self.shadow_bus

    def tell(self, frame: OfShadow) -> None:
        """Send a frame; wait while the other end does not read."""
        self._connection.sendall(packed(frame))

    def tell_subscriptions(self) -> None:
        """Say what it has subscribed to, if there is more than before."""
        wanted = list(self.bus.subscriptions)
        if len(wanted) == self._told:
            return
        self._told = len(wanted)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.tell(Wants([(*one.name, one.handling is newest) for one in wanted]))

    def take(self, given: Given) -> None:  # type: ignore[override]
        """Let the time pass, and handle a message if there is one."""
        begun_ns = time.perf_counter_ns()
        self.advance(max(0, given.time_ns - self.clock.now_ns()) / 1e9)
        took_ns = 0
        if given.type_name:
            begun_ns = time.perf_counter_ns()
            name = ChannelName(given.type_name, given.version, given.topic)
            self.bus.deliver(name, given.data, given.sender)
            took_ns = time.perf_counter_ns() - begun_ns
            self._loop.run_calls()
        self.tell_subscriptions()
        self.tell(Done(given.time_ns, took_ns, self.shadow_bus.peers.calls))
        if self.module.stop_requested:
            raise ModuleStops("the module has stopped itself")


def main() -> None:
    """Be the shadow until the other end closes."""
    connection = socket.socket(fileno=os.dup(0))
    os.dup2(2, 1)  # what it prints must not mix with the results of the command
    with suppress(OSError):
        be_the_first_to_go()
    lower_priority(NICE, logging.getLogger("robbie.shadow"))
    logging.basicConfig(format="shadow: %(message)s", level=logging.WARNING, stream=sys.stderr)
    frames = received(connection, ToShadow)
    begin = next(frames)
    set_process_name("shadow")
    random.seed(0)
    if begin.process_bytes is not None:
        resource.setrlimit(resource.RLIMIT_AS, (begin.process_bytes, begin.process_bytes))
    confine(begin.folder)
    try:
        sys.path.insert(0, begin.workspace)
        put_first(begin.code, begin.class_path)
        module_class = load_class(begin.class_path, Module)
        connection.sendall(packed(Ready()))
        shadow = Shadow(module_class, begin, next(frames), connection)
        shadow.__enter__()  # without its counterpart: the results of teardown() would go nowhere
        shadow.tell_subscriptions()
        for given in frames:
            shadow.take(given)
    except Exception as error:
        leave_out_our_frames(error)
        traceback.print_exception(error)
        with suppress(OSError):
            connection.sendall(packed(EndedByError(f"{type(error).__name__}: {error}"[:1000])))
        os._exit(1)
    os._exit(0)


if __name__ == "__main__":
    die_with_parent(int(sys.argv[1]))
    main()
