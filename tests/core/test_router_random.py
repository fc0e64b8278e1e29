"""Random histories of a small robot: whatever happens, nothing is lost uncounted and nothing leaks."""

from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.transport import layout
from robbie_mp.transport.records import MessageHandling
from tests.core.simulated_run import SimulatedModule, SimulatedRun

HANDLINGS = {2: MessageHandling.ALWAYS_DELIVER, 3: MessageHandling.KEEP_ONLY_NEWEST}
SLOTS = (1, 2, 3)


class History:
    """Slots 1 and 2 publish, 2 takes everything, 3 the newest; all may die and come back at any time."""

    def __init__(self) -> None:
        self.run = SimulatedRun(queue_messages=6, handles=24)
        self.alive: dict[int, SimulatedModule] = {}
        self.channels: dict[int, int] = {}
        self.incarnations = dict.fromkeys(SLOTS, 0)
        self.seen: dict[int, list[int]] = {2: [], 3: []}
        self.published = 0
        for slot in SLOTS:
            self.start(slot)

    def start(self, slot: int) -> None:
        if slot in self.alive:
            return
        self.incarnations[slot] += 1
        module = self.alive[slot] = self.run.start(slot, self.incarnations[slot])
        if slot in HANDLINGS:
            module.subscribe(HANDLINGS[slot])
        if slot != 3:
            self.channels[slot] = module.advertise()
        module.ready()

    def kill(self, slot: int) -> None:
        if slot in self.alive:
            self.run.kill(self.alive.pop(slot))

    def publish(self, slot: int) -> None:
        if slot in self.alive and slot != 3:
            self.published += self.alive[slot].publish(self.channels[slot], 0)

    def handle(self, slot: int) -> None:
        module = self.alive.get(slot)
        if module is None or slot == 1 or (delivery := module.take()) is None:
            return
        self.seen[slot].append(delivery.sequence)
        module.endpoint.release(delivery)

    def begin_and_die(self, slot: int) -> None:
        module = self.alive.get(slot)
        if module is not None and slot != 1:
            module.take()
            self.kill(slot)

    def check(self) -> None:
        run = self.run
        for sequences in self.seen.values():
            assert sequences == sorted(set(sequences)), "out of order or twice"
        for index, slot in enumerate(HANDLINGS):
            counts = run.counts(index)
            ended = counts["delivered"] + counts["replaced"] + counts["dropped"] + counts["lost"]
            assert counts["routed"] == ended + run.waiting(slot), counts

    def finish(self) -> None:
        for slot in SLOTS:
            self.start(slot)
        for _ in range(200):
            self.run.run_core()
            for slot in HANDLINGS:
                self.handle(slot)
        self.run.run_core()
        self.check()
        assert self.run.live_handles() == self.run.live_references() == 0
        for module in self.alive.values():
            module.collect_freed()
            assert not module.blocks_out
        routed = sum(
            self.run.words[self.run.tables.publisher(slot) + layout.PUBLISHER_ROUTED]
            + (
                self.run.words[self.run.tables.publisher(slot) + layout.PUBLISHER_REFUSED]
                >> layout.REFUSED_TAG_BITS
            )
            for slot in SLOTS
        )
        assert routed == self.published


STEPS = st.lists(
    st.tuples(
        st.sampled_from(
            ["publish", "publish", "publish", "handle", "handle", "kill", "start", "begin_and_die", "core"]
        ),
        st.sampled_from(SLOTS),
    ),
    max_size=80,
)


@settings(max_examples=300, deadline=None)
@given(STEPS)
def test_any_history_keeps_order_and_books(steps: list[tuple[str, int]]) -> None:
    history = History()
    for action, slot in steps:
        if action == "core":
            history.run.run_core()
            history.check()
        else:
            getattr(history, action)(slot)
    history.finish()
