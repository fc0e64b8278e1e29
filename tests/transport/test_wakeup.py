import os
import signal
import threading
import time
from collections.abc import Iterator

import pytest

from robbie_mp.transport.segment import SegmentMissing
from robbie_mp.transport.wakeup import Wakeup, unlink_wakeup

RUN = f"testwake{os.getpid()}"


@pytest.fixture
def wakeup() -> Iterator[Wakeup]:
    made = Wakeup.create(RUN)
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


def test_signal_ends_a_wait(wakeup: Wakeup) -> None:
    previous = signal.signal(signal.SIGALRM, lambda _signal, _frame: None)
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    started = time.monotonic()
    assert not wakeup.wait(30)
    assert time.monotonic() - started < 10
    signal.signal(signal.SIGALRM, previous)


def test_missing_semaphore_is_named() -> None:
    with pytest.raises(SegmentMissing, match=f"robbie-{RUN}.0000000000000005"):
        Wakeup.attach(RUN, 5)
