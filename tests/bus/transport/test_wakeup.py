import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import pytest

from robbie_mp.base.linux.forks import ForkedProcess
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.segment import Segment, SegmentMismatch, SegmentMissing
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.bus.transport.words import WORD_BYTES
from tests._support.implementations import BOTH, Native

RUN = f"testwake{os.getpid()}"
NAME = names.wakeup(RUN, 1, 1)
ALARM_IS_TAKEN = pytest.mark.timeout(60, method="thread")
"""The test needs SIGALRM, with which other tests are ended when they take too long."""


@pytest.fixture(params=BOTH)
def native(request: pytest.FixtureRequest) -> Native | None:
    chosen: Native | None = request.param
    return chosen


@pytest.fixture(autouse=True)
def folder() -> Iterator[None]:
    make_folder(RUN)
    yield
    remove_names(RUN)


@pytest.fixture
def asleep() -> memoryview:
    """A word of the process that waits, which says whether it sleeps."""
    return memoryview(bytearray(WORD_BYTES)).cast("Q")


@pytest.fixture
def wakeup(native: Native | None, asleep: memoryview) -> Iterator[Wakeup]:
    made = Wakeup.create(NAME, native, asleep)
    yield made
    made.close()


def test_post_before_the_wait_is_not_lost(wakeup: Wakeup) -> None:
    wakeup.post()
    assert wakeup.wait(0)


def test_one_wait_takes_all_posts(wakeup: Wakeup) -> None:
    for _ in range(100):
        wakeup.post()
    assert wakeup.wait(0)
    assert not wakeup.wait(0)


@pytest.mark.parametrize("poster", BOTH)
def test_nothing_that_a_module_writes_into_the_memory_ends_posts_or_waits(
    wakeup: Wakeup, asleep: memoryview, poster: Native | None
) -> None:
    """glibc aborted in each post to a semaphore whose pages had been overwritten."""
    other = Wakeup.attach(NAME, poster, asleep.toreadonly())
    bits = Random(34)
    with (SHARED_MEMORY / NAME).open("r+b", buffering=0) as file:
        for fill in [b"\xff", b"\x00", b"\x7f", *(bits.randbytes(1) for _ in range(20)), None]:
            file.seek(0)
            file.write(bits.randbytes(4096) if fill is None else fill * 4096)
            wakeup.wait(0)
            assert not wakeup.wait(0.001), "whatever is there is taken once"
            other.post()
            assert wakeup.wait(10)
    other.close()


@pytest.mark.parametrize("poster", BOTH)
def test_posts_wake_promptly_while_a_module_writes_into_the_memory(
    wakeup: Wakeup, asleep: memoryview, poster: Native | None
) -> None:
    other = Wakeup.attach(NAME, poster, asleep.toreadonly())
    segment = Segment.map(NAME, write=True)
    over = threading.Event()

    def scribble() -> None:
        bits = Random(34)
        while not over.wait(0.0005):
            segment.buffer[:] = bits.randbytes(len(segment.buffer))

    def post() -> None:
        while not over.wait(0.002):
            other.post()

    threads = [threading.Thread(target=target) for target in (scribble, post)]
    for thread in threads:
        thread.start()
    woken = sum(wakeup.wait(1.0) for _ in range(200))
    over.set()
    for thread in threads:
        thread.join()
    assert woken == 200
    segment.close()
    other.close()


WRITE_THE_SAME = """
import mmap, sys
with open(sys.argv[1], "r+b") as file:
    words = memoryview(mmap.mmap(file.fileno(), 0)).cast("Q")
print("writes", flush=True)
while True:
    words[int(sys.argv[2])] = 7
"""


@pytest.mark.parametrize("poster", BOTH)
def test_posts_wake_promptly_while_a_module_writes_the_same_number_again_and_again(
    wakeup: Wakeup, asleep: memoryview, poster: Native | None
) -> None:
    """The process that waits was woken, found the number that it had seen last, and slept on."""
    other = Wakeup.attach(NAME, poster, asleep.toreadonly())
    command = [sys.executable, "-c", WRITE_THE_SAME, str(SHARED_MEMORY / NAME), str(layout.WAKEUP_POSTS)]
    late = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        try:
            writer.stdout.readline()
            for _ in range(100):
                wakeup.wait(0)
                waiting = threading.Thread(target=wakeup.wait, args=(1.0,))
                waiting.start()
                while waiting.is_alive() and not (asleep[0] and is_asleep(waiting)):
                    time.sleep(0)
                began = time.monotonic()
                other.post()
                waiting.join()
                late += time.monotonic() - began > 0.9
        finally:
            writer.kill()
    assert late == 0
    other.close()


@pytest.mark.parametrize("poster", BOTH)
def test_no_post_is_lost_between_two_that_post_and_one_that_falls_asleep(
    wakeup: Wakeup, asleep: memoryview, poster: Native | None
) -> None:
    """Each poster waits for an answer to each post; one that is lost is noticed only after the time-out."""
    others = [Wakeup.attach(NAME, poster, asleep.toreadonly()) for _ in range(2)]
    asked, answered = [0, 0], [threading.Semaphore(0), threading.Semaphore(0)]

    def ask(number: int) -> None:
        for _ in range(300):
            asked[number] += 1
            others[number].post()
            answered[number].acquire()

    threads = [threading.Thread(target=ask, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    given = [0, 0]
    while sum(given) < 600:
        assert wakeup.wait(10)
        for number in (0, 1):
            if given[number] < asked[number]:
                given[number] += 1
                answered[number].release()
    for thread in threads:
        thread.join()
    for other in others:
        other.close()


def test_process_says_that_it_sleeps_only_while_it_does(wakeup: Wakeup, asleep: memoryview) -> None:
    waiting = threading.Thread(target=wakeup.wait, args=(30,))
    waiting.start()
    while not is_asleep(waiting):
        time.sleep(0.001)
    assert asleep[0] == 1
    wakeup.post()
    waiting.join()
    assert asleep[0] == 0


@pytest.mark.parametrize("native", BOTH[1:], indirect=True)
def test_process_that_may_not_say_that_it_sleeps_may_not_wait(native: Native, asleep: memoryview) -> None:
    made = Wakeup.create(NAME, native, asleep.toreadonly())
    with pytest.raises(PermissionError):
        made.wait(1.0)
    made.close()


@pytest.mark.parametrize("posts", [2**31 - 1, 2**31, 2**32 - 1, 2**64 - 1])
def test_count_of_posts_may_overflow(native: Native | None, posts: int) -> None:
    made = Wakeup.create(NAME, native)
    segment = Segment.map(NAME, write=True)
    segment.words[layout.WAKEUP_POSTS] = posts
    assert made.wait(0) and not made.wait(0)
    made.post()
    assert made.wait(0) and not made.wait(0)
    segment.close()
    made.close()


@pytest.mark.parametrize("native", BOTH[1:], indirect=True)
def test_wakeup_that_is_closed_while_a_thread_waits_ends_the_wait(wakeup: Wakeup) -> None:
    waiting = threading.Thread(target=wakeup.wait, args=(30,))
    waiting.start()
    while not is_asleep(waiting):
        time.sleep(0.001)
    wakeup._native.close()
    waiting.join(10)
    assert not waiting.is_alive()
    with pytest.raises(ValueError, match="closed"):
        wakeup.wait(0)


def is_asleep(thread: threading.Thread) -> bool:
    try:
        stat = Path(f"/proc/self/task/{thread.native_id}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):  # the thread has just ended
        return False
    return stat.rpartition(")")[2].split()[0] == "S"


def test_closing_twice_is_no_error(wakeup: Wakeup) -> None:
    wakeup.close()
    wakeup.close()


def test_wait_ends_at_its_time_out(wakeup: Wakeup) -> None:
    assert not wakeup.wait(0.01)


def test_waiting_lets_other_threads_run(wakeup: Wakeup) -> None:
    poster = threading.Thread(target=wakeup.post)
    poster.start()
    assert wakeup.wait(10)
    poster.join()


def test_patient_wait_leaves_posts_alone_for_a_while_and_takes_them_then(wakeup: Wakeup) -> None:
    wakeup.patience_s = 0.02
    wakeup.post()
    started = time.monotonic()
    assert wakeup.wait(10)
    assert 0.02 <= time.monotonic() - started < 10
    assert not wakeup.wait(0.001)


def ends_by_a_signal(wakeup: Wakeup) -> bool:
    previous = signal.signal(signal.SIGALRM, lambda _signal, _frame: None)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    started = time.monotonic()
    is_woken = wakeup.wait(60)
    signal.signal(signal.SIGALRM, previous)
    return not is_woken and time.monotonic() - started < 10


@ALARM_IS_TAKEN
def test_signal_ends_a_wait(wakeup: Wakeup) -> None:
    assert ends_by_a_signal(wakeup)


@ALARM_IS_TAKEN
@pytest.mark.parametrize("native", BOTH[1:])
def test_signal_ends_the_sleep_of_a_patient_wait_in_c(wakeup: Wakeup) -> None:
    wakeup.patience_s = 30.0
    assert ends_by_a_signal(wakeup)


@ALARM_IS_TAKEN
def test_exception_of_a_signals_handler_ends_a_wait(wakeup: Wakeup) -> None:
    def fail(_signal: int, _frame: object) -> None:
        raise ZeroDivisionError("by the handler")

    previous = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    with pytest.raises(ZeroDivisionError, match="by the handler"):
        wakeup.wait(30)
    signal.signal(signal.SIGALRM, previous)


@pytest.mark.parametrize("poster", BOTH)
def test_post_wakes_whether_c_or_python_posts_and_waits(wakeup: Wakeup, poster: Native | None) -> None:
    other = Wakeup.attach(NAME, poster)
    thread = threading.Timer(0.02, other.post)
    thread.start()
    assert wakeup.wait(10)
    thread.join()
    other.close()


def test_wait_without_limit_ends_with_a_post(wakeup: Wakeup) -> None:
    thread = threading.Timer(0.02, wakeup.post)
    thread.start()
    assert wakeup.wait()
    thread.join()


def test_spinning_wait_takes_the_post(wakeup: Wakeup) -> None:
    wakeup.spin_s = 5.0
    thread = threading.Timer(0.02, wakeup.post)
    thread.start()
    assert wakeup.wait(10)
    thread.join()
    assert not wakeup.wait(0)


def test_forked_process_is_refused(wakeup: Wakeup) -> None:
    uses: list[Callable[[], object]] = [wakeup.post]
    pid = os.fork()
    if pid == 0:
        wakeup.disown()  # as in a fork of the fork
        uses += [wakeup.post, lambda: wakeup.wait(0)]
        refused = 0
        for use in uses:
            try:
                use()
            except ForkedProcess:
                refused += 1
        os._exit(refused)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == len(uses) + 2
    assert not wakeup.wait(0)


def test_missing_wakeup_is_named(native: Native | None) -> None:
    with pytest.raises(SegmentMissing, match=f"robbie-{RUN}/wakeup-1-5"):
        Wakeup.attach(names.wakeup(RUN, 1, 5), native)


def test_truncated_wakeup_is_refused(wakeup: Wakeup, native: Native | None) -> None:
    os.truncate(SHARED_MEMORY / NAME, 128)
    with pytest.raises(SegmentMismatch, match="truncated"):
        Wakeup.attach(NAME, native)
    os.truncate(SHARED_MEMORY / NAME, 4096)
