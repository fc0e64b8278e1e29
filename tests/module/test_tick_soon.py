"""A thread of a module can have it tick early."""

import threading

from robbie_mp import Module, ModuleHarness
from robbie_mp.module.module import tick_is_awaited


class Waiting(Module):
    period_s = 60.0

    def tick(self) -> None:
        pass


def test_a_tick_that_any_thread_awaits_is_awaited_once() -> None:
    with ModuleHarness(Waiting) as harness:
        assert not tick_is_awaited(harness.module)
        thread = threading.Thread(target=harness.module.tick_soon)
        thread.start()
        thread.join()
        assert tick_is_awaited(harness.module)
        assert not tick_is_awaited(harness.module)
