"""Breaking any single step of the recovery must be noticed by the crash points, or they prove nothing."""

from collections.abc import Callable, Iterable, Iterator
from itertools import product

import pytest

from robbie_mp.bus.core.declarations import Declarations
from robbie_mp.bus.core.directory import Channel, Subscription
from robbie_mp.bus.core.ledger import Ledger
from robbie_mp.bus.core.members import Link, Slot
from robbie_mp.bus.core.queues import LockstepQueues, Queues
from robbie_mp.bus.core.router import Router
from robbie_mp.bus.core.takeover import Takeover
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.tables import Outcome, SubscriptionRow
from tests.bus.core.test_crash_points import (
    LATCHED_SETTINGS,
    SCENARIOS,
    SETTINGS,
    die_twice,
    late_and_short_of_memory,
    outlive_the_publisher,
    play,
)


def nothing(*_arguments: object, **_named: object) -> None:
    """Do not do this step."""


def forget_what_was_claimed(_takeover: Takeover, _handle: int, channel: Channel) -> tuple[Subscription, ...]:
    return channel.subscriptions


def every_row(takeover: Takeover) -> set[tuple[int, int, int]]:
    return set(_records(takeover._ledger, takeover._ledger.used_handles()))


def live_rows(takeover: Takeover) -> set[tuple[int, int, int]]:
    return set(_records(takeover._ledger, takeover._ledger.live_handles()))


def _records(ledger: Ledger, rows: Iterable[int]) -> Iterator[tuple[int, int, int]]:
    for index in rows:
        row = ledger.read_handle(index)
        slot, _, incarnation = layout.unpack_source(row.handle.source)
        yield slot, incarnation, row.record


MUTATIONS: dict[str, tuple[object, str, Callable[..., object]]] = {
    "counts are not completed": (Takeover, "_complete_count", nothing),
    "a message cut short in routing is not finished": (Takeover, "_finish_routing", nothing),
    "a record that was handled to its end is not taken": (Takeover, "_finish_publishing", nothing),
    "a row without a commit tells that a message was entered": (Takeover, "_entered", every_row),
    "a row that was given back tells nothing": (Takeover, "_entered", live_rows),
    "a message cut short in routing is sent to everybody again": (
        Takeover, "_unclaimed", forget_what_was_claimed,
    ),
    "a repeated record is taken for a violation": (Link, "is_repeated", lambda _link: False),
    "pushing is not noted": (Ledger, "mark_pushed", nothing),
    "declarations are not read again": (Takeover, "_restore_declarations", nothing),
    "references are not read again": (Takeover, "_restore_references", nothing),
    "a refused message is not known again": (Takeover, "_refused_record", nothing),
}  # fmt: skip

MUTATIONS_OF_LOCKSTEP: dict[str, tuple[object, str, Callable[..., object]]] = {
    "several modules have a message at a time": (LockstepQueues, "_is_anyone_busy", lambda _queues: False),
    "a module is sent all its messages at once": (LockstepQueues, "pump", Queues.pump),
    "a new core does not say that all is settled": (Router, "_announce_if_settled", nothing),
}  # fmt: skip


def give_what_it_may_have(
    declarations: Declarations, slot: Slot, _link: Link, entry: Subscription
) -> list[int]:
    ledger, given = declarations._ledger, []
    for latch in declarations._directory.latches(entry):
        assert latch.queued is not None
        handle = ledger.reference(latch.queued)[1]
        given.append(ledger.open_late_reference(entry, handle))
        declarations._queues.add_late(slot, entry, given[-1], ledger.handle(handle).size)
    return given


MUTATIONS_OF_GIVING: dict[str, Callable[..., object]] = {
    "a late subscriber is given nothing": lambda *_arguments: [],
    "a late subscriber is given what it has": give_what_it_may_have,
}


def forget_latched(takeover: Takeover, index: int) -> None:
    subscription = takeover._ledger.reference(index)[2]
    restore_waiting(takeover, index)
    if subscription.is_latch:
        takeover._queues.remove(takeover._slots[subscription.slot], index)
        takeover._ledger.finish(index, Outcome.DROPPED)


def keep_the_older(queues: Queues, slot: Slot, entry: Subscription, reference: int, size: int) -> None:
    if entry.is_latch and entry.queued is not None:
        queues._ledger.finish(reference, Outcome.REPLACED)
    else:
        queue(queues, slot, entry, reference, size)


restore_waiting, queue = Takeover._restore_waiting, Queues._queue
MUTATIONS_OF_KEEPING: dict[str, tuple[object, str, Callable[..., object], str]] = {
    "a new core forgets what is latched": (Takeover, "_restore_waiting", forget_latched, "was forgotten"),
    "the core keeps an older message": (Queues, "_queue", keep_the_older, "is the newest"),
}


note_death = SubscriptionRow.note_death


def note_every_death(row: SubscriptionRow, sequence: int, incarnation: int) -> None:
    before = row.deadly_words
    note_death(row, sequence, incarnation)
    if row.deadly_words == before:
        note_death(row, sequence, incarnation + 1)


@pytest.mark.slow
def test_death_that_is_counted_twice_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SubscriptionRow, "note_death", note_every_death)
    with pytest.raises(AssertionError, match="came late"):
        for death in range(play(die_twice, LATCHED_SETTINGS[0], ()).run.fuse.stores):
            play(die_twice, LATCHED_SETTINGS[0], (death,))


@pytest.mark.parametrize("mutation", MUTATIONS_OF_KEEPING)
def test_broken_keeping_of_latched_messages_is_noticed(
    mutation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner, name, replacement, complaint = MUTATIONS_OF_KEEPING[mutation]
    monkeypatch.setattr(owner, name, replacement)
    with pytest.raises(AssertionError, match=complaint):
        for death in range(0, 600, 7):
            play(outlive_the_publisher, LATCHED_SETTINGS[0], (death,))


@pytest.mark.slow
@pytest.mark.every_turn
@pytest.mark.parametrize("mutation", MUTATIONS_OF_GIVING)
def test_broken_giving_of_latched_messages_is_noticed(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Declarations, "_give", MUTATIONS_OF_GIVING[mutation])
    with pytest.raises(AssertionError, match=r"came late|out of order or twice"):
        for death in range(0, 1500, 7):
            play(late_and_short_of_memory, LATCHED_SETTINGS[0], (death,))


@pytest.mark.sampled(4)
@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_broken_recovery_is_noticed(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement = MUTATIONS[mutation]
    monkeypatch.setattr(owner, name, replacement)
    assert _violated(), "no crash point noticed it"


@pytest.mark.parametrize("mutation", MUTATIONS_OF_LOCKSTEP)
def test_broken_lockstep_is_noticed(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement = MUTATIONS_OF_LOCKSTEP[mutation]
    monkeypatch.setattr(owner, name, replacement)
    assert _violated(lockstep=True), "no crash point noticed it"


def _violated(*, lockstep: bool = False) -> bool:
    for scenario, first, settings in product(reversed(SCENARIOS), range(5), SETTINGS):
        for death in range(first, 600, 5):
            try:
                play(scenario, settings, (death,), lockstep=lockstep)
            except (AssertionError, KeyError, IndexError, AttributeError):
                return True
    return False
