"""Mistakes of Python with the types in C are exceptions: no process ends, and no number changes."""

import copy
import pickle
import time
from array import array
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from robbie_mp.bus.transport import layout
from tests.bus.hot._support.exchange import Exchange, parcel_class
from tests.bus.hot._support.trace import played

CAPACITY = 4


def words(count: int) -> memoryview:
    return memoryview(bytearray(8 * count)).cast("Q")


def place() -> Any:
    return SimpleNamespace(
        words=words(64), tail_words=words(64), head_at=0, records_at=8, tail_at=0, capacity=CAPACITY
    )


class Parts:
    """Books with one slot and its link."""

    def __init__(self, built: Any, wake: Callable[[], object] = lambda: None):
        self.built = built
        rows = built.FreeRows(CAPACITY), built.FreeRows(CAPACITY)
        self.books = built.Books(words(4096), 0, 1024, CAPACITY, *rows, array("Q", [0] * CAPACITY), 1 << 20)
        self.slot = built.Slot()
        self.slot.index, self.slot.at = 0, 2048
        self.slot.waiting = self.books.references()
        self.books.set_slots((self.slot,))
        self.link = built.Link()
        self.link.outbound = built.RingReader(place())
        self.link.inbound = built.RingWriter(place())
        self.link.freed = built.NumberRingWriter(place())
        self.link.pushed, self.link.pinned = self.books.references(), self.books.references()
        self.link.in_flight = self.link.windows = array("Q", [0])
        self.link.wake = wake


@pytest.mark.parametrize("name", ["Row", "Field", "Subscription", "Channel", "Link", "Slot", "FreeRows"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_has_a_struct_cannot_be_copied(name: str, copied: Any, built: ModuleType) -> None:
    made = built.FreeRows(3) if name == "FreeRows" else getattr(built, name)()
    with pytest.raises(TypeError, match=f"cannot pickle '.*{name}' object"):
        copied(made)


@pytest.mark.parametrize("other", ["Row", "Subscription", "Link"])
def test_attribute_of_another_class_is_refused(other: str, built: ModuleType) -> None:
    field, owner = vars(built.Slot)["waiting_bytes"], getattr(built, other)()
    with pytest.raises(TypeError, match=f"{other} has no such field"):
        field.__get__(owner)
    with pytest.raises(TypeError, match=f"{other} has no such field"):
        field.__set__(owner, 1)
    with pytest.raises(TypeError, match="Slot has no such field"):
        built.Field().__set__(built.Slot(), 1)


def test_number_with_a_fraction_is_refused(built: ModuleType) -> None:
    parts = Parts(built)
    rows, references = built.FreeRows(CAPACITY), parts.link.pushed
    row = rows.pop()
    references[1] = 7
    for wrong in (
        lambda: rows.append(row + 0.5),
        lambda: setattr(parts.slot, "waiting_bytes", 1.5),
        lambda: setattr(built.Channel(), "paced_reference", 1.5),
        lambda: setattr(built.Subscription(), "queued", 1.5),
        lambda: setattr(parts.link, "channels", {1.5: built.Channel()}),
        lambda: references[1.5],
        lambda: 1.5 in references,
        lambda: references.__setitem__(1, 1.5),
        lambda: references.__setitem__(1.5, 1),
        lambda: references.pop(1.5),
    ):
        with pytest.raises(TypeError, match="cannot be interpreted as an integer"):
            wrong()
    assert (len(rows), references.items(), parts.slot.waiting_bytes) == (CAPACITY - 1, [(1, 7)], 0)


def test_link_whose_ring_was_closed_is_refused_although_it_has_another_one(built: ModuleType) -> None:
    parts = Parts(built)
    parts.books.set_links((parts.link,))
    parts.books.set_links(())
    parts.link.outbound.close()
    parts.link.outbound = built.RingReader(place())
    with pytest.raises(ValueError, match="must be a whole link"):
        parts.books.set_links((parts.link,))


def test_round_is_over_if_a_wake_fails_at_its_end(built: ModuleType) -> None:
    parts = Parts(built, wake=lambda: 1 // 0)
    parts.slot.link = parts.link
    parts.books.set_links((parts.link,))
    parts.books.note_post(parts.link)
    with pytest.raises(ZeroDivisionError):
        parts.books.serve_round(10, False)
    parts.books.set_links(())
    assert parts.books.serve_round(10, False) is None


def test_wakeup_that_is_closed_just_before_the_wait_is_refused(built: ModuleType) -> None:
    wakeup = built.Wakeup(words(1))

    class Closing:
        def __float__(self) -> float:
            wakeup.close()
            return 0.001

    with pytest.raises(ValueError, match="this wake-up is closed"):
        wakeup.wait(Closing())


def test_pins_count_what_the_delivery_contains_whatever_its_attributes_say(built: ModuleType) -> None:
    class Odd(tuple[int, ...]):
        __slots__ = ()
        reference, source, size = 1, layout.pack_source(9, 0, 1), 5

    pins = built.Pins(words(layout.OUT_RING))
    delivery = Odd((0, 0, 3, 0, layout.pack_source(2, 0, 1), 0, 60, 0))
    pins.add(delivery, None)
    assert pins.remove(3) is delivery
    assert len(pins) == 0


def test_period_that_closes_the_inbox_is_an_error(built: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    parcel = parcel_class(built)
    ticks: list[int] = []

    def play() -> None:
        exchange = Exchange(built, parcel)

        class Closing(int):
            def __float__(self) -> float:
                exchange.inbox.close()
                return 1e-9

        exchange.set_period(0.0025, Closing(1))
        try:
            exchange.take_turns(10)
        finally:
            ticks.append(exchange.ticks)
            exchange.close()

    assert "closed" in played(built, play, with_c=True).error
    assert ticks == [1]
