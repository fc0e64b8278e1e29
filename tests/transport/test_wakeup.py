import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robbie_mp.linux.forks import ForkedProcess
from robbie_mp.transport import names
from robbie_mp.transport.segment import SegmentMissing
from robbie_mp.transport.shared_folder import SHARED_MEMORY
from robbie_mp.transport.wakeup import Wakeup, unlink_wakeup
from tests._support.implementations import BOTH, NATIVE, Native

RUN = f"testwake{os.getpid()}"
ALARM_IS_TAKEN = pytest.mark.timeout(60, method="thread")
"""The test needs SIGALRM, with which other tests are ended when they take too long."""


@pytest.fixture(params=BOTH)
def native(request: pytest.FixtureRequest) -> Native | None:
    chosen: Native | None = request.param
    return chosen


@pytest.fixture
def wakeup(native: Native | None) -> Iterator[Wakeup]:
    made = Wakeup.create(RUN, native)
    yield made
    made.close()
    unlink_wakeup(RUN, made.tag)


def test_post_before_the_wait_is_not_lost(wakeup: Wakeup) -> None:
    wakeup.post()
    assert wakeup.wait(0)


def test_one_wait_takes_all_posts(wakeup: Wakeup) -> None:
    for _ in range(100):
        wakeup.post()
    assert wakeup.wait(0)
    assert not wakeup.wait(0)


def test_wild_count_of_posts_does_not_keep_a_process_busy(wakeup: Wakeup) -> None:
    """Every module maps the core's semaphore, so a wild pointer can write any count into it."""
    with (SHARED_MEMORY / f"sem.{names.wakeup(RUN, wakeup.tag)}").open("r+b") as file:
        file.write((2**31 - 1).to_bytes(4, "little"))
    started_s = time.monotonic()
    assert wakeup.wait(10)
    assert time.monotonic() - started_s < 5


@pytest.mark.parametrize("native", BOTH[1:], indirect=True)
def test_semaphore_that_is_closed_while_a_thread_waits_ends_the_wait(wakeup: Wakeup) -> None:
    waiting = threading.Thread(target=wakeup.wait, args=(30,))
    waiting.start()
    while not is_asleep(waiting):
        time.sleep(0.001)
    semaphore = wakeup._native
    assert semaphore is not None
    semaphore.close()
    waiting.join(10)
    assert not waiting.is_alive()
    with pytest.raises(ValueError, match="closed"):
        wakeup.wait(0)


def is_asleep(thread: threading.Thread) -> bool:
    return Path(f"/proc/self/task/{thread.native_id}/stat").read_text().rpartition(")")[2].split()[0] == "S"


def test_closing_twice_is_no_error(wakeup: Wakeup) -> None:
    """An error here once kept the name from being removed."""
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


@ALARM_IS_TAKEN
def test_signal_ends_a_wait(wakeup: Wakeup) -> None:
    previous = signal.signal(signal.SIGALRM, lambda _signal, _frame: None)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    started = time.monotonic()
    assert not wakeup.wait(30)
    assert time.monotonic() - started < 10
    signal.signal(signal.SIGALRM, previous)


@ALARM_IS_TAKEN
@pytest.mark.parametrize("native", BOTH[1:], indirect=True)
def test_exception_of_a_signals_handler_ends_a_wait_of_c(wakeup: Wakeup) -> None:
    """posix_ipc loses it."""

    def fail(_signal: int, _frame: object) -> None:
        raise ZeroDivisionError("by the handler")

    previous = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    with pytest.raises(ZeroDivisionError, match="by the handler"):
        wakeup.wait(30)
    signal.signal(signal.SIGALRM, previous)


@pytest.mark.parametrize("poster", BOTH)
def test_post_wakes_whether_c_or_python_posts_and_waits(wakeup: Wakeup, poster: Native | None) -> None:
    other = Wakeup.attach(RUN, wakeup.tag, poster)
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
    uses: list[Callable[[], object]] = [] if wakeup._native is None else [wakeup.post]
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


INTERPOSED = """
#include <semaphore.h>
#include <stdio.h>
#include <time.h>
int sem_clockwait(sem_t *s, clockid_t clock, const struct timespec *until)
{ return printf("waits by clock %d\\n", clock), fflush(stdout), 0; }
int sem_timedwait(sem_t *s, const struct timespec *until)
{ return printf("waits by the wall clock\\n"), fflush(stdout), 0; }
"""
WAIT = f"""
from robbie_mp._hot import choice
from robbie_mp.transport.wakeup import Wakeup
wakeup = Wakeup.attach("{RUN}", int(input()), choice.native())
wakeup.wait(0.05)
"""


@pytest.mark.skipif(NATIVE is None or not NATIVE.WAITS_BY_MONOTONIC_CLOCK, reason="C does not wait here")
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a compiler")
def test_setting_the_wall_clock_does_not_prolong_a_wait_of_c(tmp_path: Path) -> None:
    """Nobody can set the clock in a test, so look at which clock the C library is told to wait by."""
    made = Wakeup.create(RUN, None)
    (tmp_path / "waits.c").write_text(INTERPOSED)
    library = tmp_path / "waits.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "waits.c"], check=True, timeout=60)
    ended = subprocess.run(
        [sys.executable, "-c", WAIT], env={**os.environ, "LD_PRELOAD": str(library)}, input=f"{made.tag}\n",
        check=True, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    made.close()
    unlink_wakeup(RUN, made.tag)
    assert ended.stdout == f"waits by clock {time.CLOCK_MONOTONIC}\n"


def test_missing_semaphore_is_named(native: Native | None) -> None:
    with pytest.raises(SegmentMissing, match=f"robbie-{RUN}.0000000000000005"):
        Wakeup.attach(RUN, 5, native)
