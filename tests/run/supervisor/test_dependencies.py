"""Which modules are restarted together."""

import os
import signal
import time
from pathlib import Path

from robbie_mp.run.profile.model import RestartPolicy
from robbie_mp.run.supervisor.states import ChildState
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal

STARTING, RUNNING, BACKOFF = ChildState.STARTING, ChildState.RUNNING, ChildState.BACKOFF
FAILED, STOPPED = ChildState.FAILED, ChildState.STOPPED
NO_RESTARTS = RestartPolicy(max_restarts=0)


def chain(run_folder: Path) -> Run:
    """Map depends on pose, plan on map; the log on nobody. Only pose has restarts to spend."""
    return Run(
        run_folder,
        animal(zoo.works, "pose"),
        animal(zoo.works, "map", depends_on=("pose",), restart=NO_RESTARTS),
        animal(zoo.works, "plan", depends_on=("map",), restart=NO_RESTARTS),
        animal(zoo.works, "log", restart=NO_RESTARTS),
    )


def kill(run: Run, name: str) -> None:
    pid = run.tree.child(name).pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)


def test_dependents_are_stopped_in_order_and_started_when_the_module_runs(tmp_path: Path) -> None:
    run = chain(tmp_path)

    def scenario() -> Scenario:
        yield run.all_running
        kill(run, "pose")
        yield lambda: run.states("plan").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    steps = [(change.name, change.new) for change in run.incarnations.changes if change.incarnation > 1]
    for earlier, later in [("pose", "map"), ("map", "plan")]:
        assert steps.index((earlier, RUNNING)) < steps.index((later, STARTING))
    waits = [change for change in run.incarnations.changes if change.new is BACKOFF]
    assert [change.name for change in waits] == ["pose", "plan", "map"]
    assert waits[1].reason == waits[2].reason == "restarted with pose: exit code 0"
    assert run.states("log") == [STARTING, RUNNING, STOPPED]


def test_restart_in_the_middle_of_a_chain_restarts_only_the_dependents(tmp_path: Path) -> None:
    run = chain(tmp_path)

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.restart_child("map", "test")
        yield lambda: run.states("plan").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.states("pose") == [STARTING, RUNNING, STOPPED]


def test_dependent_that_ignores_the_stop_is_killed_after_its_grace(tmp_path: Path) -> None:
    stubborn = animal(
        zoo.ignores_sigterm, "map", depends_on=("pose",), restart=NO_RESTARTS, stop_grace_s=0.05
    )
    run = Run(tmp_path, animal(zoo.works, "pose"), stubborn)

    def scenario() -> Scenario:
        yield run.all_running
        kill(run, "pose")
        yield lambda: run.states("map").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1


def test_ordered_stop_ends_with_the_incarnation_that_it_began_with(tmp_path: Path) -> None:
    """Even if the next one is started before the stop has noticed the end of the last."""
    run = Run(tmp_path, animal(zoo.works, "map", stop_grace_s=0.3))
    run.incarnations.reclaims_at_once = True

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.restart_child("map", "test")
        yield lambda: run.states("map").count(RUNNING) == 2
        since_s = time.monotonic()
        yield lambda: time.monotonic() > since_s + 0.5
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.states("map") == [STARTING, RUNNING, BACKOFF, STARTING, RUNNING, STOPPED]


def test_dependents_are_restarted_each_time(tmp_path: Path) -> None:
    run = chain(tmp_path)

    def scenario() -> Scenario:
        yield run.all_running
        for times in (2, 3):
            kill(run, "pose")
            yield lambda times=times: run.states("plan").count(RUNNING) == times  # type: ignore[misc]
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert run.states("plan").count(STARTING) == 3


def test_dependents_continue_without_a_failed_module(tmp_path: Path) -> None:
    run = Run(
        tmp_path,
        animal(zoo.fails_once_running, "pose", restart=RestartPolicy(max_restarts=1, backoff_s=0.001)),
        animal(zoo.works, "map", depends_on=("pose",), restart=NO_RESTARTS),
    )

    def scenario() -> Scenario:
        yield lambda: FAILED in run.states("pose") and run.states("map").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1


def test_dependents_of_a_module_that_is_not_restarted_are_left_alone(tmp_path: Path) -> None:
    run = Run(
        tmp_path,
        animal(zoo.works, "pose", restart=NEVER),
        animal(zoo.works, "map", depends_on=("pose",)),
    )

    def scenario() -> Scenario:
        yield run.all_running
        kill(run, "pose")
        yield lambda: FAILED in run.states("pose")
        assert run.is_running("map")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.states("map") == [STARTING, RUNNING, STOPPED]


def test_end_of_the_run_ends_the_wait_for_a_module(tmp_path: Path) -> None:
    slow = RestartPolicy(backoff_s=60.0, backoff_cap_s=60.0)
    run = Run(
        tmp_path, animal(zoo.works, "pose", restart=slow), animal(zoo.works, "map", depends_on=("pose",))
    )

    def scenario() -> Scenario:
        yield run.all_running
        kill(run, "pose")
        yield lambda: BACKOFF in run.states("map")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.states("map") == [STARTING, RUNNING, BACKOFF, STOPPED]
    assert run.tree.child("pose").unfinished and not run.tree.child("map").unfinished  # it had ended cleanly
