"""Every store is a crash point: core and modules die before each of theirs in turn, and others take over.

The core in C dies before every store in the first of the settings. In the others, and in Python, which makes
the same stores, it dies before every fifth. It and its successor die before some pairs of stores. With
`--exhaustive` it is every store, and every pair.
"""

from collections.abc import Callable
from typing import Any

import pytest

from tests.bus.core._support.history import SLOTS, History
from tests.bus.core._support.memory import Fuse, StateLog
from tests.bus.core._support.simulated_run import SimulatedRun

pytestmark = [pytest.mark.slow, pytest.mark.every_turn]

Scenario = Callable[[History], None]


def fan_out(history: History) -> None:
    for _ in range(3):
        history.publish(1)
        history.core()
        for slot in (2, 3):
            history.handle(slot)
        history.core()


def backpressure(history: History) -> None:
    for _ in range(11):
        history.publish(1)
    history.core()
    for _ in range(3):
        history.handle(2)
        history.handle(3)
        history.core()


def full_table(history: History) -> None:
    for _ in range(8):
        history.publish(1)
        history.publish(2)
    history.core()
    history.handle(2)
    history.core()


def full_ring(history: History) -> None:
    for _ in range(20):
        history.publish(1)
    history.core()


def newest_replaced(history: History) -> None:
    history.publish(1)
    history.core()
    history.keep(3)
    for _ in range(4):
        history.publish(2)
        history.core()
    history.handle(3)
    history.let_go(3)
    history.core()


def owner_dead(history: History) -> None:
    for _ in range(3):
        history.publish(1)
    history.kill(1)
    history.handle(2)
    history.core()
    history.start(1)
    history.publish(1)
    history.core()


def subscriber_dead(history: History) -> None:
    for _ in range(7):
        history.publish(1)
        history.core()
    history.keep(2)
    history.core()
    history.begin_and_die(2)
    history.publish(1)
    history.core()
    history.start(2)
    history.begin_and_die(3)
    history.start(3)
    history.core()


def both_dead(history: History) -> None:
    for _ in range(5):
        history.publish(1)
        history.publish(2)
        history.core()
    history.begin_and_die(2)
    history.kill(1)
    history.kill(3)
    history.start(3)
    history.start(1)
    history.publish(1)
    history.start(2)
    history.core()


def short_of_memory(history: History) -> None:
    for _ in range(10):
        history.publish(1)
        history.publish(2)
        history.core()
    history.make_room(1, 5)
    history.core()
    history.keep(2)
    history.make_room(2, 1)
    history.make_room(1, 1)
    history.publish(1)
    history.core()
    history.begin_and_die(2)
    history.make_room(1, 0)
    history.core()


def rows_used_again(history: History) -> None:
    """The row that was freed last is used next; a new core uses the lowest one."""
    history.publish(1)
    history.publish(1)
    history.core()
    for _ in range(2):
        history.handle(2)
        history.handle(3)
        history.core()
    history.publish(2)
    history.core()


def stopped_and_started(history: History) -> None:
    history.publish(1)
    history.core()
    history.handle(2)
    for _ in range(3):
        history.publish(1)
    history.core()
    for slot in (2, 3):
        history.stop(slot)
        history.publish(1)
        history.core()
    history.publish(1)  # given back at once, for nobody wants it
    history.core()
    for slot in (2, 3):
        history.start(slot)
        history.publish(1)
    history.core()


def yield_to_pace(history: History) -> None:
    """What does not fit into the ring of 2 replaces what waits: beside 3, alone, and of dead publishers."""
    history.wait(1)
    for _ in range(7):
        history.publish(1)
        history.core()
    history.handle(2)
    history.kill(3)
    for _ in range(6):
        history.publish(1)
        history.core()
    history.publish(2)
    history.core()
    history.publish(1)
    history.kill(1)
    history.start(1)
    history.wait(1)
    history.publish(1)
    history.publish(1)
    history.core()
    history.begin_and_die(2)
    history.core()


SCENARIOS = (
    fan_out, backpressure, full_table, full_ring, newest_replaced, owner_dead, subscriber_dead, both_dead,
    short_of_memory, rows_used_again, stopped_and_started, yield_to_pace,
)  # fmt: skip


def come_late(history: History) -> None:
    history.publish(1)
    history.publish(2)
    history.core()
    for slot in (2, 3):
        history.handle(slot)
        history.kill(slot)
        history.start(slot)
        history.publish(1)
        history.handle(slot)
    history.core()
    for slot in (2, 3):
        history.join(slot)
        history.keep(slot)
        history.publish(2)
        history.begin_and_die(slot)
        history.join(slot)
    history.core()


def outlive_the_publisher(history: History) -> None:
    history.publish(1)
    history.core()
    history.kill(1)
    history.begin_and_die(2)
    history.stop(3)
    history.start(2)
    history.start(3)
    history.core()
    history.start(1)
    history.publish(1)
    history.publish(2)
    history.core()


def late_and_short_of_memory(history: History) -> None:
    for _ in range(8):
        history.publish(1)
        history.publish(2)
        history.core()
    history.kill(2)
    history.start(2)
    history.make_room(1, 1)
    history.core()
    history.join(3)
    history.drop_latched(1)
    history.core()
    history.join(2)
    history.publish(2)
    history.core()


def die_twice(history: History) -> None:
    """The newest message kills both subscribers again; then one of them is stopped and started."""
    for _ in range(2):
        history.publish(1)
        history.core()
        for slot in (2, 3):
            for _ in range(3):
                history.begin_and_die(slot)
                history.start(slot)
    history.core()
    history.stop(3)
    history.start(3)
    history.begin_and_die(3)
    history.start(3)
    history.core()


LATCHED_SCENARIOS = (come_late, outlive_the_publisher, late_and_short_of_memory, die_twice)
"""Played with a latched channel."""
LATCHED_SETTINGS: tuple[dict[str, Any], ...] = (
    {"latched": True},
    {"latched": True, "by_patterns": True},
    {"latched": True, "queue_messages": 1, "handles": 12, "in_flight_bytes": 16},
    {"latched": True, "handles": 4},
    {"latched": True, "latched_bytes": 4},
)
FIRST_STRIDE = 3
"""Of the common setting with the hot path in C; `--exhaustive` tries every store, and takes hours."""
STRIDE = 15
LATCHED_STRIDE = 47
PAIR_STRIDES: dict[Scenario, tuple[int, int]] = {rows_used_again: (1, 5)}
"""Of first and second deaths: here one single first death can have a message entered twice."""
OTHER_PAIR_STRIDES = (67, 31)
LATCHED_PAIR_STRIDES = (193, 97)
SETTINGS: tuple[dict[str, Any], ...] = (
    {"handles": 12},
    {"queue_messages": 1, "handles": 12, "in_flight_bytes": 16},
    {"handles": 4},
)


def play(
    scenario: Scenario,
    settings: dict[str, Any],
    deaths: tuple[int, ...],
    fuses: dict[int, Fuse] | None = None,
    *,
    lockstep: bool = False,
    log: StateLog | None = None,
) -> History:
    history = History(deaths, fuses=fuses, lockstep=lockstep, log=log, **settings)
    scenario(history)
    history.finish()
    return history


@pytest.mark.sampled(18)
@pytest.mark.parametrize("number", range(len(SETTINGS)), ids=["roomy", "short queues", "small tables"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_core_may_die_before_any_store(
    scenario: Scenario, number: int, hot_path: str, pytestconfig: pytest.Config
) -> None:
    stride = FIRST_STRIDE if number == 0 and hot_path == "C" else STRIDE
    is_exhaustive = pytestconfig.getoption("--exhaustive")
    _kill_core(scenario, SETTINGS[number], 0 if is_exhaustive else number, 1 if is_exhaustive else stride)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("number", range(len(LATCHED_SETTINGS)))
@pytest.mark.parametrize("scenario", (*LATCHED_SCENARIOS, both_dead, stopped_and_started))
def test_core_of_latched_channel_may_die_before_any_store(
    scenario: Scenario, number: int, hot_path: str, pytestconfig: pytest.Config
) -> None:
    is_first = number == 0 and scenario is come_late and hot_path == "C"
    is_exhaustive = pytestconfig.getoption("--exhaustive")
    stride = FIRST_STRIDE if is_first else LATCHED_STRIDE
    _kill_core(
        scenario, LATCHED_SETTINGS[number], 0 if is_exhaustive else number, 1 if is_exhaustive else stride
    )


def _kill_core(scenario: Scenario, settings: dict[str, Any], first: int, stride: int) -> None:
    stores = play(scenario, settings, ()).run.fuse.stores
    deaths = range(first, stores, stride)
    for death in deaths:
        history = play(scenario, settings, (death,))
        assert history.run.crashes == 1
    print(f"{scenario.__name__}: {len(deaths)} crash points of {stores}, 0 violations")


@pytest.mark.parametrize("number", range(len(SETTINGS)), ids=["roomy", "short queues", "small tables"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_core_may_die_again_before_any_store_of_its_successor(
    scenario: Scenario, number: int, pytestconfig: pytest.Config
) -> None:
    """Every pair of deaths; of those that leave the same state behind, and so have the same future, one."""
    strides = PAIR_STRIDES.get(scenario, OTHER_PAIR_STRIDES)
    if pytestconfig.getoption("--exhaustive"):
        strides = (1, 1)
    elif number:
        pytest.skip("pairs of deaths in all settings are tried with --exhaustive")
    _kill_core_twice(scenario, SETTINGS[number], strides)


@pytest.mark.parametrize("number", range(len(LATCHED_SETTINGS)))
@pytest.mark.parametrize("scenario", LATCHED_SCENARIOS)
def test_core_of_latched_channel_may_die_again_before_any_store_of_its_successor(
    scenario: Scenario, number: int, pytestconfig: pytest.Config
) -> None:
    if pytestconfig.getoption("--exhaustive"):
        _kill_core_twice(scenario, LATCHED_SETTINGS[number], (1, 1))
    elif number:
        pytest.skip("pairs of deaths in all settings are tried with --exhaustive")
    else:
        _kill_core_twice(scenario, LATCHED_SETTINGS[number], LATCHED_PAIR_STRIDES)


def _kill_core_twice(scenario: Scenario, settings: dict[str, Any], strides: tuple[int, int]) -> None:
    first_lives = states(scenario, settings, ())
    seen = set(first_lives)
    pairs = played = 0
    pairs_after: dict[int, int] = {}
    for first in range(0, len(first_lives), strides[0]):
        if first_lives[first] not in pairs_after:
            after = states(scenario, settings, (first,))[:: strides[1]]
            pairs_after[first_lives[first]] = len(after)
            for number, state in enumerate(after):
                if state not in seen:
                    seen.add(state)
                    history = play(scenario, settings, (first, number * strides[1]))
                    assert history.run.crashes == 2
                    played += 1
        pairs += pairs_after[first_lives[first]]
    print(f"{scenario.__name__}: {pairs} pairs of deaths, {played} different ones played, 0 violations")


def states(scenario: Scenario, settings: dict[str, Any], deaths: tuple[int, ...]) -> list[int]:
    """Return a name for the state before each store of the core that lives to the end of a scenario."""
    log = StateLog()
    play(scenario, settings, deaths, log=log)
    return log.before_store


@pytest.mark.parametrize("slot", SLOTS)
@pytest.mark.parametrize(
    "scenario", (backpressure, newest_replaced, owner_dead, subscriber_dead, short_of_memory)
)
def test_module_may_die_before_any_store(scenario: Scenario, slot: int) -> None:
    undisturbed = SimulatedRun.memory.fuse()
    play(scenario, SETTINGS[0], (), {slot: undisturbed})
    for death in range(undisturbed.stores):
        fuse = SimulatedRun.memory.fuse()
        fuse.deaths = [death]
        history = play(scenario, SETTINGS[0], (), {slot: fuse})
        assert history.incarnations[slot] > 1 or slot not in history.alive
    print(f"{scenario.__name__}, module {slot}: {undisturbed.stores} crash points, 0 violations")


@pytest.mark.sampled(8)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_core_in_lockstep_may_die_before_any_store(scenario: Scenario, pytestconfig: pytest.Config) -> None:
    stores = play(scenario, SETTINGS[0], (), lockstep=True).run.fuse.stores
    deaths = range(0, stores, 1 if pytestconfig.getoption("--exhaustive") else STRIDE)
    for death in deaths:
        history = play(scenario, SETTINGS[0], (death, death % 50), lockstep=True)  # and again soon after
        assert history.run.crashes > 0
    print(f"{scenario.__name__} in lockstep: {len(deaths)} crash points of {stores}, 0 violations")
