"""The core's loop in C, which works until Python must do something, stores what Python stores."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from robbie_mp.bus.core.native_router import NativeRouter
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.words import WORD_BYTES
from tests.bus.core._support.memory import Died
from tests.bus.core._support.simulated_run import SimulatedRun
from tests.bus.hot._support.many_histories import compare_histories
from tests.bus.hot.test_router_trace import compare_attacks

HISTORIES = range(300, 400)
CORE = 0
"""The number of the core's words in a trace: a run makes them first."""


@pytest.fixture
def wakeup(built: ModuleType) -> Iterator[Any]:
    """The core's own, as C waits on it."""
    opened = built.Wakeup(memoryview(bytearray(WORD_BYTES)))
    yield opened
    opened.close()


@pytest.fixture(autouse=True)
def runs_begin_with_a_sleep(built: ModuleType, wakeup: Any, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let the core be woken whenever it is to work, and have C do the first round if it may."""
    rounds_in_c: list[int] = []
    built.hide_values(CORE, layout.CORE_HEARTBEAT_NS)

    def sleep_and_work(run: SimulatedRun) -> None:
        router = run.router
        if isinstance(router, NativeRouter):
            wakeup.post()
            if router.work_alone(wakeup.post, 0.0):
                rounds_in_c.append(1)
                return
            assert wakeup.wait(0)
        words = router._words
        words[layout.CORE_WAKEUPS] = words[layout.CORE_WAKEUPS] + 1
        words[layout.CORE_HEARTBEAT_NS] = 0
        router.run_round()

    def run_core(run: SimulatedRun) -> None:
        while True:
            try:
                sleep_and_work(run)
                while run.router.run_round() or run.router.before_sleep():
                    pass
                return
            except Died:
                run._replace_core()

    monkeypatch.setattr(SimulatedRun, "run_core", run_core)
    return rounds_in_c


@pytest.mark.slow
@pytest.mark.every_turn
def test_histories_are_stored_alike(built: ModuleType, runs_begin_with_a_sleep: list[int]) -> None:
    compare_histories(built, HISTORIES)
    assert len(runs_begin_with_a_sleep) > 5 * len(HISTORIES)


def test_hostile_modules_are_handled_alike(built: ModuleType) -> None:
    compare_attacks(built, 50)
