"""Each misbehaving child is treated correctly, and the run ends with the right exit code."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.run.profile.model import ModuleSpec, RestartPolicy
from robbie_mp.run.supervisor import supervised_child
from robbie_mp.run.supervisor.child_spec import ChildSpec, InvalidChild
from robbie_mp.run.supervisor.process import ChildProcess
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.supervised_child import BY_ITSELF
from robbie_mp.run.supervisor.tree import ECHO_S
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import ALWAYS, NEVER, Run, Scenario, animal, core

STARTING, RUNNING, BACKOFF = ChildState.STARTING, ChildState.RUNNING, ChildState.BACKOFF
FAILED, STOPPED = ChildState.FAILED, ChildState.STOPPED


def stop_when_all_run(run: Run, signum: int = signal.SIGINT) -> Scenario:
    yield run.all_running
    os.kill(os.getpid(), signum)


def stop_when(run: Run, condition: Callable[[], bool]) -> Scenario:
    yield condition
    run.tree.stop("seen enough")


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_stop_signal_stops_in_reverse_order_and_the_core_last(tmp_path: Path, signum: int) -> None:
    run = Run(tmp_path, animal(zoo.works, "first"), animal(zoo.works, "second"), core())
    assert run.play(stop_when_all_run(run, signum)) == 0
    ends = [change.name for change in run.incarnations.changes if change.new is STOPPED]
    assert ends == ["second", "first", "core"]
    assert run.states("first") == [STARTING, RUNNING, STOPPED]
    assert run.incarnations.closed == 1
    assert run.tree.stop_reason == signal.Signals(signum).name


def test_each_child_is_stopped_only_after_the_previous_one_has_ended(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "first"), animal(zoo.works, "second"))
    assert run.play(stop_when_all_run(run)) == 0
    calls = [call for call in run.incarnations.calls if call[0] in ("wake", "died")]
    assert calls == [("wake", "second", 1), ("died", "second", 1), ("wake", "first", 1), ("died", "first", 1)]


def test_modules_start_only_when_the_core_is_ready(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "module"), core())
    assert run.play(stop_when_all_run(run)) == 0
    steps = [(change.name, change.new) for change in run.incarnations.changes]
    assert steps.index(("core", RUNNING)) < steps.index(("module", STARTING))


def test_modules_start_without_waiting_for_each_other(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.is_never_ready, "slow"), animal(zoo.works, "quick"))

    def scenario() -> Scenario:
        yield lambda: run.is_running("quick")
        assert run.states("slow") == [STARTING]
        assert run.incarnations.times_all_started == 0
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0, "slow was still in its first start"
    assert run.tree.stop_reason == "seen enough"


def test_child_that_fails_is_restarted_until_its_budget_is_used_up(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_at_once, "laser"))
    assert run.play() == 1
    assert run.states("laser") == [STARTING, BACKOFF, STARTING, BACKOFF, STARTING, FAILED]
    end = run.last("laser")
    assert end.reason == "exit code 1; all 2 restarts within 60 s are used up"
    assert end.last_lines[-1] == "RuntimeError: no such device: /dev/laser"
    assert end.last_lines[0] == "Traceback (most recent call last):"
    assert end.last_lines.count(end.last_lines[0]) == 1, "lines of an earlier start"
    assert run.tree.stop_reason == "all modules have ended"


def test_run_continues_after_a_module_that_is_not_essential_failed(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_at_once, restart=NEVER), animal(zoo.works))

    def scenario() -> Scenario:
        yield lambda: run.states("fails_at_once") == [STARTING, FAILED] and run.is_running("works")
        os.kill(os.getpid(), signal.SIGTERM)

    assert run.play(scenario()) == 1
    assert run.states("works") == [STARTING, RUNNING, STOPPED]


def test_essential_module_that_failed_stops_the_run(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works), animal(zoo.fails_when_ready, restart=NEVER, essential=True))
    assert run.play() == 1
    assert run.tree.stop_reason.startswith("fails_when_ready is FAILED: exit code 3")
    assert run.last("works").new is STOPPED


def test_core_that_died_stops_the_run(tmp_path: Path) -> None:
    run = Run(tmp_path, core(zoo.crashes), animal(zoo.works))
    assert run.play() == 1
    assert run.tree.stop_reason.startswith("core is FAILED: killed by SIGSEGV")


def test_core_that_cannot_start_leaves_the_modules_unstarted(tmp_path: Path) -> None:
    run = Run(tmp_path, core(zoo.fails_at_once), animal(zoo.works))
    assert run.play() == 1
    assert run.states("works") == [STOPPED]
    assert run.last("works").incarnation == 0


def test_module_that_ends_the_run_ends_it_cleanly(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "playback", ends_run=True), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        os.kill(run.incarnations.pids["playback", 1], signal.SIGTERM)  # it ends with 0
        yield lambda: run.states("playback")[-1] is STOPPED

    assert run.play(scenario()) == 0
    assert run.tree.stop_reason == "playback ended the run"


def test_module_that_should_end_the_run_but_failed_ends_it_with_1(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_when_ready, ends_run=True), animal(zoo.works))
    assert run.play() == 1
    assert run.states("fails_when_ready").count(STARTING) == 3


def test_run_ends_when_all_modules_have_ended_with_success(tmp_path: Path) -> None:
    run = Run(tmp_path, core(), animal(zoo.ends_when_ready, "one"), animal(zoo.ends_when_ready, "two"))
    assert run.play() == 0
    assert run.last("one").reason == f"exit code 0: {BY_ITSELF}"
    assert run.last("core").new is STOPPED


def test_exit_before_ready_is_a_failure_even_with_code_0(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.ends_at_once, restart=NEVER))
    assert run.play() == 1
    assert run.last("ends_at_once").reason.startswith("exit code 0 before it was ready")


def test_policy_always_restarts_a_module_that_ended_with_success(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.ends_when_ready, restart=ALWAYS))
    assert run.play() == 1
    assert run.states("ends_when_ready").count(STARTING) == 3


def test_crash_is_reported_with_its_signal(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.crashes, restart=NEVER))
    assert run.play() == 1
    status = run.last("crashes").exit_status
    assert status is not None
    assert (status.signal, status.code) == (signal.SIGSEGV, None)


def test_restart_waits_until_the_dead_incarnation_is_reclaimed(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_once))

    def scenario() -> Scenario:
        yield lambda: run.states("fails_once").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    calls = run.incarnations.calls
    died, reclaimed = calls.index(("died", "fails_once", 1)), calls.index(("reclaimed", "fails_once", 1))
    assert died < reclaimed < calls.index(("open", "fails_once", 2))


def test_command_that_does_not_exist_fails_only_that_child(tmp_path: Path) -> None:
    missing = ChildSpec(ModuleSpec("missing", "", restart=NEVER), ("/no/such/command",), {})
    run = Run(tmp_path, missing, animal(zoo.works))
    assert run.play(stop_when(run, lambda: run.is_running("works"))) == 1
    assert "No such file or directory" in run.last("missing").reason
    assert ("died", "missing", 1) in run.incarnations.calls


def test_child_whose_memory_cannot_be_created_fails_alone(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "poor"), animal(zoo.works, "rich"))
    run.incarnations.refuses.add("poor")
    assert run.play(stop_when(run, lambda: FAILED in run.states("poor") and run.is_running("rich"))) == 1
    assert run.last("poor").reason.startswith("cannot be started: no room")
    assert ("died", "poor", 1) not in run.incarnations.calls


def test_child_that_is_not_ready_in_time_is_killed_and_restarted(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.is_never_ready, start_deadline_s=0.05))
    assert run.play() == 1
    assert run.states("is_never_ready") == [STARTING, BACKOFF, STARTING, BACKOFF, STARTING, FAILED]
    assert run.last("is_never_ready").reason.startswith("not ready within 0.05 s: killed by SIGABRT")


def test_start_deadline_begins_when_the_clocks_source_has_set_the_time(tmp_path: Path) -> None:
    run = Run(
        tmp_path,
        animal(zoo.works, "source"),
        animal(zoo.is_never_ready, start_deadline_s=0.05, restart=NEVER),
    )
    run.incarnations.time_sources.add("source")

    def scenario() -> Scenario:
        yield lambda: run.is_running("source")
        later_s = time.monotonic() + 0.2
        yield lambda: time.monotonic() > later_s
        assert run.states("is_never_ready") == [STARTING]
        run.incarnations.time_sources.clear()
        yield lambda: FAILED in run.states("is_never_ready")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.last("is_never_ready").reason.startswith("not ready within 0.05 s: killed by SIGABRT")


def test_child_that_ignores_sigterm_is_killed_after_its_grace(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works), animal(zoo.ignores_sigterm, stop_grace_s=0.05))
    assert run.play(stop_when_all_run(run)) == 1
    assert run.last("ignores_sigterm").reason == "did not stop within 0.05 s: killed by SIGKILL"
    assert run.last("works").reason == "exit code 0"


def test_child_that_must_be_killed_before_it_is_ready_did_not_end_in_order(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works), animal(zoo.starts_for_ever, "blocks", stop_grace_s=0.05))
    is_deaf = (tmp_path / "ready" / "blocks.1.deaf").exists
    assert run.play(stop_when(run, lambda: run.is_running("works") and is_deaf())) == 1
    assert run.last("blocks").reason == "did not stop within 0.05 s: killed by SIGKILL"
    assert run.tree.stop_reason.endswith("; blocks did not end in order")


def test_second_signal_kills_at_once(tmp_path: Path) -> None:
    slow = [animal(zoo.ignores_sigterm, name, stop_grace_s=60.0) for name in ("a", "b")]
    run = Run(tmp_path, core(), *slow)

    def scenario() -> Scenario:
        yield run.all_running
        os.kill(os.getpid(), signal.SIGINT)
        yield lambda: ("wake", "b", 1) in run.incarnations.calls
        hurry_s = time.monotonic() + ECHO_S
        yield lambda: time.monotonic() > hurry_s
        os.kill(os.getpid(), signal.SIGINT)

    begin_s = time.monotonic()
    assert run.play(scenario()) == 1
    assert time.monotonic() - begin_s < 5.0
    assert [line.split(" ")[0] for line in unfinished(run)] == ["core", "a", "b"]
    assert run.last("core").new is STOPPED
    assert run.last("a").reason == "second signal, SIGINT: killed by SIGKILL"


def test_signal_that_is_sent_twice_at_once_stops_in_order(tmp_path: Path) -> None:
    run = Run(tmp_path, core(), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        os.kill(os.getpid(), signal.SIGTERM)
        yield lambda: bool(run.tree.stop_reason)
        os.kill(os.getpid(), signal.SIGTERM)  # as `timeout` does

    assert run.play(scenario()) == 0
    assert run.last("works").reason == "exit code 0"


def test_first_signal_does_not_kill_a_run_that_stops_already(tmp_path: Path) -> None:
    run = Run(tmp_path, core(), animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("seen enough")
        os.kill(os.getpid(), signal.SIGTERM)
        yield lambda: False

    assert run.play(scenario()) == 0
    assert run.last("works").reason == "exit code 0"


def test_second_sighup_does_not_kill(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.ignores_sigterm, stop_grace_s=0.2))

    def scenario() -> Scenario:
        yield run.all_running
        os.kill(os.getpid(), signal.SIGHUP)
        yield lambda: bool(run.tree.stop_reason)
        os.kill(os.getpid(), signal.SIGHUP)

    assert run.play(scenario()) == 1
    assert run.last("ignores_sigterm").reason.startswith("did not stop within")


def test_stopped_process_is_continued_so_that_it_can_end(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.stops_itself))
    assert run.play(stop_when_all_run(run)) == 0
    assert run.last("stops_itself").reason == "exit code 0"


def unfinished(run: Run) -> list[str]:
    """What the supervisor says of children that did not end in order."""
    return [
        line.text
        for line in run.lines
        if line.module == "supervisor" and "did not end in order:" in line.text
    ]


def test_failure_during_the_stop_is_a_failure_of_the_run(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_in_teardown), animal(zoo.works))
    assert run.play(stop_when_all_run(run)) == 1
    assert run.last("fails_in_teardown").reason == "exit code 4"
    assert run.tree.stop_reason == "SIGINT; fails_in_teardown did not end in order"
    assert unfinished(run) == [
        "fails_in_teardown did not end in order: exit code 4; results that teardown() writes are missing"
    ]


def test_core_and_child_that_are_killed_during_the_stop_are_reported(tmp_path: Path) -> None:
    slow = animal(zoo.ignores_sigterm, "slow", stop_grace_s=60.0)
    run = Run(tmp_path, core(), animal(zoo.works), slow)

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("test")
        yield lambda: ("wake", "slow", 1) in run.incarnations.calls
        for name in ("core", "works", "slow"):
            os.kill(run.incarnations.pids[name, 1], signal.SIGKILL)

    assert run.play(scenario()) == 1
    assert run.tree.stop_reason == "test" + "".join(
        f"; {name} did not end in order" for name in ("core", "works", "slow")
    )
    first, *rest = unfinished(run)
    assert first == (
        "core did not end in order: killed by SIGKILL; messages that were published after that are missing"
    )
    assert all("killed by SIGKILL; results that teardown() writes are missing" in line for line in rest)
    assert any(
        "crashed in its duty: killed by SIGKILL" in line.text for line in run.lines if line.module == "works"
    )


def test_child_that_had_died_right_before_the_stop_is_reported(tmp_path: Path) -> None:
    policy = RestartPolicy(backoff_s=60.0, backoff_cap_s=60.0)
    run = Run(tmp_path, animal(zoo.fails_once, restart=policy), animal(zoo.works))

    def died() -> bool:
        return BACKOFF in run.states("fails_once") and run.is_running("works")

    assert run.play(stop_when(run, died)) == 1
    (said,) = unfinished(run)
    assert "it had ended (exit code 3) and was not started again" in said


def test_nothing_is_restarted_while_stopping(tmp_path: Path) -> None:
    slow = animal(zoo.ignores_sigterm, "slow", stop_grace_s=60.0)
    run = Run(tmp_path, animal(zoo.works), slow)

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("test")
        yield lambda: ("wake", "slow", 1) in run.incarnations.calls
        os.kill(run.incarnations.pids["works", 1], signal.SIGKILL)
        yield lambda: run.tree.child("works").pid is None
        run.tree.kill_all("enough")

    assert run.play(scenario()) == 1
    assert run.states("works") == [STARTING, RUNNING, STOPPED]
    assert run.last("works").reason == "killed by SIGKILL"


def test_stop_ends_a_backoff(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.fails_at_once, restart=RestartPolicy(backoff_s=60.0, backoff_cap_s=60.0)))
    assert run.play(stop_when(run, lambda: BACKOFF in run.states("fails_at_once"))) == 1
    assert run.states("fails_at_once") == [STARTING, BACKOFF, STOPPED]


def test_all_started_is_announced_once_after_every_module_ran_or_failed(tmp_path: Path) -> None:
    run = Run(tmp_path, core(), animal(zoo.fails_once), animal(zoo.works), animal(zoo.fails_at_once))

    def scenario() -> Scenario:
        yield lambda: run.states("fails_once").count(RUNNING) == 2 and FAILED in run.states("fails_at_once")
        yield lambda: run.is_running("works")
        yield lambda: True
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.incarnations.times_all_started == 1


def test_watchdog_can_kill_a_child_and_it_is_restarted(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.child("works").kill("its handler hangs")
        yield lambda: run.states("works").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    reasons = [change.reason for change in run.incarnations.changes if change.new is BACKOFF]
    assert reasons == ["its handler hangs: killed by SIGKILL"]


def test_step_of_the_wall_clock_is_said(tmp_path: Path) -> None:
    step_s = 0.0
    run = Run(
        tmp_path, animal(zoo.works, "a"), animal(zoo.works, "b"), wall_clock=lambda: time.time() + step_s
    )

    def said() -> bool:
        return any("the wall clock was set by -3600" in line.text for line in run.lines)

    def scenario() -> Scenario:
        nonlocal step_s
        yield run.all_running
        assert not said()
        step_s = -3600.0
        yield said
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_process_that_sigkill_does_not_end_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ChildProcess, "kill", lambda self: None)
    monkeypatch.setattr(supervised_child, "UNKILLABLE_AFTER_S", 0.05)
    run = Run(tmp_path, animal(zoo.ignores_sigterm, stop_grace_s=0.01))
    assert run.play(stop_when_all_run(run)) == 1
    assert run.last("ignores_sigterm").reason.endswith("as on a disk that has stalled or in a broken driver")
    assert ("died", "ignores_sigterm", 1) not in run.incarnations.calls


def test_error_in_the_loop_leaves_no_child_and_closes_the_memory(tmp_path: Path) -> None:
    run = Run(tmp_path, core(), animal(zoo.ignores_sigterm, stop_grace_s=60.0))

    def scenario() -> Scenario:
        yield run.all_running
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run.play(scenario())
    assert run.incarnations.closed == 1
    assert all(child.pid is None for child in run.tree.children)


def test_two_children_with_the_same_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidChild, match="needs a unique name"):
        Run(tmp_path, animal(zoo.works, "a"), animal(zoo.works, "a"))


def test_name_that_points_outside_the_log_folder_is_refused() -> None:
    with pytest.raises(InvalidChild, match="letters, digits"):
        animal(zoo.works, "../a")


def test_idle_tree_uses_almost_no_processor_time(tmp_path: Path) -> None:
    run = Run(tmp_path, *(animal(zoo.works, f"module{number}") for number in range(5)))
    spent: list[float] = []

    def scenario() -> Scenario:
        yield run.all_running
        begin_s, begin_cpu_s, begin_turns = time.monotonic(), time.thread_time(), run.turns
        yield lambda: time.monotonic() - begin_s >= 1.0
        spent.extend([(time.thread_time() - begin_cpu_s), run.turns - begin_turns])
        run.tree.stop("measured")

    assert run.play(scenario()) == 0
    cpu_s, turns = spent
    assert turns <= 15
    assert cpu_s < 0.02  # the bound is 0.003; this machine may be a slow one


def test_start_that_takes_too_long_while_the_run_stops_is_no_crash(tmp_path: Path) -> None:
    spec = animal(zoo.starts_for_ever, "slow", start_deadline_s=1.0, stop_grace_s=60.0, restart=NEVER)
    run = Run(tmp_path, spec)

    def scenario() -> Scenario:
        yield (run.incarnations.folder / "slow.1.deaf").exists
        run.tree.stop("seen enough")

    run.play(scenario())
    assert run.last("slow").reason == "not ready within 1 s: killed by SIGKILL"
