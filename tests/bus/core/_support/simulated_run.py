"""A core and modules on plain arrays in one process: every step happens when the test says so."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from robbie_mp import MessageHandling
from robbie_mp.bus.core.members import LinkMemory, RouterLimits
from robbie_mp.bus.core.native_router import make_router
from robbie_mp.bus.core.router import Router, SlotLimits
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import Block
from robbie_mp.bus.transport.endpoint import Endpoint, EndpointMemory
from robbie_mp.bus.transport.records import ANY_VERSION, Delivery, Inbound, Notice, Outbound
from robbie_mp.bus.transport.segment import SegmentMismatch
from robbie_mp.bus.transport.tables import COLUMNS, CoreTables, TableSizes
from robbie_mp.bus.transport.words import Words
from tests.bus.core._support.memory import ArrayMemory, Died, Fuse, Memory, StateLog

RING_RECORDS = 16
CREDIT = 4
TYPE = "test_msgs/msg/Number"


@dataclass
class SimulatedModule:
    """One incarnation of a module; what it published and received is its own journal."""

    slot: int
    incarnation: int
    out: Words = field(default_factory=lambda: SimulatedRun.memory.zeros(layout.out_words(RING_RECORDS)))
    into: Words = field(default_factory=lambda: SimulatedRun.memory.zeros(layout.in_words(CREDIT)))
    blocks_out: set[int] = field(default_factory=set)
    next_block: int = 0
    fuse: Fuse | None = None
    """Kills the module before one of its own stores."""
    log: StateLog | None = None
    wakeups: int = 0
    """How often the core woke it."""
    core_wakeups: int = 0
    """How often it woke the core."""

    def wake(self) -> None:
        self.wakeups += 1
        SimulatedRun.memory.note_wake(self.slot)

    def wake_core(self) -> None:
        self.core_wakeups += 1

    def __post_init__(self) -> None:
        own = self.out
        if self.fuse is not None or self.log is not None:
            made_of, segment = SimulatedRun.memory, ("out", self.slot, self.incarnation)
            own = made_of.map(own, self.fuse or made_of.fuse(), segment, self.log)
        memory = EndpointMemory(self.slot, self.incarnation, own, self.into, self.wake_core)
        native: Any = SimulatedRun.native_modules or SimulatedRun.memory.native
        self.endpoint = Endpoint(memory, RING_RECORDS, CREDIT, native)

    def ready(self) -> None:
        self.endpoint.send(Outbound.READY)

    def subscribe(
        self,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        topic: str = "",
        type_name: str = TYPE,
    ) -> int:
        return self.endpoint.subscribe(type_name, 1, topic, handling)

    def subscribe_by_patterns(self, type_pattern: str, topic_pattern: str = "*") -> int:
        return self.endpoint.subscribe(
            type_pattern, ANY_VERSION, topic_pattern, MessageHandling.ALWAYS_DELIVER
        )

    def advertise(self, topic: str = "", type_name: str = TYPE, *, is_latched: bool = False) -> int:
        return self.endpoint.advertise(type_name, 1, topic, is_latched=is_latched)

    def publish(self, channel: int, value: int, size: int = 8) -> bool:
        """Publish a number; it travels as the stamp, so no payload is needed."""
        self.next_block += 1
        block = Block(self.next_block, 0, 64 * self.next_block, memoryview(b""))
        accepted = self.endpoint.publish(channel, block, size, value)
        if accepted:
            self.blocks_out.add(block.number)
        return accepted

    def collect_freed(self) -> None:
        for number in self.endpoint.freed():
            self.blocks_out.discard(number)

    def last_record(self) -> tuple[int, ...]:
        """The seven words of the record it pushed last, as the core sees it; zeros before the first."""
        head = self.out[layout.OUT_HEAD]
        at = layout.OUT_RING + ((head - 1) % RING_RECORDS) * layout.RECORD_WORDS
        return tuple(self.out[at + column] for column in range(7)) if head else (0,) * 7

    def take(self) -> Delivery | None:
        while (record := self.endpoint.take()) is not None:
            if isinstance(record, Delivery):
                return record
        return None

    def handle_all(self) -> list[int]:
        """Handle what has been delivered; return the values."""
        values = []
        while (delivery := self.take()) is not None:
            values.append(delivery.stamp_ns)
            self.endpoint.release(delivery)
        return values


class SimulatedRun:
    """A core with a supervisor and a number of slots."""

    memory: ClassVar[Memory] = ArrayMemory()
    """What the shared memory of all simulated runs is made of."""
    native_modules: ClassVar[Any] = None
    """The hot path in C, for the modules of all simulated runs; None: as the memory says."""

    def __init__(
        self,
        slots: int = 4,
        queue_messages: int = 100,
        queue_bytes: int = 1 << 30,
        handles: int = 64,
        subscriptions: int = 16,
        references: int | None = None,
        *,
        in_flight_bytes: int = 1 << 30,
        memory_bytes: int = 1 << 40,
        lockstep: bool = False,
        charged_ns: Callable[[], int] | None = None,
        log: StateLog | None = None,
        latched_messages: int = 100,
        latched_bytes: int = 1 << 30,
        yielding: int | None = None,
    ):
        self.lockstep = lockstep
        self.charged_ns = charged_ns
        self.log = log
        sizes = TableSizes(slots + 1, 8, subscriptions, handles, references or 4 * handles)
        self.words = self.memory.zeros(sizes.words)
        self.tables = CoreTables.create(self.words, sizes)
        self.fuse = self.memory.fuse()
        limits = SlotLimits(
            queue_messages, queue_bytes, in_flight_bytes=in_flight_bytes, memory_bytes=memory_bytes
        )
        self.limits = [*[limits] * slots, SlotLimits(latched_messages, latched_bytes)]
        if yielding is not None:
            self.limits[yielding] = replace(limits, yields=True)
        self.reports: list[str] = []
        self.modules: dict[tuple[int, int], SimulatedModule] = {}
        self.crashes = 0
        if log is not None:
            self.fuse.on_store = lambda number: log.core_stores(number, len(self.reports))
        self.while_dead: Callable[[], None] = lambda: None
        """What the modules do between a death of the core and its successor."""
        self.supervisor = self.make(0, 1)
        self.router = self._make_core()
        self.router.module_up(0, 1)
        self.supervisor.ready()
        self.run_core()

    def _make_core(self) -> Router:
        native: Any = self.memory.native
        return make_router(
            native,
            CoreTables.attach(self.memory.map(self.words, self.fuse, "core", self.log)),
            RouterLimits(RING_RECORDS, CREDIT, message_bytes=1 << 20),
            self.limits,
            self._connect,
            self.reports.append,
            lockstep=self.lockstep,
            charged_ns=self.charged_ns,
        )

    def make(self, slot: int, incarnation: int, fuse: Fuse | None = None) -> SimulatedModule:
        module = self.modules[slot, incarnation] = SimulatedModule(slot, incarnation, fuse=fuse, log=self.log)
        return module

    def _connect(self, slot: int, incarnation: int) -> LinkMemory:
        module = self.modules[slot, incarnation]
        if module.out[layout.HEADER_MAGIC]:
            raise SegmentMismatch("its header was written over")
        mapped = (
            self.memory.look_at(module.out),
            self.memory.map(module.into, self.fuse, ("in", slot, incarnation), self.log),
        )

        def close() -> None:
            for words in mapped:
                words.close()

        def wake() -> None:
            assert len(mapped[0]), "what wakes it is closed with its maps"
            module.wake()

        return LinkMemory(incarnation, *mapped, wake, close)

    def run_core(self) -> None:
        """Let the core work until it would sleep; if it dies, a new one takes over."""
        if self.log is not None:
            self.log.core_begins(len(self.reports))
        while True:
            try:
                while self.router.run_round() or self.router.before_sleep():
                    pass
                return
            except Died:
                self._replace_core()

    def _replace_core(self) -> None:
        while True:
            self.crashes += 1
            self.fuse.deaths = self.fuse.deaths[1:]
            self.fuse.stores = 0
            self.while_dead()
            try:
                self.router = self._make_core()
                self.router.recover()
                self.router.module_up(0, 1)
                return
            except Died:
                pass

    def restart_core(self) -> None:
        """Let a new core take over from one that died while it had nothing to do."""
        self.router = self._make_core()
        self.router.recover()
        self.router.module_up(0, 1)
        self.run_core()

    def start(self, slot: int, incarnation: int = 1, fuse: Fuse | None = None) -> SimulatedModule:
        module = self.make(slot, incarnation, fuse)
        self.supervisor.endpoint.send(Outbound.MODULE_UP, slot, incarnation)
        self.run_core()
        return module

    def kill(self, module: SimulatedModule) -> None:
        self.supervisor.endpoint.send(Outbound.MODULE_DOWN, module.slot, module.incarnation)
        self.run_core()

    def gone(self, module: SimulatedModule, *, clean: bool) -> None:
        self.supervisor.endpoint.send(Outbound.MODULE_GONE, module.slot, int(clean))
        self.run_core()

    def supervisor_notices(self) -> list[tuple[Inbound, int, int]]:
        notices = []
        while (record := self.supervisor.endpoint.take()) is not None:
            assert isinstance(record, Notice)
            notices.append((record.kind, record.slot, record.incarnation))
        return notices

    def counts(self, subscription: int) -> dict[str, int]:
        at = self.tables.subscription(subscription)
        return {kind: self.words[at + layout.SUBSCRIPTION_ROUTED + i] for i, kind in enumerate(COLUMNS)}

    def waiting(self, slot: int) -> int:
        at = self.tables.publisher(slot)
        return self.words[at + layout.PUBLISHER_WAITING] + self.words[at + layout.PUBLISHER_IN_FLIGHT]

    def in_hands(self, slot: int) -> int:
        """Messages that the core has sent to a module and has not heard of since."""
        return self.words[self.tables.publisher(slot) + layout.PUBLISHER_IN_FLIGHT]

    def check_windows(self) -> None:
        """Check that the core knows what is in flight, and that it is within its bounds."""
        ledger = self.router._ledger
        for slot in self.router._slots:
            if slot.link is None or slot.link.has_ended:
                continue
            handles = [ledger.handle(ledger.reference(reference)[1]) for reference in slot.link.pushed]
            for publisher, in_flight in enumerate(slot.link.in_flight):
                sizes = [handle.size for handle in handles if handle.source & 0xFFFF == publisher]
                assert in_flight == sum(sizes)
                assert in_flight <= slot.windows[publisher] or len(sizes) == 1

    @property
    def is_settled(self) -> bool:
        """Whether the core says, in lockstep, that nothing is left to handle."""
        return self.words[layout.CORE_SETTLED] == self.words[layout.CORE_LAST_SEQUENCE]

    def live_handles(self) -> int:
        return sum(self.words[self.tables.handle(i)] != 0 for i in range(self.tables.sizes.handles))

    def newest_live(self) -> int:
        """Sequence of the newest message that is kept; 0: none."""
        return max(self.words[self.tables.handle(i)] for i in range(self.tables.sizes.handles))

    def live_references(self) -> int:
        return sum(self.words[self.tables.reference(i)] != 0 for i in range(self.tables.sizes.references))


def connected(
    run: SimulatedRun, *handlings: MessageHandling
) -> tuple[SimulatedModule, int, list[SimulatedModule]]:
    """A publisher in slot 1 and a subscriber for each handling from slot 2 on."""
    publisher = run.start(1)
    channel = publisher.advertise()
    publisher.ready()
    subscribers = []
    for slot, handling in enumerate(handlings, start=2):
        subscriber = run.start(slot)
        subscriber.subscribe(handling)
        subscriber.ready()
        subscribers.append(subscriber)
    run.run_core()
    return publisher, channel, subscribers
