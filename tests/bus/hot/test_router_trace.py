"""Whatever happens in a run, the router in C makes the same stores as Python, in the same order.

A history is drawn from its number, which a failure names. With `--exhaustive` a million are played;
`_support/many_histories.py` does this in parts.
"""

import shutil
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path
from types import ModuleType

import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.core import router
from tests.bus.core._support.history import History
from tests.bus.core._support.simulated_run import SimulatedRun, connected
from tests.bus.core.test_crash_points import SCENARIOS, SETTINGS, play
from tests.bus.hot._support.build import HOT, fused_module
from tests.bus.hot._support.histories import history
from tests.bus.hot._support.many_histories import compare_histories
from tests.bus.hot._support.trace import difference, played
from tools.fuzz.core.attack import SimulatedAttack
from tools.fuzz.core.plain import inputs

HISTORIES = 200
MANY_HISTORIES = 800
ALL_HISTORIES = 1_000_000
HOSTILE_MODULES = 150
EACH = 17
"""The test plays every 17th input of the fuzzer, because neighbouring inputs are similar."""


PLANTED = {
    "a message is committed before it is written": (
        "    store(row + HANDLE_RECORD, record);\n    store(row + HANDLE_SEQUENCE, message->sequence);",
        "    store(row + HANDLE_SEQUENCE, message->sequence);\n    store(row + HANDLE_RECORD, record);",
    ),
    "a reference is counted before it is committed": (
        "    store(reference_row(books, reference) + REFERENCE_STATE, outcome | nth << 8); /* commits */\n"
        "    store(counted, nth);",
        "    store(counted, nth);\n"
        "    store(reference_row(books, reference) + REFERENCE_STATE, outcome | nth << 8);",
    ),
    "a row that is used again is not marked": ("    store(row + HANDLE_RECORD, NO_RECORD);", ""),
    "a block is given back although its row is not free yet": (
        "    store(row + HANDLE_SEQUENCE, 0);\n    books->free_handles", "    books->free_handles",
    ),
}  # fmt: skip


def attack(data: bytes) -> SimulatedAttack:
    played = SimulatedAttack(data)
    played.run()
    return played


@pytest.mark.parametrize("settings", SETTINGS, ids=["roomy", "short queues", "small tables"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_scenario_is_stored_alike(
    built: ModuleType, scenario: Callable[[History], None], settings: dict[str, int]
) -> None:
    for deaths in ((), (50,), (200, 100)):
        assert difference(built, partial(play, scenario, settings, deaths)) == ""


@pytest.mark.parametrize("at_once", [1, 3])
def test_turn_of_few_records_is_stored_alike(
    built: ModuleType, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(router, "RECORDS_PER_TURN", at_once)
    compare_histories(built, range(50))


@pytest.mark.slow
@pytest.mark.every_turn
def test_histories_are_stored_alike(built: ModuleType) -> None:
    compare_histories(built, range(HISTORIES))


def test_store_beside_the_macro_is_noticed(built: ModuleType) -> None:
    """Also where nothing else is stored, and in memory that is used again."""

    def store_beside() -> object:
        words = built.Words(5000)
        words[0] = 1
        memoryview(words).cast("B")[8 * 4000] = 1
        return words

    def look() -> object:
        return built.Words(5000)[4000]

    with pytest.raises(AssertionError, match="beside the macro"):
        played(built, store_beside, with_c=True)
    assert look() == 0, "it is cleared once it was told"
    played(built, store_beside, with_c=True, look_everywhere=False)
    with pytest.raises(AssertionError, match="beside the macro"):
        played(built, look, with_c=True)


def publish_stamps() -> SimulatedRun:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, MessageHandling.KEEP_ONLY_NEWEST)
    for stamp_ns in (1, 999, 1000, 1999, 2001, 5_000_999, 4_000_001, 2**64 - 1, 3, 20_000_003):
        publisher.publish(channel, stamp_ns)
        run.run_core()
    return run


def test_intervals_between_any_stamps_are_stored_alike(built: ModuleType) -> None:
    assert difference(built, publish_stamps) == ""


def compare_attacks(built: ModuleType, count: int) -> None:
    """Compare inputs of a fuzzer: every kind of record with odd words in each column, and mutations."""
    for number, data in enumerate(islice(inputs(seed=7), 0, count * EACH, EACH)):
        found = difference(built, partial(attack, data))
        assert not found, f"input {number * EACH} of seed 7:\n{found}"


@pytest.mark.slow
@pytest.mark.every_turn
def test_hostile_modules_are_handled_alike(built: ModuleType) -> None:
    compare_attacks(built, HOSTILE_MODULES)


@pytest.mark.slow
@pytest.mark.parametrize("defect", PLANTED)
def test_store_out_of_order_is_noticed(defect: str, compiler_command: list[str], tmp_path: Path) -> None:
    assert compiler_command
    old, new = PLANTED[defect]
    shutil.copytree(HOT, tmp_path / "hot")
    router = tmp_path / "hot" / "router.c"
    text = router.read_text()
    assert text.count(old) == 1, "router.c reads otherwise now; plant this defect again"
    router.write_text(text.replace(old, new))
    built = fused_module(tmp_path, "-O0", hot=tmp_path / "hot")
    assert any(difference(built, partial(history, number)) for number in range(20))


@pytest.mark.slow
@pytest.mark.timeout(0)
def test_many_histories_are_stored_alike(built: ModuleType, pytestconfig: pytest.Config) -> None:
    last = ALL_HISTORIES if pytestconfig.getoption("--exhaustive") else MANY_HISTORIES
    compare_histories(built, range(HISTORIES, last))
