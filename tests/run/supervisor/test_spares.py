"""Restarts take a spare interpreter if there is one, and do without it if there is none."""

import os
import signal
import sys
from pathlib import Path

import pytest

from robbie_mp.run.supervisor import spares
from robbie_mp.run.supervisor.spares import SpareCommand
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.trace.kinds import Kind
from tests._support.places import PROJECT
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import Run, Scenario, animal, is_gone, wait_for

RUNNING, FAILED = ChildState.RUNNING, ChildState.FAILED


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spares, "CALM_S", 0.01)


def command(folder: Path, behaviour: str, count: int = 1) -> SpareCommand:
    argv = (sys.executable, "-S", zoo.__file__, behaviour, str(folder / "ready"), str(os.getpid()))
    return SpareCommand(count, argv, {"PYTHONPATH": str(PROJECT)})


def with_spares(folder: Path, behaviour: str, count: int = 1) -> Run:
    return Run(folder, animal(zoo.works, "child", may_be_warm=True), spares=command(folder, behaviour, count))


def ready_spares(run: Run) -> list[int]:
    """Pids of the spares that wait to be needed."""
    return [spare.process.pid for spare in run.tree._spares._spares if spare.is_ready]


def kill(run: Run) -> None:
    pid = run.tree.child("child").pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)


def test_restarted_child_uses_the_spare_and_a_new_spare_is_started(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:works")

    def scenario() -> Scenario:
        for start in (2, 3):
            yield lambda: bool(ready_spares(run))
            [spare] = ready_spares(run)
            kill(run)
            yield lambda start=start: run.states("child").count(RUNNING) == start  # type: ignore[misc]
            assert run.incarnations.pids["child", start] == spare
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_first_start_does_not_wait_for_a_spare(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:works")

    def scenario() -> Scenario:
        yield run.all_running
        assert run.tree._spares.pids == set(), "spares take a processor from those that start"
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_no_spare_outlives_the_run(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:works", count=2)
    pids: list[int] = []

    def scenario() -> Scenario:
        yield lambda: len(ready_spares(run)) == 2
        pids.extend(ready_spares(run))
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert all(map(is_gone, pids))


def test_spare_takes_over_output_and_input_of_the_child_it_becomes(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:prints_its_input")

    def scenario() -> Scenario:
        yield lambda: bool(ready_spares(run))
        kill(run)
        yield lambda: run.text("child", "stdout") == ["input: ''"]
        yield lambda: run.is_running("child")  # it prints before it can be told to stop
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_forks_of_a_child_that_was_a_spare_end_with_it(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:forks")

    def scenario() -> Scenario:
        yield lambda: bool(ready_spares(run))
        kill(run)
        yield lambda: run.states("child").count(RUNNING) == 2
        forked = run.incarnations.forked("child", 2)
        kill(run)
        yield lambda: run.states("child").count(RUNNING) == 3
        assert all(map(is_gone, forked))
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_killed_spare_is_replaced_and_never_used(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:works")

    def scenario() -> Scenario:
        yield lambda: bool(ready_spares(run))
        [spare] = ready_spares(run)
        os.kill(spare, signal.SIGKILL)
        yield lambda: bool(ready_spares(run)) and ready_spares(run) != [spare]
        assert is_gone(spare)
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.states("child").count(RUNNING) == 1


def test_child_whose_spare_is_dead_starts_normally(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "spare:works")

    def scenario() -> Scenario:
        yield lambda: bool(ready_spares(run))
        [spare] = ready_spares(run)
        os.kill(spare, signal.SIGKILL)
        kill(run)
        wait_for(lambda: is_gone(spare))
        yield lambda: run.states("child").count(RUNNING) == 2
        assert run.incarnations.pids["child", 2] != spare
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_spare_that_is_not_warm_yet_is_not_used(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "is_never_ready")

    def scenario() -> Scenario:
        yield lambda: bool(run.tree._spares.pids)
        kill(run)
        yield lambda: run.states("child").count(RUNNING) == 2
        assert run.tree.child("child").incarnation == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_spares_that_always_fail_are_given_up_with_a_warning(tmp_path: Path) -> None:
    run = with_spares(tmp_path, "broken_spare")

    def scenario() -> Scenario:
        yield lambda: any("no more spares" in text for text in run.text("supervisor", "supervisor"))
        kill(run)
        yield lambda: run.states("child").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.text("supervisor", "stderr").count("ImportError: no numpy here") == 3
    said = [line.text for line in run.lines if line.module == "supervisor" and line.kind is Kind.WARNING]
    assert said[-1].startswith("a spare interpreter has ended: exit code 1; no more spares are started")


def test_child_with_a_different_command_uses_no_spare(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "child"), spares=command(tmp_path, "spare:works"))

    def scenario() -> Scenario:
        yield lambda: bool(ready_spares(run))
        [spare] = ready_spares(run)
        kill(run)
        yield lambda: run.states("child").count(RUNNING) == 2
        assert run.incarnations.pids["child", 2] != spare
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
