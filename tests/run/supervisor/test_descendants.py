"""The forks of a child end with it, and no other processes are affected."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from robbie_mp.base.linux.prctl import is_child_subreaper
from robbie_mp.run.supervisor.leftovers import OrphanReaper, kill_run_leftovers
from robbie_mp.run.supervisor.states import ChildState
from tests._support.few_descriptors import only_free_descriptors
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import Run, Scenario, animal, is_gone, wait_for


def test_forked_processes_and_daemons_end_with_their_child(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.forks, "parent"), animal(zoo.forks, "other"))

    def scenario() -> Scenario:
        yield run.all_running
        mine, others = run.incarnations.forked("parent"), run.incarnations.forked("other")
        os.kill(run.incarnations.pids["parent", 1], signal.SIGKILL)
        yield lambda: all(map(is_gone, mine))
        assert not any(map(is_gone, others)), "a living child lost what it forked"
        yield lambda: run.states("parent").count(ChildState.RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    everyone = [*run.incarnations.forked("other"), *run.incarnations.forked("parent", 2)]
    assert all(map(is_gone, everyone))


def test_orphan_that_ends_is_reaped_while_the_run_continues(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.forks))

    def scenario() -> Scenario:
        yield run.all_running
        _, daemon = run.incarnations.forked("forks")
        os.kill(daemon, signal.SIGKILL)
        yield lambda: not Path(f"/proc/{daemon}").exists()
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_earlier_children_are_left_alone(tmp_path: Path) -> None:
    mine = subprocess.Popen(
        [sys.executable, "-S", "-E", "-c", "import sys; sys.exit(len(sys.stdin.read()))"], stdin=-1
    )
    try:
        run = Run(tmp_path, animal(zoo.ends_when_ready))
        assert run.play() == 0
        assert mine.poll() is None
    finally:
        mine.communicate(b"123")
    assert mine.returncode == 3


def test_orphans_are_adopted_only_during_the_run() -> None:
    assert not is_child_subreaper()
    with OrphanReaper():
        assert is_child_subreaper()
    assert not is_child_subreaper()


def test_reaper_takes_no_exit_status_of_a_known_child() -> None:
    with OrphanReaper() as orphans:
        child = subprocess.Popen([sys.executable, "-S", "-E", "-c", "raise SystemExit(7)"])
        wait_for(lambda: is_gone(child.pid))
        orphans.reap({child.pid})
        assert child.wait() == 7


def test_marked_processes_of_another_run_are_not_killed() -> None:
    ours = subprocess.Popen(["sleep", "60"], env={"ROBBIE_CHILD": "aaaa0001/m/1", "PATH": os.environ["PATH"]})
    others = subprocess.Popen(
        ["sleep", "60"], env={"ROBBIE_CHILD": "aaaa00012/m/1", "PATH": os.environ["PATH"]}
    )
    try:
        assert kill_run_leftovers("aaaa0001") == {ours.pid}
        assert ours.wait() == -signal.SIGKILL
        assert others.poll() is None
    finally:
        others.kill()
        others.wait()
        ours.wait()


def test_child_that_ends_without_free_descriptors_is_restarted_and_its_forks_end(
    tmp_path: Path,
) -> None:
    """The streams of the dead child are given back first: the search for what it forked needs descriptors."""
    run = Run(tmp_path, animal(zoo.forks, "parent"))

    def scenario() -> Scenario:
        yield run.all_running
        mine = run.incarnations.forked("parent")
        with only_free_descriptors(0):
            os.kill(run.incarnations.pids["parent", 1], signal.SIGKILL)
            yield lambda: ChildState.BACKOFF in run.states("parent")
        assert all(map(is_gone, mine))
        yield lambda: run.states("parent").count(ChildState.RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
