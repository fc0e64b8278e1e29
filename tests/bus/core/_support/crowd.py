"""A robot of several modules, drawn at random, that goes on acting while its core is dead.

It has small tables and short queues, modules that publish and subscribe on several topics in every way there
is, and a supervisor that tells each new core again who is up and who is down. Its journals know which message
each module has seen; the books of the core are checked against them.
"""

import contextlib
from dataclasses import dataclass, field
from random import Random

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Delivery, Inbound, Outbound
from robbie_mp.bus.transport.tables import Outcome
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.memory import Died
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun

TOPICS = ("a", "b", "c")
ACTIONS = ("publish",) * 5 + ("handle",) * 4 + ("keep", "let_go", "make_room")
ENDS = ("kill", "begin_and_die", "stop", "fail")
MAX_STEPS = 120


@dataclass
class Participant:
    """A module through all its incarnations, and its journal."""

    publishes: tuple[str, ...]
    subscribes: tuple[tuple[str, MessageHandling], ...]
    by_patterns: bool
    module: SimulatedModule | None = None
    """The living incarnation."""
    dying: SimulatedModule | None = None
    """One that is dead, but that the core has not taken back yet."""
    incarnations: int = 0
    channels: dict[str, int] = field(default_factory=dict)
    kept: list[Delivery] = field(default_factory=list)
    seen: list[int] = field(default_factory=list)
    died_with: int = 0
    was_failed: bool = False
    """Whether messages that waited for it were counted as lost."""


class Crowd:
    """A robot drawn at random.

    Args:
        seed: of everything that is drawn.
        deaths: how often the core dies; it may end its life before.
    """

    def __init__(self, seed: int, deaths: int):
        self.random = Random(seed)
        choose = self.random.choice
        self.participants = {slot: self._draw() for slot in range(1, choose((3, 5, 7)))}
        self.run = SimulatedRun(
            slots=len(self.participants) + 1,
            queue_messages=choose((1, 3, 100)),
            handles=choose((1, 3, 6, 24)),
            references=choose((2, 5, 12, 96)),
            subscriptions=3 * len(self.participants),
            in_flight_bytes=choose((16, 1 << 30)),
            lockstep=self.random.random() < 0.2,
        )
        self.run.while_dead = self._while_dead
        self.values: dict[int, int] = {}
        """What each message says, by its sequence."""
        self.published: set[int] = set()
        self.unmapped: set[tuple[int, int]] = set()
        """Slots and incarnations whose data segments the supervisor has unlinked."""
        for slot in self.participants:
            self._start(slot)
        self._bury()
        self.run.fuse.stores = 0
        self.run.fuse.deaths = [choose((20, 80, 300, 900)) for _ in range(deaths)]
        self.run.fuse.deaths = [self.random.randrange(stores) for stores in self.run.fuse.deaths]

    def _draw(self) -> Participant:
        random = self.random
        publishes = tuple(topic for topic in TOPICS if random.random() < 0.4)
        topics = tuple(topic for topic in TOPICS if random.random() < 0.5)
        subscribes = tuple((topic, random.choice(tuple(MessageHandling))) for topic in topics)
        return Participant(publishes, subscribes, by_patterns=random.random() < 0.2)

    def play(self) -> None:
        """Let things happen, and then everything come to its end."""
        for _ in range(self.random.randrange(MAX_STEPS)):
            self._step()
        self.run.fuse.deaths = self.run.fuse.deaths[:1]  # at most one of them is still to come
        self._finish()

    def _step(self) -> None:
        slot = self.random.choice(tuple(self.participants))
        draw = self.random.random()
        if draw < 0.2:
            self._core()
        elif self.participants[slot].module is None:
            self._start(slot)
        elif draw < 0.26:
            self._end(slot, self.random.choice(ENDS))
        else:
            self._act(slot)
        self._bury()

    def _while_dead(self) -> None:
        """Do what goes on between two cores, and tell the new one who is there."""
        for _ in range(self.random.randrange(4)):
            self._act(self.random.choice(tuple(self.participants)))
        for slot, one in self.participants.items():
            if one.dying is not None:
                self.run.supervisor.endpoint.send(Outbound.MODULE_DOWN, slot, one.dying.incarnation)
            elif one.module is not None:
                self.run.supervisor.endpoint.send(Outbound.MODULE_UP, slot, one.module.incarnation)

    # -- what modules do; none of it needs a core ----------------------------------------------------------

    def _act(self, slot: int) -> None:
        one = self.participants[slot]
        if one.module is None or not one.module.out[layout.OUT_HEAD]:
            return
        try:
            getattr(self, "_" + self.random.choice(ACTIONS))(one)
        except Died:
            self._dies(one)

    def _dies(self, one: Participant) -> None:
        one.dying, one.module = one.module, None
        one.kept.clear()

    def _publish(self, one: Participant) -> None:
        assert one.module is not None
        if not one.channels:
            return
        value = len(self.published) + 1
        channel = self.random.choice(tuple(one.channels.values()))
        try:
            accepted = one.module.publish(channel, value, self.random.choice((8, 100)))
        except Died:
            record = one.module.last_record()
            if (record[0], record[5]) == (Outbound.PUBLISH, value):
                self.published.add(value)
            raise
        if accepted:
            self.published.add(value)

    def _handle(self, one: Participant) -> None:
        self._take_and(one, Outbound.RELEASE)

    def _keep(self, one: Participant) -> None:
        if (delivery := self._take_and(one, Outbound.DONE)) is not None:
            one.kept.append(delivery)

    def _take_and(self, one: Participant, answer: Outbound) -> Delivery | None:
        assert one.module is not None
        delivery = one.module.take()
        if delivery is None:
            return None
        self._check_delivery(delivery)
        respond = one.module.endpoint.release if answer is Outbound.RELEASE else one.module.endpoint.done
        try:
            respond(delivery)
        except Died:
            if one.module.last_record()[:2] == (answer, delivery.reference):
                one.seen.append(delivery.sequence)
            else:
                one.died_with += 1
            raise
        one.seen.append(delivery.sequence)
        return delivery

    def _let_go(self, one: Participant) -> None:
        assert one.module is not None
        if one.kept:
            one.module.endpoint.release(one.kept.pop())

    def _make_room(self, one: Participant) -> None:
        assert one.module is not None
        if one.channels:
            one.module.endpoint.make_room(self.random.randrange(3), WORD_MAX, before_ns=WORD_MAX)

    # -- what the supervisor does --------------------------------------------------------------------------

    def _start(self, slot: int) -> None:
        one = self.participants[slot]
        one.incarnations += 1
        fuse = None
        if self.random.random() < 0.15:
            fuse = SimulatedRun.memory.fuse()
            fuse.deaths = [self.random.randrange(200)]
        module = self.run.make(slot, one.incarnations, fuse)
        one.module, one.channels = module, {}
        self.run.supervisor.endpoint.send(Outbound.MODULE_UP, slot, one.incarnations)
        self.run.run_core()
        try:
            for topic, handling in one.subscribes:
                if one.by_patterns:
                    module.subscribe_by_patterns("test_msgs/*", topic)
                else:
                    module.subscribe(handling, topic)
            for topic in one.publishes:
                one.channels[topic] = module.advertise(topic)
            module.ready()
        except Died:
            self._dies(one)

    def _end(self, slot: int, how: str) -> None:
        one = self.participants[slot]
        module = one.module
        assert module is not None
        if how == "begin_and_die":
            with contextlib.suppress(Died):
                one.died_with += module.take() is not None
        self._dies(one)
        self._bury()
        if how in ("stop", "fail"):
            one.was_failed |= how == "fail"
            self.run.gone(module, clean=how == "stop")

    def _bury(self) -> None:
        """Have the core take the dead back."""
        for slot, one in self.participants.items():
            if one.dying is not None:
                dead = one.dying
                self.run.supervisor.endpoint.send(Outbound.MODULE_DOWN, slot, dead.incarnation)
                self.run.run_core()
                assert (Inbound.RECLAIMED, slot, dead.incarnation) in self._hear()
                one.dying = None

    def _hear(self) -> list[tuple[Inbound, int, int]]:
        """Take what the core tells the supervisor."""
        heard: list[tuple[Inbound, int, int]] = []
        while notices := self.run.supervisor_notices():
            heard += notices
            self.run.run_core()
        self.unmapped |= {(slot, of) for kind, slot, of in heard if kind is Inbound.SEGMENTS_GONE}
        for one in self.participants.values():
            for delivery in one.kept:
                self._check_memory(delivery)
        return heard

    # -- checks ------------------------------------------------------------------------------------------

    def _core(self) -> None:
        self.run.run_core()
        self._hear()
        if any(one.dying for one in self.participants.values()):
            return  # its pushed messages are still counted as in flight until it is taken back
        self._check_books()

    def _check_delivery(self, delivery: Delivery) -> None:
        """A message is the same to everybody, and its memory is its own."""
        assert self.values.setdefault(delivery.sequence, delivery.stamp_ns) == delivery.stamp_ns
        assert delivery.stamp_ns in self.published, "nobody said that"
        self._check_memory(delivery)

    def _check_memory(self, delivery: Delivery) -> None:
        slot, _, incarnation = layout.unpack_source(delivery.source)
        assert (slot, incarnation) not in self.unmapped, "its segments were removed before it came"
        publisher = self.participants[slot].module
        if publisher is not None and publisher.incarnation == incarnation and publisher.fuse is None:
            publisher.collect_freed()
            assert delivery.offset // 64 in publisher.blocks_out, "its block may be used again"

    def _check_books(self) -> None:
        words, tables = self.run.words, self.run.tables
        waiting = dict.fromkeys(self.participants, 0)
        for index in range(tables.sizes.subscriptions):
            at = tables.subscription(index)
            if words[at + layout.SUBSCRIPTION_STATE]:
                first = at + layout.SUBSCRIPTION_ROUTED
                routed, *ended = (words[first + column] for column in range(layout.SUBSCRIPTION_COUNTERS))
                waiting[words[at + layout.SUBSCRIPTION_SLOT]] += routed - sum(ended)
        for slot, one in self.participants.items():
            assert waiting[slot] == self.run.waiting(slot), f"slot {slot}"
            assert one.seen == sorted(set(one.seen)), f"slot {slot}: out of order or twice: {one.seen}"
        assert self.run.reports == []

    def _finish(self) -> None:
        """Bring everyone back, let everything be handled, and compare the books with the journals."""
        everybody = self.participants.values()
        handled = -1
        while handled != (handled := sum(len(one.seen) + one.died_with for one in everybody)):
            for _ in range(4):
                self._bring_back()
                self._core()
                for one in everybody:
                    if one.module is not None:
                        self._handle_everything(one)
                self._bury()
                self._core()
        self._check_end()

    def _bring_back(self) -> None:
        for slot, one in self.participants.items():
            self._bury()
            if one.module is None:
                self._start(slot)

    def _handle_everything(self, one: Participant) -> None:
        try:
            while one.kept:
                self._let_go(one)
            while self._take_and(one, Outbound.RELEASE) is not None:
                pass
        except Died:
            self._dies(one)

    def _check_end(self) -> None:
        run, words, tables = self.run, self.run.words, self.run.tables
        assert run.live_handles() == run.live_references() == 0, "not everything was freed"
        for slot, one in self.participants.items():
            if one.module is not None:
                if one.module.fuse is not None:
                    one.module.fuse.deaths = []
                one.module.collect_freed()
                assert not one.module.blocks_out, f"blocks of slot {slot} never came back"
            dead = range(1, one.incarnations + (one.module is None))
            assert {(slot, incarnation) for incarnation in dead} <= self.unmapped, "segments are left"
        publishers = [tables.publisher(slot) for slot in self.participants]
        routed = sum(words[at + layout.PUBLISHER_ROUTED] for at in publishers)
        refused = sum(words[at + layout.PUBLISHER_REFUSED] for at in publishers)
        channels = [tables.channel(index) for index in range(tables.sizes.channels)]
        assert routed + refused == len(self.published)
        assert routed == words[layout.CORE_LAST_SEQUENCE]
        assert routed == sum(words[at + layout.CHANNEL_MESSAGES] for at in channels)
        for slot, one in self.participants.items():
            rows = [tables.subscription(index) for index in range(tables.sizes.subscriptions)]
            mine = [at for at in rows if words[at] and words[at + layout.SUBSCRIPTION_SLOT] == slot]
            assert len(mine) == len(one.subscribes), "rows were used up"
            delivered = sum(words[at + layout.SUBSCRIPTION_ROUTED + Outcome.DELIVERED - 1] for at in mine)
            lost = sum(words[at + layout.SUBSCRIPTION_ROUTED + Outcome.LOST - 1] for at in mine)
            told = len(one.seen) + one.died_with
            assert delivered + lost == told or (one.was_failed and delivered + lost > told)
            assert delivered <= len(one.seen)
