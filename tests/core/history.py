"""A small robot whose every event the test decides, with a journal that the core's books are checked by.

Slots 1 and 2 publish, 2 takes everything, 3 keeps only the newest; all may die and come back at any time.
"""

from robbie_mp.transport import layout
from robbie_mp.transport.records import MessageHandling
from tests.core.simulated_run import SimulatedModule, SimulatedRun

HANDLINGS = {2: MessageHandling.ALWAYS_DELIVER, 3: MessageHandling.KEEP_ONLY_NEWEST}
PUBLISHERS = (1, 2)
SLOTS = (1, 2, 3)


class History:
    """What has happened so far, by the modules' own account."""

    def __init__(self, deaths: tuple[int, ...] = (), queue_messages: int = 6, handles: int = 24) -> None:
        self.run = SimulatedRun(queue_messages=queue_messages, handles=handles)
        self.run.fuse.stores = 0
        self.run.fuse.deaths = list(deaths)
        self.alive: dict[int, SimulatedModule] = {}
        self.channels: dict[int, int] = {}
        self.incarnations = dict.fromkeys(SLOTS, 0)
        self.seen: dict[int, list[int]] = {2: [], 3: []}
        self.seen_values: dict[int, list[int]] = {2: [], 3: []}
        self.died_with = {2: 0, 3: 0}
        self.published: list[int] = []
        self.kept: dict[int, list] = {2: [], 3: []}
        for slot in (3, 2, 1):
            self.start(slot)

    def start(self, slot: int) -> None:
        if slot in self.alive:
            return
        self.incarnations[slot] += 1
        module = self.alive[slot] = self.run.start(slot, self.incarnations[slot])
        if slot in HANDLINGS:
            module.subscribe(HANDLINGS[slot])
        if slot in PUBLISHERS:
            self.channels[slot] = module.advertise()
        module.ready()
        self.run.run_core()

    def kill(self, slot: int) -> None:
        if slot in self.alive:
            self.kept.get(slot, []).clear()
            self.run.kill(self.alive.pop(slot))

    def publish(self, slot: int) -> None:
        if slot in self.alive and slot in PUBLISHERS:
            value = len(self.published) + 1
            if self.alive[slot].publish(self.channels[slot], value):
                self.published.append(value)

    def handle(self, slot: int) -> None:
        module = self.alive.get(slot)
        if module is None or slot not in HANDLINGS or (delivery := module.take()) is None:
            return
        self.seen[slot].append(delivery.sequence)
        self.seen_values[slot].append(delivery.stamp_ns)
        module.endpoint.release(delivery)

    def keep(self, slot: int) -> None:
        """Handle a message but hold on to it."""
        module = self.alive.get(slot)
        if module is None or slot not in HANDLINGS or (delivery := module.take()) is None:
            return
        self.seen[slot].append(delivery.sequence)
        self.seen_values[slot].append(delivery.stamp_ns)
        module.endpoint.done(delivery)
        self.kept[slot].append(delivery)

    def let_go(self, slot: int) -> None:
        if slot in self.alive and self.kept.get(slot):
            self.alive[slot].endpoint.release(self.kept[slot].pop())

    def begin_and_die(self, slot: int) -> None:
        """Die in the middle of a handler."""
        module = self.alive.get(slot)
        if module is not None and slot in HANDLINGS:
            self.died_with[slot] += module.take() is not None
            self.kill(slot)

    def core(self, _slot: int = 0) -> None:
        self.run.run_core()
        self.check_books()

    def check_books(self) -> None:
        """I3: one order, nothing twice. I4: nothing uncounted."""
        for sequences in self.seen.values():
            assert sequences == sorted(set(sequences)), f"out of order or twice: {sequences}"
        for index, slot in enumerate((3, 2)):
            counts = self.run.counts(index)
            ended = counts["delivered"] + counts["replaced"] + counts["dropped"] + counts["lost"]
            assert counts["routed"] == ended + self.run.waiting(slot), f"slot {slot}: {counts}"

    def finish(self) -> None:
        """Bring everyone back, let everything be handled, and compare the books with the journals."""
        for slot in SLOTS:
            self.start(slot)
        for _ in range(len(self.published) + 10):
            self.run.run_core()
            for slot in HANDLINGS:
                while self.kept[slot]:
                    self.let_go(slot)
                self.handle(slot)
        self.run.run_core()
        self.check_books()
        assert self.run.reports == []
        assert self.run.live_handles() == self.run.live_references() == 0, "not everything was freed"
        for module in self.alive.values():
            module.collect_freed()
            assert not module.blocks_out, f"blocks never came back: {module.blocks_out}"
        routed, refused = self._published_by_the_books()
        assert routed + refused == len(self.published)
        assert routed == self.run.words[layout.CORE_LAST_SEQUENCE]
        for index, slot in enumerate((3, 2)):
            counts = self.run.counts(index)
            assert counts["routed"] == routed
            assert counts["delivered"] + counts["lost"] == len(self.seen[slot]) + self.died_with[slot]
            assert set(self.seen_values[slot]) <= set(self.published), "a message was changed"

    def _published_by_the_books(self) -> tuple[int, int]:
        words, rows = self.run.words, [self.run.tables.publisher(slot) for slot in PUBLISHERS]
        routed = sum(words[at + layout.PUBLISHER_ROUTED] for at in rows)
        refused = sum(words[at + layout.PUBLISHER_REFUSED] >> layout.REFUSED_TAG_BITS for at in rows)
        return routed, refused
