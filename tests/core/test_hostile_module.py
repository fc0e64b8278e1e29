"""A module writes anything anywhere into its own segment: the core faults it, and nobody else notices."""

import contextlib

from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.transport import layout
from robbie_mp.transport.records import Inbound, MessageHandling, Outbound
from robbie_mp.transport.ring import RingCorrupt
from robbie_mp.transport.words import WORD_MAX
from tests.core.simulated_run import RING_RECORDS, SimulatedModule, SimulatedRun

HOSTILE_SLOT = 3
OUT_WORDS = layout.out_words(RING_RECORDS)
DECLARATIONS_USED = 4
CONTROL_WORDS = (*range(layout.OUT_HEAD, layout.OUT_READY + 1), layout.OUT_AWAITED_FREED)
DECLARED_WORDS = range(
    layout.OUT_DECLARATIONS, layout.OUT_DECLARATIONS + DECLARATIONS_USED * layout.DECLARATION_WORDS
)
RING_WORDS = range(layout.OUT_RING, OUT_WORDS)

SOURCES = [layout.pack_source(slot, 0, 1) for slot in (0, 1, HOSTILE_SLOT)]
WORD = st.one_of(
    st.integers(0, 12),
    st.sampled_from([*SOURCES, 256, 2**16, 2**31, 2**32, 2**63, WORD_MAX - 1, WORD_MAX]),
    st.integers(0, WORD_MAX),
)
RECORD = st.tuples(
    st.just("record"),
    st.tuples(st.one_of(st.sampled_from([int(kind) for kind in Outbound]), WORD), *[WORD] * 6),
)
ANYWHERE = st.one_of(*map(st.sampled_from, (CONTROL_WORDS, DECLARED_WORDS, RING_WORDS)))
SCRIBBLE = st.tuples(st.just("scribble"), st.tuples(ANYWHERE, WORD))
STEP = st.one_of(
    RECORD,
    SCRIBBLE,
    st.tuples(st.sampled_from(["publish", "handle", "behave", "core", "restart_hostile"]), st.just(())),
    st.tuples(st.just("core_dies"), st.tuples(st.integers(0, 200), ANYWHERE, WORD)),
)


class Siege:
    """An innocent publisher and an innocent subscriber beside a module that writes garbage."""

    def __init__(self) -> None:
        self.run = SimulatedRun(queue_messages=1000, handles=400)
        self.publisher = self.run.start(1)
        self.channel = self.publisher.advertise()
        self.publisher.ready()
        self.subscriber = self.run.start(2)
        self.subscriber.subscribe()
        self.subscriber.ready()
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
            self.hostile.handle_all()

    def record(self, *words: int) -> None:
        """Push a record in due form, with anything in it."""
        out, head = self.hostile.out, self.hostile.out[layout.OUT_HEAD]
        at = layout.OUT_RING + head % RING_RECORDS * layout.RECORD_WORDS
        for column, word in enumerate((*words, (head + 1) & WORD_MAX)):
            out[at + column] = word
        out[layout.OUT_HEAD] = (head + 1) & WORD_MAX

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
        self.hostile = self._start_hostile(self.hostile.incarnation + 1)

    def end(self) -> None:
        """The hostile module goes; the innocent ones have lost nothing, and nothing is left of it."""
        self.run.run_core()
        self.run.kill(self.hostile)
        self.run.gone(self.hostile, clean=False)
        for _ in range(200):
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


@settings(max_examples=600, deadline=None)
@given(st.lists(STEP, max_size=40))
def test_garbage_of_one_module_harms_nobody_else(steps: list[tuple[str, tuple[int, ...]]]) -> None:
    siege = Siege()
    for name, arguments in steps:
        getattr(siege, name)(*arguments)
    siege.end()


def test_core_that_takes_over_survives_a_broken_head() -> None:
    siege = Siege()
    siege.scribble(layout.OUT_HEAD, 1 << 63)
    siege.run.restart_core()
    assert (Inbound.FAULTED, HOSTILE_SLOT, 1) in siege.run.supervisor_notices()
    siege.end()


def test_core_that_takes_over_survives_a_torn_record() -> None:
    siege = Siege()
    siege.scribble(layout.OUT_HEAD, siege.hostile.out[layout.OUT_HEAD] + 1)
    siege.run.restart_core()
    assert (Inbound.FAULTED, HOSTILE_SLOT, 1) in siege.run.supervisor_notices()
    siege.end()


def test_core_that_takes_over_survives_a_broken_declaration() -> None:
    siege = Siege()
    siege.scribble(layout.OUT_DECLARATIONS + layout.DECLARATION_WORDS + layout.DECLARATION_HANDLING, 99)
    siege.run.restart_core()
    assert (Inbound.FAULTED, HOSTILE_SLOT, 1) in siege.run.supervisor_notices()
    siege.end()


def test_core_that_takes_over_survives_more_declarations_than_its_tables_hold() -> None:
    siege = Siege()
    for number in range(20):
        siege.hostile.subscribe(topic=f"topic {number}")
        siege.run.run_core()
    assert siege.run.supervisor_notices()[-1] == (Inbound.FAULTED, HOSTILE_SLOT, 1)
    siege.run.restart_core()
    assert siege.run.supervisor_notices()[-1] == (Inbound.FAULTED, HOSTILE_SLOT, 1)
    siege.end()


def test_core_that_takes_over_survives_a_segment_that_is_none_any_more() -> None:
    siege = Siege()
    siege.hostile.publish(siege.hostile_channel, 0)
    siege.run.run_core()
    siege.scribble(layout.HEADER_MAGIC, 1)
    siege.run.restart_core()
    assert (Inbound.FAULTED, HOSTILE_SLOT, 1) in siege.run.supervisor_notices()
    siege.end()
    notices = siege.run.supervisor_notices()
    assert (Inbound.RECLAIMED, HOSTILE_SLOT, 1) in notices
    assert (Inbound.SEGMENTS_GONE, HOSTILE_SLOT, 1) in notices


def test_faulted_module_gets_nothing_more() -> None:
    siege = Siege()
    siege.record(99, 0, 0, 0, 0, 0, 0)
    siege.core()
    siege.publish()
    siege.core()
    assert siege.hostile.take() is None
    siege.restart_hostile()
    assert siege.hostile.handle_all() == [0]
    siege.end()


def test_name_that_is_no_text_is_refused() -> None:
    siege = Siege()
    siege.scribble(layout.OUT_DECLARATIONS + layout.DECLARATION_TYPE + 1, WORD_MAX)
    siege.record(Outbound.ADVERTISE, 0, 0, 0, 0, 0, 0)
    siege.core()
    assert (Inbound.FAULTED, HOSTILE_SLOT, 1) in siege.run.supervisor_notices()
    siege.end()


def test_order_goes_on_after_a_message_cut_short_whose_record_is_destroyed() -> None:
    for stores in range(60):
        siege = Siege()
        head = siege.hostile.out[layout.OUT_HEAD]
        siege.behave()
        siege.core_dies(stores, layout.OUT_HEAD, head + 2 * RING_RECORDS)
        siege.core()
        siege.publish()
        siege.core()
        siege.end()
