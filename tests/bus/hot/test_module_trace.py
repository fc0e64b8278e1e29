"""C makes the same stores as Python, in the same order, when a module publishes, handles and keeps."""

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robbie_mp.module.calls.due import NEVER_NS
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.runner import ModuleRunner
from robbie_mp.module.ticks import TimedTicks
from tests.bus.core._support.memory import Died
from tests.bus.hot._support.exchange import PUBLISHER, SUBSCRIBER, Exchange, parcel_class
from tests.bus.hot._support.trace import difference, played

Step = tuple[str, tuple[Any, ...]]

SIZE = st.sampled_from([0, 1, 60, 61, 5000, 40_000])
PERIOD_S = st.sampled_from([None, 1e-9, 0.0025, 0.005, 1, 1e9, np.float64(0.003)])
"""The clock goes on by 1 ms with each look. One of these periods is longer than what C computes with."""
SIMPLE = ("core", "core", "outstanding", "publish_damaged", "restart_core")
STEP = st.one_of(
    st.tuples(
        st.sampled_from(["publish", "publish_encoded"]),
        st.tuples(st.integers(0, 2), st.sampled_from([0, 1, 60, 61, 5000, 40_000])),
    ),
    st.tuples(
        st.just("lend"),
        st.tuples(st.integers(0, 2), st.sampled_from([0, 1, 60, 5000, 40_000]), st.integers(0, 2)),
    ),
    st.tuples(st.just("take_turns"), st.tuples(st.integers(1, 6))),
    st.tuples(st.just("keep"), st.tuples(st.integers(0, 3))),
    st.tuples(st.just("drop"), st.tuples(st.integers(0, 9))),
    st.tuples(
        st.sampled_from(["core", "core", "outstanding", "publish_damaged", "restart_core", "await_tick"]),
        st.just(()),
    ),
    st.tuples(st.just("set_period"), st.one_of(st.tuples(PERIOD_S), st.tuples(PERIOD_S, PERIOD_S))),
    st.tuples(st.just("use_calls"), st.tuples(st.sampled_from([0, 5_000_000, NEVER_NS]))),
    st.tuples(st.just("await_room"), st.tuples(st.integers(0, 3))),
)


@pytest.fixture(scope="module")
def parcel(built: ModuleType) -> Any:
    return parcel_class(built)


def play(built: ModuleType, parcel: Any, steps: list[Step]) -> Exchange:
    exchange = Exchange(built, parcel)
    try:
        for name, arguments in steps:
            getattr(exchange, name)(*arguments)
        exchange.core()
    finally:
        exchange.close()
    return exchange


def compare(built: ModuleType, parcel: Any, steps: list[Step]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "monotonic_ns", built.tick)
        found = difference(built, lambda: play(built, parcel, steps))
    assert found == "", found


LOST: list[Step] = 2 * [("publish_damaged", ()), ("core", ()), ("take_turns", (2,))]
"""Messages that cannot be decoded; Python takes the first of any kind, and C further ones."""


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.lists(STEP, max_size=60))
@example(LOST)
def test_modules_store_alike(built: ModuleType, parcel: Any, steps: list[Step]) -> None:
    compare(built, parcel, steps)


def test_c_really_publishes_and_handles(
    built: ModuleType, parcel: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise Python would be compared with itself."""
    in_python: list[str] = []

    def noted(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def note(*arguments: Any) -> Any:
            in_python.append(name)
            return method(*arguments)

        return note

    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    monkeypatch.setattr(Outbox, "_hand_over", noted("publish", Outbox._hand_over))
    monkeypatch.setattr(Inbox, "handle", noted("handle", Inbox.handle))
    monkeypatch.setattr(TimedTicks, "run", noted("tick", TimedTicks.run))
    message: list[Step] = [("publish", (1, 60)), ("core", ()), ("take_turns", (2,)), ("core", ())]
    steps: list[Step] = [
        *message,
        ("set_period", (1e-9,)),
        *message * 9,
        ("publish_encoded", (1, 60)),
        ("lend", (1, 60, 0)),
        ("lend", (1, 5000, 0)),
    ]
    exchanges: list[Exchange] = []
    played(built, lambda: exchanges.append(play(built, parcel, steps)), with_c=True)
    assert sorted(in_python) == ["handle", "publish"], "each first one: declared, mapped"
    assert exchanges[0].ticks == 18


@pytest.mark.parametrize(("period_s", "by_python"), [(1e-9, 0), (1, 0), (None, 0), (1e9, 1)])
def test_c_really_takes_turns(
    built: ModuleType, parcel: Any, period_s: float | None, by_python: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    turns = 0
    turn = ModuleRunner.turn

    def count_turn(runner: ModuleRunner) -> None:
        nonlocal turns
        turns += 1
        turn(runner)

    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    monkeypatch.setattr(ModuleRunner, "turn", count_turn)
    steps: list[Step] = [("set_period", (period_s, 1e-9)), ("take_turns", (4,))]
    played(built, lambda: play(built, parcel, steps), with_c=True)
    assert turns == by_python


def test_c_keeps_the_loop_of_a_module_with_calls(
    built: ModuleType, parcel: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And does what is due for them, as often as Python."""
    in_python: list[ModuleRunner] = []
    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    steps: list[Step] = [("take_turns", (1,)), ("use_calls", (5_000_000,)), ("take_turns", (9,))]
    runs: list[int] = []
    turn = ModuleRunner.turn

    def note_turn(runner: ModuleRunner) -> None:
        in_python.append(runner)
        turn(runner)

    monkeypatch.setattr(ModuleRunner, "turn", note_turn)
    played(built, lambda: runs.append(play(built, parcel, steps).calls_run), with_c=True)
    assert not in_python
    played(built, lambda: runs.append(play(built, parcel, steps).calls_run), with_c=False)
    assert in_python
    assert runs[0] == runs[1] >= 2


def test_awaited_tick_comes_before_its_time(
    built: ModuleType, parcel: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In C, and once for each time that it is awaited."""
    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    once: list[Step] = [("await_tick", ()), ("take_turns", (9,))]
    exchanges: list[Exchange] = []
    steps: list[Step] = [("set_period", (1000,)), ("take_turns", (9,)), *once, *once]
    outcome = played(built, lambda: exchanges.append(play(built, parcel, steps)), with_c=True)
    assert outcome.error == ""
    assert exchanges[0].ticks == 1 + 2, "the first is due at once"


@pytest.mark.parametrize("size", [0, 60, 5000])
@pytest.mark.parametrize("keep", [0, 1, 3])
def test_every_step_of_a_message_is_stored_alike(
    built: ModuleType, parcel: Any, size: int, keep: int
) -> None:
    message: list[Step] = [("publish", (1, size)), ("core", ()), ("take_turns", (2,)), ("core", ())]
    ticking: list[Step] = [("set_period", (0.0025,)), *message * 2, ("set_period", (0.0025, None)), *message]
    lent: list[Step] = [("lend", (1, size, 0)), ("core", ()), ("take_turns", (2,)), ("core", ())]
    steps = [("keep", (keep,)), *message * 5, ("drop", (0,)), *message * 3, *ticking, *lent * 3]
    compare(built, parcel, steps)


@pytest.mark.parametrize("slot", [PUBLISHER, pytest.param(SUBSCRIBER, marks=pytest.mark.slow)])
@pytest.mark.parametrize("keep", [0, 1])
def test_module_dies_before_any_of_its_stores_alike(
    built: ModuleType, parcel: Any, slot: int, keep: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what the core makes of it is the same. One that keeps messages dies before every third store."""
    message: list[Step] = [
        ("publish", (1, 60)),
        ("core", ()),
        ("lend", (1, 5000, 0)),
        ("core", ()),
        ("publish_encoded", (1, 60)),
        ("core", ()),
        ("take_turns", (4,)),
        ("drop", (0,)),
        ("core", ()),
    ]
    begin: list[Step] = [("keep", (keep,)), *message * 2, ("set_period", (0.0025,))]
    deaths = 0

    def play_and_die(stores: int) -> Exchange:
        nonlocal deaths
        exchange = Exchange(built, parcel)
        try:
            for name, arguments in [*begin, ("die_after", (slot, stores)), *message * 2]:
                getattr(exchange, name)(*arguments)
        except Died:
            deaths += 1
            exchange.bury(slot)
            exchange.core()
        finally:
            exchange.close()
        return exchange

    monkeypatch.setattr(time, "monotonic_ns", built.tick)
    for stores in range(0, 1000, 3 if keep else 1):
        deaths = 0
        found = difference(built, lambda stores=stores: play_and_die(stores))  # type: ignore[misc]
        assert found == "", f"after {stores} stores:\n{found}"
        if not deaths:
            break
        assert deaths == 2
    assert stores >= (20 if slot == PUBLISHER else 60), "it died before each of them"
