"""The time that counts against a deadline, and hung children. Waiting for a processor does not count."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.bus.transport.layout import Activity
from robbie_mp.run.supervisor.deadlines import MAX_STEP_S, READ_PERIOD_S, HangWatch, RunningTime, RunQueueTime
from robbie_mp.run.supervisor.incarnations import Doing

PID = 77
HANDLER = Doing(Activity.HANDLER, 3, 1000)
TEARDOWN = Doing(Activity.TEARDOWN, 0, 1000)


class Waits(RunQueueTime):
    """A child that waits for a processor for a share of the time."""

    def __init__(self, share: float):
        self.share = share
        self.begun_s: list[float] = []

    def begin(self, now_s: float) -> None:
        self.begun_s.append(now_s)

    def waited_s(self, now_s: float) -> float:
        return (now_s - self.begun_s[-1]) * self.share


def looks(watch: HangWatch, doings: list[Doing | None], waits: Waits | None = None) -> list[float | None]:
    waits = waits or Waits(0.0)
    return [watch.hung_for_s(doing, float(second), waits) for second, doing in enumerate(doings)]


def test_handler_is_hung_once_its_deadline_has_passed() -> None:
    assert looks(HangWatch(2.0, 0.0), [HANDLER] * 4) == [None, None, 2.0, 3.0]


def test_time_without_a_processor_does_not_count() -> None:
    """Looked at from the second second on, of which three quarters are spent in the run queue."""
    hung = looks(HangWatch(2.0, 0.0), [HANDLER] * 7, Waits(0.75))
    assert hung == [None] * 5 + [5.0, 6.0]


def test_run_queue_is_not_read_for_short_handlers() -> None:
    waits = Waits(0.0)
    doings: list[Doing | None] = [Doing(Activity.HANDLER, 3, second // 2) for second in range(100)]
    assert looks(HangWatch(30.0, 0.0), doings, waits) == [None] * 100
    assert waits.begun_s == []


def test_idle_module_is_never_hung() -> None:
    assert looks(HangWatch(2.0, 0.0), [None] * 100) == [None] * 100


def test_module_that_proceeds_to_the_next_message_is_not_hung() -> None:
    doings: list[Doing | None] = [Doing(Activity.HANDLER, 3, begin_ns) for begin_ns in range(100)]
    assert looks(HangWatch(2.0, 0.0), doings) == [None] * 100


def test_change_of_a_single_word_counts_as_new_activity() -> None:
    """As when the module is just between its two words."""
    between = Doing(Activity.HANDLER, 3, 2000)
    assert looks(HangWatch(2.0, 0.0), [HANDLER, HANDLER, between, HANDLER, None, HANDLER]) == [None] * 6


def test_without_a_deadline_nothing_is_hung() -> None:
    assert looks(HangWatch(0.0, 0.0), [HANDLER] * 100) == [None] * 100


def test_teardown_may_take_as_long_as_the_grace_of_an_ordered_stop() -> None:
    assert looks(HangWatch(2.0, 4.0), [TEARDOWN] * 5) == [None] * 4 + [4.0]
    assert looks(HangWatch(2.0, 1.0), [TEARDOWN] * 3) == [None] * 2 + [2.0]


@given(st.lists(st.floats(0.0, 1e6)))
def test_pauses_of_this_process_do_not_count_as_time(steps_s: list[float]) -> None:
    now_s = 0.0
    time_of = RunningTime(lambda: now_s)
    for step_s in steps_s:
        before_s, before_now_s = time_of(), now_s
        now_s += step_s
        passed_s = time_of() - before_s
        assert passed_s <= MAX_STEP_S + 1e-6
        if step_s <= MAX_STEP_S:
            assert abs(passed_s - (now_s - before_now_s)) < 1e-6


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
