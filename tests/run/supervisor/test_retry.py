"""A module that is FAILED because its device is away is retried slowly, and is shown as FAILED."""

import dataclasses
from pathlib import Path

import pytest

from robbie_mp.run.profile.model import RestartPolicy
from robbie_mp.run.supervisor.child_spec import ChildSpec
from robbie_mp.run.supervisor.states import ChildState
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import QUICK, Run, Scenario, animal

STARTING, RUNNING, BACKOFF = ChildState.STARTING, ChildState.RUNNING, ChildState.BACKOFF
FAILED, STOPPED = ChildState.FAILED, ChildState.STOPPED
RETRIED = dataclasses.replace(QUICK, max_restarts=0, retry_s=0.05)


def laser(restart: RestartPolicy = RETRIED, **fields: object) -> ChildSpec:
    return animal(zoo.needs_device, "laser", restart=restart, **fields)


def plug_in(run: Run) -> None:
    (run.incarnations.folder / "device").touch()


def test_module_is_retried_until_its_device_is_back(tmp_path: Path) -> None:
    run = Run(tmp_path, laser(), animal(zoo.works))

    def scenario() -> Scenario:
        yield lambda: run.states("laser").count(FAILED) == 3
        assert run.last("laser").restart_in_s is not None
        plug_in(run)
        yield lambda: run.is_running("laser")
        assert run.states("laser") == [
            STARTING,
            FAILED,
            STARTING,
            FAILED,
            STARTING,
            FAILED,
            STARTING,
            RUNNING,
        ]
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.tree.child("laser").restarts == 3


def test_run_continues_while_a_module_is_retried(tmp_path: Path) -> None:
    run = Run(tmp_path, laser())

    def scenario() -> Scenario:
        yield lambda: run.states("laser").count(FAILED) == 3
        plug_in(run)
        yield run.all_running
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_nothing_is_retried_while_the_run_stops(tmp_path: Path) -> None:
    run = Run(tmp_path, laser(), animal(zoo.works))

    def scenario() -> Scenario:
        yield lambda: run.last("laser").new is FAILED
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.last("laser").new is FAILED


@pytest.mark.parametrize("needed", ["essential", "ends_run"])
def test_failed_essential_module_stops_the_run_at_once(tmp_path: Path, needed: str) -> None:
    run = Run(
        tmp_path, laser(essential=needed == "essential", ends_run=needed == "ends_run"), animal(zoo.works)
    )
    assert run.play() == 1
    assert run.states("laser") == [STARTING, FAILED]
    assert run.last("laser").restart_in_s is None


def test_module_that_is_never_restarted_is_not_retried(tmp_path: Path) -> None:
    run = Run(tmp_path, laser(dataclasses.replace(RETRIED, retry_s=0.0)))
    assert run.play() == 1
    assert run.states("laser") == [STARTING, FAILED]


def test_module_that_waits_for_a_retry_can_be_stopped_and_started(tmp_path: Path) -> None:
    run = Run(tmp_path, laser(dataclasses.replace(RETRIED, retry_s=3600.0)), animal(zoo.works))

    def scenario() -> Scenario:
        yield lambda: run.last("laser").new is FAILED
        run.tree.stop_child("laser", "stopped by command")
        assert run.last("laser").new is STOPPED
        plug_in(run)
        run.tree.start_child("laser", "started by command")
        yield run.all_running
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_dependents_are_restarted_with_a_module_that_is_back_and_not_with_each_try(tmp_path: Path) -> None:
    run = Run(tmp_path, laser(), animal(zoo.works, "mapping", depends_on=("laser",)))

    def scenario() -> Scenario:
        yield lambda: run.states("laser").count(FAILED) >= 3 and run.is_running("mapping")
        assert run.tree.child("mapping").incarnation == 1
        plug_in(run)
        yield lambda: run.all_running() and run.tree.child("mapping").incarnation == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
