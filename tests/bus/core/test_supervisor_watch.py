"""The core continues a supervisor that was stopped, and ends if that does not help."""

import os
import signal
from array import array

import pytest

from robbie_mp.bus.core.supervisor_watch import CONTINUE_AFTER, END_AFTER, LOOK_NS, SupervisorWatch
from robbie_mp.bus.transport import layout


class Supervisor:
    """A supervisor that a test moves, and what the core does to it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.words = array("Q", bytes(8 * layout.OUT_RING))
        self.signals: list[tuple[int, int]] = []
        self.reports: list[str] = []
        self.watch = SupervisorWatch(self.words, self.reports.append)
        self.now_ns = 1
        monkeypatch.setattr(os, "kill", lambda *arguments: self.signals.append(arguments))
        self.turn()
        self.looks(1)

    def turn(self) -> None:
        self.words[layout.OUT_ACTIVITY_SINCE_NS] = self.now_ns

    def looks(self, count: int) -> bool:
        """Let the core look; return whether it ends."""
        for _ in range(count):
            self.now_ns += LOOK_NS
            must_end = self.watch.look(self.now_ns)
        return must_end


@pytest.fixture
def supervisor(monkeypatch: pytest.MonkeyPatch) -> Supervisor:
    return Supervisor(monkeypatch)


def test_supervisor_that_makes_progress_is_left_alone(supervisor: Supervisor) -> None:
    for _ in range(10):
        assert not supervisor.looks(CONTINUE_AFTER - 1)
        supervisor.turn()
        assert not supervisor.looks(1)
    assert supervisor.signals == []


def test_stopped_supervisor_is_continued_and_this_is_said_once(supervisor: Supervisor) -> None:
    assert not supervisor.looks(CONTINUE_AFTER + 2)
    assert supervisor.signals == [(os.getppid(), signal.SIGCONT)] * 3
    assert supervisor.reports == [
        "the supervisor makes no progress; it is continued (SIGCONT) in case it was stopped"
    ]


def test_core_ends_if_the_supervisor_cannot_be_continued(supervisor: Supervisor) -> None:
    assert not supervisor.looks(END_AFTER - 1)
    assert supervisor.looks(1)


def test_pause_of_the_whole_machine_counts_as_one_look(supervisor: Supervisor) -> None:
    supervisor.now_ns += 3600 * 10**9
    assert not supervisor.looks(1)
    assert supervisor.signals == []
