"""A small robot whose every event the test decides, with a journal that the core's books are checked by.

Slots 1 and 2 publish; 2 takes everything, and its queue yields; 3 keeps only the newest. All may die and come
back at any time.
Their channel may be latched: then each that comes back is given the newest message first.
"""

import contextlib

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Delivery, Outbound
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.memory import Died, Fuse, StateLog
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun

HANDLINGS = {2: MessageHandling.ALWAYS_DELIVER, 3: MessageHandling.KEEP_ONLY_NEWEST}
PUBLISHERS = (1, 2)
SLOTS = (1, 2, 3)
MESSAGE_BYTES = 8


class History:
    """What has happened so far, by the modules' own journals."""

    def __init__(
        self,
        deaths: tuple[int, ...] = (),
        queue_messages: int = 6,
        handles: int = 24,
        fuses: dict[int, Fuse] | None = None,
        by_patterns: bool = False,
        lockstep: bool = False,
        in_flight_bytes: int = 1 << 30,
        log: StateLog | None = None,
        latched: bool = False,
        latched_bytes: int = 1 << 30,
    ) -> None:
        self.latched = latched
        self.may_drop_latched = latched_bytes < MESSAGE_BYTES
        """Whether the core may keep nothing for later subscribers."""
        self.run = SimulatedRun(
            latched_bytes=latched_bytes,
            queue_messages=queue_messages,
            handles=handles,
            in_flight_bytes=in_flight_bytes,
            lockstep=lockstep,
            log=log,
            yielding=2,
        )
        self.run.fuse.stores = 0
        self.run.fuse.deaths = list(deaths)
        self.fuses = fuses or {}
        self.by_patterns = by_patterns
        """Whether slot 2 takes everything by two patterns instead of by type."""
        self.alive: dict[int, SimulatedModule] = {}
        self.channels: dict[int, int] = {}
        self.incarnations = dict.fromkeys(SLOTS, 0)
        self.seen: dict[int, list[int]] = {2: [], 3: []}
        self.seen_values: dict[int, list[int]] = {2: [], 3: []}
        self.lives: dict[int, list[list[int]]] = {2: [], 3: []}
        """What each incarnation of a subscriber has seen."""
        self.taken: list[int] = []
        """Sequences in the order in which anybody began to handle them."""
        self.died_with = {2: 0, 3: 0}
        self.died_over: dict[int, list[int]] = {2: [], 3: []}
        """Sequences of the messages that a subscriber died over; each life dies over one at most."""
        self.stopped: set[int] = set()
        """Modules that were stopped at some time: meanwhile the core routed nothing to them."""
        self.published: list[int] = []
        self.kept: dict[int, list[Delivery]] = {2: [], 3: []}
        for slot in (3, 2, 1):
            self.start(slot)

    def start(self, slot: int, *, joins_late: bool = False) -> None:
        if slot in self.alive:
            return
        self.incarnations[slot] += 1
        if slot in self.lives:
            self.lives[slot].append([])
        fuse = self.fuses.get(slot) if self.incarnations[slot] == 1 else None
        module = self.alive[slot] = self.run.start(slot, self.incarnations[slot], fuse)
        try:
            if joins_late:
                module.ready()
                self.run.run_core()
            if slot == 2 and self.by_patterns:
                module.subscribe_by_patterns("test_msgs/*")
                module.subscribe_by_patterns("*")
            elif slot in HANDLINGS:
                module.subscribe(HANDLINGS[slot])
            if slot in PUBLISHERS:
                self.channels[slot] = module.advertise(is_latched=self.latched)
            module.ready()
        except Died:
            self.kill(slot)
            self.start(slot)
        self.run.run_core()

    def join(self, slot: int) -> None:
        """Come back, and subscribe only after the setup."""
        self.kill(slot)
        self.start(slot, joins_late=True)
        if joined := slot in HANDLINGS:
            self.stopped.add(slot)  # its subscription was closed, as it was not declared at first
        assert joined or slot in PUBLISHERS

    def kill(self, slot: int) -> None:
        if slot in self.alive:
            self.kept.get(slot, []).clear()
            self.run.kill(self.alive.pop(slot))

    def stop(self, slot: int) -> None:
        """Stop a module in order, so that nothing is kept for it until it is started again."""
        if slot in self.alive:
            module = self.alive[slot]
            self.kill(slot)
            self.run.gone(module, clean=True)
            self.stopped.add(slot)
            self.died_over.get(slot, []).clear()

    def publish(self, slot: int) -> None:
        if slot in self.alive and slot in PUBLISHERS:
            value = len(self.published) + 1
            module = self.alive[slot]
            try:
                accepted = module.publish(self.channels[slot], value)
            except Died:
                record = module.last_record()
                accepted = (record[0], record[5]) == (Outbound.PUBLISH, value)
                self.kill(slot)
            if accepted:
                self.published.append(value)

    def handle(self, slot: int) -> None:
        self._take_and(slot, Outbound.RELEASE)

    def keep(self, slot: int) -> None:
        """Handle a message but hold on to it."""
        delivery = self._take_and(slot, Outbound.DONE)
        if delivery is not None:
            self.kept[slot].append(delivery)

    def _take_and(self, slot: int, answer: Outbound) -> Delivery | None:
        """Handle a message and answer the core; None if there was none, or the module died over it."""
        module = self.alive.get(slot)
        if module is None or slot not in HANDLINGS:
            return None
        delivery = None
        try:
            delivery = module.take()
            if delivery is None:
                return None
            if self.lives[slot][-1] or not self.latched:  # or else it may be given
                self.taken.append(delivery.sequence)
            respond = module.endpoint.release if answer is Outbound.RELEASE else module.endpoint.done
            respond(delivery)
        except Died:
            survived = delivery is not None and module.last_record()[:2] == (answer, delivery.reference)
            if delivery is not None and not survived:
                self._note_death(slot, delivery)
            self.kill(slot)
            if not survived or delivery is None:
                return None
        self.seen[slot].append(delivery.sequence)
        self.lives[slot][-1].append(delivery.sequence)
        self.seen_values[slot].append(delivery.stamp_ns)
        return delivery if slot in self.alive else None

    def let_go(self, slot: int) -> None:
        if slot in self.alive and self.kept.get(slot):
            try:
                self.alive[slot].endpoint.release(self.kept[slot].pop())
            except Died:
                self.kill(slot)

    def make_room(self, slot: int, messages: int = 2) -> None:
        """Be short of memory, so that all but a few of the oldest messages that wait are to be dropped."""
        if slot in self.alive and slot in PUBLISHERS:
            try:
                self.alive[slot].endpoint.make_room(messages, WORD_MAX, before_ns=WORD_MAX)
            except Died:
                self.kill(slot)

    def wait(self, slot: int) -> None:
        """Wait until two more blocks are freed."""
        if slot in self.alive and slot in PUBLISHERS:
            try:
                self.alive[slot].endpoint.wake_after_freed(2)
            except Died:
                self.kill(slot)

    def drop_latched(self, slot: int) -> None:
        """Be so short of memory that what the core keeps for later subscribers is dropped too."""
        if slot in self.alive and slot in PUBLISHERS:
            self.may_drop_latched = True
            try:
                self.alive[slot].endpoint.make_room(0, 0, WORD_MAX, latched_bytes=0)
            except Died:
                self.kill(slot)

    def begin_and_die(self, slot: int) -> None:
        """Die in the middle of a handler."""
        module = self.alive.get(slot)
        if module is not None and slot in HANDLINGS:
            with contextlib.suppress(Died):
                if delivery := module.take():
                    self._note_death(slot, delivery)
            self.kill(slot)

    def _note_death(self, slot: int, delivery: Delivery) -> None:
        self.died_with[slot] += 1
        self.died_over[slot].append(delivery.sequence)

    def core(self, _slot: int = 0) -> None:
        self.run.run_core()
        self.check_books()

    def check_books(self) -> None:
        """I3: one order, nothing twice. I4: nothing uncounted."""
        for lives in self.lives.values():
            before: list[int] = []
            for life in lives:
                news = life[1:] if self.latched and life[:1] <= before[-1:] else life
                assert life == sorted(set(life)), f"out of order or twice: {lives}"
                assert not before or not news or before[-1] < news[0], f"out of order or twice: {lives}"
                before += news
        for index, slot in enumerate((3, 2)):
            counts = self.run.counts(index)
            ended = counts["delivered"] + counts["replaced"] + counts["dropped"] + counts["lost"]
            assert counts["routed"] == ended + self.run.waiting(slot), f"slot {slot}: {counts}"
        self.run.check_windows()
        if self.run.lockstep:
            assert self.taken == sorted(self.taken), "not in the one order of all modules"
            assert sum(map(self.run.in_hands, SLOTS)) <= 1, "two have a message at a time"

    def finish(self) -> None:
        """Bring everyone back, let everything be handled, and compare the books with the journals."""
        for _ in range(len(self.published) + 10):
            for slot in SLOTS:
                self.start(slot)
            self.run.run_core()
            if self._is_at_rest():
                break
            for slot in HANDLINGS:
                while self.kept[slot]:
                    self.let_go(slot)
                self.handle(slot)
        self.run.run_core()
        self.check_books()
        assert not self.run.lockstep or self.run.is_settled
        assert all("died over it twice" in line for line in self.run.reports), self.run.reports
        kept = self._check_latched()
        assert self.run.live_handles() == self.run.live_references() == kept, "not everything was freed"
        for slot, module in list(self.alive.items()):
            try:
                module.collect_freed()
            except Died:
                self.kill(slot)
                continue
            assert len(module.blocks_out) <= kept, f"blocks never came back: {module.blocks_out}"
        routed, refused = self._published_by_the_books()
        assert routed + refused == len(self.published)
        assert routed == self.run.words[layout.CORE_LAST_SEQUENCE]
        for index, slot in enumerate((3, 2)):
            counts = self.run.counts(index)
            was_closed, was_given = slot in self.stopped, self.latched and self.incarnations[slot] > 1
            assert counts["routed"] >= routed or was_closed
            assert counts["routed"] <= routed or was_given
            assert counts["delivered"] + counts["lost"] == len(self.seen[slot]) + self.died_with[slot]
            assert set(self.seen_values[slot]) <= set(self.published), "a message was changed"

    def _is_at_rest(self) -> bool:
        """Whether everybody is there, and nothing waits or is kept."""
        return len(self.alive) == len(SLOTS) and not (
            any(self.kept.values()) or any(self.run.waiting(slot) for slot in HANDLINGS)
        )

    def _check_latched(self) -> int:
        """Let both subscribers come back; return how many messages the core keeps for those that do."""
        keeps = self.run.live_handles()
        if not self.latched:
            return 0
        assert keeps <= 1
        newest = self.run.newest_live()
        last = self.run.words[layout.CORE_LAST_SEQUENCE]
        assert keeps or self.may_drop_latched or not last, "the newest message was forgotten"
        assert not keeps or newest == last, f"{newest} is kept, but {last} is the newest"
        for comes_back in (self.start, self.join):
            for slot in HANDLINGS:
                is_deadly = self.died_over[slot].count(newest) > 1
                self.kill(slot)
                comes_back(slot)
                while slot not in self.alive:
                    self.start(slot)
                self.handle(slot)
                while slot not in self.alive:
                    self.start(slot)
                    self.handle(slot)
                given = keeps and not is_deadly
                assert self.lives[slot][-1] == ([newest] if given else []), f"slot {slot} came late"
        self.run.run_core()
        self.check_books()
        return keeps

    def _published_by_the_books(self) -> tuple[int, int]:
        words, rows = self.run.words, [self.run.tables.publisher(slot) for slot in PUBLISHERS]
        routed = sum(words[at + layout.PUBLISHER_ROUTED] for at in rows)
        refused = sum(words[at + layout.PUBLISHER_REFUSED] for at in rows)
        return routed, refused
