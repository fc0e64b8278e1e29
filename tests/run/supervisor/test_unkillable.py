"""Processes that SIGKILL does not end delay no other process, and are handled normally when they end."""

import dataclasses
import itertools
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.base.linux.proc import read_stat
from robbie_mp.run.profile.model import RestartPolicy
from robbie_mp.run.supervisor import leftovers, supervised_child
from robbie_mp.run.supervisor.child_spec import ChildSpec
from robbie_mp.run.supervisor.process import ChildProcess
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.tree import CannotControl
from tests._support.debugger import held_by_debugger
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, QUICK, Run, Scenario, animal
from tools.loop_disk import LoopDisk

pytestmark = pytest.mark.slow

RUNNING, BACKOFF = ChildState.RUNNING, ChildState.BACKOFF
FAILED, STOPPED = ChildState.FAILED, ChildState.STOPPED
AFTER_S = 0.2


@pytest.fixture(autouse=True)
def soon_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervised_child, "UNKILLABLE_AFTER_S", AFTER_S)


@pytest.fixture
def sigkill_is_lost(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Let the supervisor's SIGKILL have no effect until the returned function is called."""
    monkeypatch.setattr(ChildProcess, "kill", lambda self: None)
    return monkeypatch.undo


def on(disk: LoopDisk, behaviour: Callable[[zoo.Animal], None], restart: RestartPolicy = QUICK) -> ChildSpec:
    spec = animal(behaviour, "stuck", restart=restart)
    return dataclasses.replace(spec, environment={**spec.environment, "DISK": str(disk.folder)})


def sleeps_in_kernel(pid: int) -> bool:
    stat = read_stat(pid)
    return stat is not None and stat.state == "D"


def hung(run: Run) -> bool:
    return run.states("stuck")[-1] is FAILED


def test_process_on_a_frozen_disk_is_reclaimed_and_restarted_when_the_disk_is_back(
    tmp_path: Path, disk: LoopDisk
) -> None:
    run = Run(tmp_path, on(disk, zoo.writes_to_disk), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        disk.freeze()
        pid = run.incarnations.pids["stuck", 1]
        yield lambda: sleeps_in_kernel(pid)
        run.tree.child("stuck").kill("test")
        yield lambda: hung(run)
        reason = run.last("stuck").reason
        assert reason.startswith(f"test; but process {pid}, killed 0 s ago, hangs in the kernel")
        assert ("died", "stuck", 1) not in run.incarnations.calls, "its memory is still in use"
        with pytest.raises(CannotControl, match="started as soon as that process has ended"):
            run.tree.restart_child("stuck", "restarted by command")
        turns = run.turns
        yield lambda: run.turns > turns + 10
        assert run.is_running("works")
        disk.thaw()
        yield lambda: run.states("stuck").count(RUNNING) == 2
        assert ("died", "stuck", 1) in run.incarnations.calls
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_forks_of_a_dead_child_on_a_frozen_disk_are_waited_for(tmp_path: Path, disk: LoopDisk) -> None:
    run = Run(tmp_path, on(disk, zoo.forks_writer_and_fails), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        disk.freeze()
        (writer,) = run.incarnations.forked("stuck")
        yield lambda: sleeps_in_kernel(writer)
        (run.incarnations.folder / "end").touch()
        yield lambda: hung(run)
        assert f"exit code 3; but process {writer}, killed" in run.last("stuck").reason
        (run.incarnations.folder / "end").unlink()
        disk.thaw()
        yield lambda: run.states("stuck").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_process_that_ends_long_after_sigkill_is_restarted(
    tmp_path: Path, sigkill_is_lost: Callable[[], None]
) -> None:
    run = Run(tmp_path, animal(zoo.ignores_sigterm, "stuck"))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.child("stuck").kill("test")
        yield lambda: hung(run)
        sigkill_is_lost()
        os.kill(run.incarnations.pids["stuck", 1], signal.SIGKILL)
        yield lambda: run.states("stuck").count(RUNNING) == 2
        run.tree.kill_all("seen enough")

    assert run.play(scenario()) == 1
    after = [change.new for change in run.incarnations.changes if change.incarnation == 1]
    assert after[-2:] == [FAILED, BACKOFF]
    back = next(change for change in run.incarnations.changes if change.new is BACKOFF)
    assert back.reason.startswith("test: killed by SIGKILL, after it hung in the kernel for")


@pytest.mark.parametrize("policy", [QUICK, NEVER])
def test_process_that_finally_ends_stays_stopped_if_it_was_stopped(
    tmp_path: Path, sigkill_is_lost: Callable[[], None], policy: RestartPolicy
) -> None:
    run = Run(tmp_path, animal(zoo.ignores_sigterm, "stuck", restart=policy), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.child("stuck").kill("test")
        yield lambda: hung(run)
        with pytest.raises(CannotControl, match="stays stopped"):
            run.tree.stop_child("stuck", "stopped by command")
        sigkill_is_lost()
        os.kill(run.incarnations.pids["stuck", 1], signal.SIGKILL)
        yield lambda: run.last("stuck").new is STOPPED
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


@pytest.mark.parametrize("behaviour", [zoo.works, zoo.works_beside_a_thread])
def test_killed_process_that_a_debugger_holds_counts_as_ended(
    tmp_path: Path, behaviour: Callable[[zoo.Animal], None]
) -> None:
    """With a thread, not even its pidfd tells its end; without one, that told it again and again."""
    run = Run(tmp_path, animal(behaviour, "held"))

    def scenario() -> Scenario:
        yield run.all_running
        with held_by_debugger(run.incarnations.pids["held", 1]):
            run.tree.child("held").kill("test")
            yield lambda: run.states("held").count(RUNNING) == 2
        assert FAILED not in run.states("held")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_run_ends_without_a_process_that_cannot_be_killed(tmp_path: Path, disk: LoopDisk) -> None:
    run = Run(tmp_path, on(disk, zoo.writes_to_disk))

    def scenario() -> Scenario:
        yield run.all_running
        disk.freeze()
        yield lambda: sleeps_in_kernel(run.incarnations.pids["stuck", 1])
        run.tree.kill_all("seen enough")

    assert run.play(scenario()) == 1
    pid = run.incarnations.pids["stuck", 1]
    assert sleeps_in_kernel(pid)
    disk.thaw()
    os.waitpid(pid, 0)  # it is still ours, as it would be of init if we had ended


def test_loop_does_not_wait_for_forks_of_a_dead_child(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leftovers, "_kill", lambda process: os.pidfd_open(process.pid))  # it dies slowly
    monkeypatch.setattr(supervised_child, "UNKILLABLE_AFTER_S", 60.0)
    run = Run(tmp_path, animal(zoo.forks, "parent", restart=NEVER), animal(zoo.works))
    turned_s = [time.monotonic()]
    run.each_turn = lambda: turned_s.append(time.monotonic())

    def scenario() -> Scenario:
        yield run.all_running
        turned_s.clear()
        os.kill(run.incarnations.pids["parent", 1], signal.SIGKILL)
        yield lambda: len(turned_s) > 10
        longest_s = max(after - before for before, after in itertools.pairwise(turned_s))
        assert longest_s < leftovers.END_WAIT_S / 2
        assert run.is_running("parent"), "it ended before what it forked"
        for pid in run.incarnations.forked("parent"):
            os.kill(pid, signal.SIGKILL)
        yield lambda: run.last("parent").new is FAILED
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
