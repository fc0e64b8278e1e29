"""A module writes anything anywhere into its own segment: the core faults it, and nobody else notices."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Inbound, Outbound
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.siege import HOSTILE_SLOT, Siege
from tests.bus.core._support.simulated_run import RING_RECORDS

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


@pytest.mark.slow
@pytest.mark.every_turn
@settings(max_examples=200, deadline=None)
@given(st.lists(STEP, max_size=40), st.booleans())
def test_garbage_of_one_module_harms_nobody_else(
    steps: list[tuple[str, tuple[int, ...]]], lockstep: bool
) -> None:
    siege = Siege(lockstep=lockstep)
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


def test_order_goes_on_though_a_record_that_was_destroyed_is_there_again_under_the_next_core() -> None:
    for stores in range(60):
        siege = Siege()
        siege.behave()
        head = siege.hostile.out[layout.OUT_HEAD]
        siege.core_dies(stores, layout.OUT_HEAD, head + 2 * RING_RECORDS)
        siege.core()
        for _ in range(2):
            siege.publish()
            siege.core()
        siege.scribble(layout.OUT_HEAD, head)
        siege.run.restart_core()
        siege.publish()
        siege.core()
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
