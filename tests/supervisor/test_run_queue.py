"""Who waits for a processor is not hung, as long as the kernel says that it waits."""

import contextlib
import dataclasses
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.supervisor.deadlines import READ_PERIOD_S, RunQueueTime
from robbie_mp.supervisor.incarnations import Doing
from robbie_mp.supervisor.states import ChildState
from robbie_mp.transport.layout import Activity
from tests.supervisor._support import zoo
from tests.supervisor._support.running import NEVER, Run, Scenario, animal

IN_TICK = Doing(Activity.TICK, 0, 1000)
PID = 77
RIVALS = 5


class Kernel:
    """A folder that says what proc(5) would."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.queue = RunQueueTime(PID, folder)

    def says(self, thread: int, state: str, ran_s: float, waited_s: float) -> None:
        folder = self.folder / str(PID) / "task" / str(thread)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "stat").write_text(f"{thread} (a (b) c) {state} 1 1 1")
        (folder / "schedstat").write_text(f"{round(ran_s * 1e9)} {round(waited_s * 1e9)} 5\n")


@pytest.fixture
def kernel(tmp_path: Path) -> Kernel:
    return Kernel(tmp_path)


def test_only_waiting_since_the_begin_counts(kernel: Kernel) -> None:
    kernel.says(77, "S", 1.0, 50.0)
    kernel.queue.begin(10.0)
    assert kernel.queue.waited_s(10.0) == 0.0
    kernel.says(77, "S", 2.0, 53.0)
    assert kernel.queue.waited_s(20.0) == 3.0


def test_longest_waiting_thread_counts_even_if_it_is_not_the_main_one(kernel: Kernel) -> None:
    kernel.says(77, "S", 1.0, 1.0)
    kernel.queue.begin(10.0)
    kernel.says(77, "S", 1.0, 1.5)
    kernel.says(78, "R", 1.0, 4.0)
    assert kernel.queue.waited_s(20.0) == 4.0


def test_thread_that_has_had_no_processor_counts_as_waiting(
    kernel: Kernel,
) -> None:
    """As beside one of real-time priority that never sleeps."""
    kernel.says(77, "R", 1.0, 1.0)
    kernel.queue.begin(10.0)
    assert kernel.queue.waited_s(18.0) == 8.0
    kernel.says(77, "R", 1.1, 9.2)  # at last it ran, and the kernel counts
    assert kernel.queue.waited_s(18.2) == pytest.approx(8.2)


def test_sleeping_thread_does_not_wait_for_a_processor(kernel: Kernel) -> None:
    for state in ("S", "D", "T"):
        kernel.says(77, state, 1.0, 1.0)
        kernel.queue.begin(10.0)
        assert kernel.queue.waited_s(18.0) == 0.0


def test_ended_process_does_not_wait_for_a_processor(kernel: Kernel) -> None:
    kernel.queue.begin(10.0)
    assert kernel.queue.waited_s(10.0 + READ_PERIOD_S) == 0.0


def test_kernel_of_this_machine_provides_these_figures() -> None:
    queue = RunQueueTime(os.getpid())
    queue.begin(0.0)
    assert 0.0 <= queue.waited_s(1.0) < 3600.0


@contextlib.contextmanager
def rivals_for_one_processor() -> Iterator[int]:
    """Keep one processor busy, each rival in a session of its own so that each has a share of its own."""
    processor = min(os.sched_getaffinity(0))
    script = f"import os; os.sched_setaffinity(0, [{processor}])\nwhile True: pass"
    started = [
        subprocess.Popen([sys.executable, "-S", "-c", script], start_new_session=True) for _ in range(RIVALS)
    ]
    try:
        yield processor
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_starved_child_does_not_count_as_hung(tmp_path: Path) -> None:
    """It computes for 0.3 s of a processor, on one that it shares with five others; its deadline is 0.6 s."""
    spec = animal(zoo.computes, "busy", handler_deadline_s=0.6, restart=NEVER)
    with rivals_for_one_processor() as processor:
        environment = {**spec.environment, "PROCESSOR": str(processor)}
        run = Run(tmp_path, dataclasses.replace(spec, environment=environment))
        run.incarnations.busy["busy"] = IN_TICK
        took_s = time.monotonic()

        def scenario() -> Scenario:
            nonlocal took_s
            yield run.all_running
            took_s = time.monotonic()
            yield (run.incarnations.folder / "busy.1.done").exists
            took_s = time.monotonic() - took_s
            del run.incarnations.busy["busy"]
            run.tree.stop("seen enough")

        assert run.play(scenario()) == 0
    assert took_s > 0.6, "it was not starved; this says nothing"
    assert run.states("busy") == [ChildState.STARTING, ChildState.RUNNING, ChildState.STOPPED]


def test_sleeping_child_counts_as_hung_even_on_a_busy_processor(tmp_path: Path) -> None:
    with rivals_for_one_processor():
        run = Run(tmp_path, animal(zoo.works, "idle", handler_deadline_s=0.3, restart=NEVER))
        run.incarnations.busy["idle"] = IN_TICK
        assert run.play() == 1
    assert run.last("idle").reason.startswith("hung in tick")
