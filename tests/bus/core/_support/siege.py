"""Innocent modules beside one that writes anything anywhere into its own segment."""

import contextlib

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Delivery
from robbie_mp.bus.transport.ring import RingCorrupt
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.simulated_run import RING_RECORDS, SimulatedModule, SimulatedRun

HOSTILE_SLOT = 3


class Siege:
    """An innocent publisher and an innocent subscriber beside a module that writes garbage."""

    def __init__(self, *, lockstep: bool = False) -> None:
        self.run = SimulatedRun(queue_messages=1000, handles=400, lockstep=lockstep)
        self.publisher = self.run.start(1)
        self.channel = self.publisher.advertise()
        self.publisher.ready()
        self.subscriber = self.run.start(2)
        self.subscriber.subscribe()
        self.subscriber.ready()
        self.held: dict[int, Delivery] = {}
        """Messages that the hostile module holds, by reference."""
        self.hostile = self._start_hostile(1)
        self.published: list[int] = []
        self.seen: list[int] = []
        self.sequences: list[int] = []

    def _start_hostile(self, incarnation: int) -> SimulatedModule:
        module = self.run.start(HOSTILE_SLOT, incarnation)
        self.hostile_channel = module.advertise()
        module.subscribe()
        module.subscribe(MessageHandling.KEEP_ONLY_NEWEST, type_name="test_msgs/msg/Other")
        module.ready()
        self.run.run_core()
        return module

    def publish(self) -> None:
        if self.publisher.publish(self.channel, len(self.published)):
            self.published.append(len(self.published))

    def handle(self) -> None:
        while (delivery := self.subscriber.take()) is not None:
            self.sequences.append(delivery.sequence)
            if layout.unpack_source(delivery.source)[0] == self.publisher.slot:
                self.seen.append(delivery.stamp_ns)
            self.subscriber.endpoint.release(delivery)

    def behave(self) -> None:
        """Do what the hostile module's healthy threads still do, if its memory lets them."""
        with contextlib.suppress(ValueError, OverflowError, RingCorrupt):
            self.hostile.publish(self.hostile_channel, 0)
            self.hold()
            while self.held:
                self.hostile.endpoint.release(self.held.popitem()[1])

    def hold(self) -> None:
        """Let the hostile module take what it was given, and keep it."""
        with contextlib.suppress(ValueError, OverflowError, RingCorrupt):
            while (delivery := self.hostile.take()) is not None:
                self.held[delivery.reference] = delivery

    def record(self, *words: int) -> None:
        """Push a record in due form, with anything in it; the healthy threads go on behind it."""
        out, head = self.hostile.out, self.hostile.out[layout.OUT_HEAD]
        at = layout.OUT_RING + head % RING_RECORDS * layout.RECORD_WORDS
        for column, word in enumerate((*words, (head + 1) & WORD_MAX)):
            out[at + column] = word
        out[layout.OUT_HEAD] = (head + 1) & WORD_MAX
        self.hostile.endpoint._outbound.head = (head + 1) & WORD_MAX

    def scribble(self, at: int, word: int) -> None:
        self.hostile.out[at] = word

    def core(self) -> None:
        self.run.run_core()

    def core_dies(self, stores: int, at: int, word: int) -> None:
        """Let the core die before one of its next stores, and scribble before the next one looks."""
        self.run.fuse.stores = 0
        self.run.fuse.deaths = [stores]
        self.run.while_dead = lambda: self.scribble(at, word)

    def restart_hostile(self) -> None:
        self.run.kill(self.hostile)
        self.held.clear()
        self.hostile = self._start_hostile(self.hostile.incarnation + 1)

    def end(self) -> None:
        """The hostile module goes; the innocent ones have lost nothing, and nothing is left of it."""
        self.run.run_core()
        self.run.kill(self.hostile)
        self.run.gone(self.hostile, clean=False)
        handled = -1
        while handled < len(self.sequences):
            handled = len(self.sequences)
            self.handle()
            self.run.run_core()
        self.publish()
        self.run.run_core()
        self.handle()
        self.run.run_core()
        assert self.seen == self.published
        assert self.sequences == sorted(set(self.sequences)), "out of order or twice"
        assert self.run.live_handles() == self.run.live_references() == 0
        self.publisher.collect_freed()
        assert not self.publisher.blocks_out
