"""The treatment of a hanging child, and of one that only seems to hang."""

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.bus.transport.layout import Activity
from robbie_mp.run.profile.model import RestartPolicy
from robbie_mp.run.supervisor import supervised_child
from robbie_mp.run.supervisor.incarnations import Doing
from robbie_mp.run.supervisor.states import ChildState
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal

RUNNING, BACKOFF, FAILED = ChildState.RUNNING, ChildState.BACKOFF, ChildState.FAILED
IN_HANDLER = Doing(Activity.HANDLER, 3, 1000)
IN_TICK = Doing(Activity.TICK, 0, 1000)
IN_TEARDOWN = Doing(Activity.TEARDOWN, 0, 1000)
RIVALS = 5
DEADLINE_S = 0.9


def test_hung_child_dumps_its_stacks_and_is_restarted(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.hangs, handler_deadline_s=0.05))
    run.incarnations.busy["hangs"] = IN_HANDLER

    def scenario() -> Scenario:
        yield lambda: BACKOFF in run.states("hangs")
        del run.incarnations.busy["hangs"]
        yield lambda: run.states("hangs").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    change = next(change for change in run.incarnations.changes if change.new is BACKOFF)
    assert change.reason.startswith("hung in handler 3 for 0.")
    assert change.reason.endswith(" s: killed by SIGABRT")
    assert any("wait_for_a_device_that_is_not_there" in line for line in change.last_lines)


@pytest.mark.parametrize("behaviour", [zoo.ignores_everything, zoo.stops_itself])
def test_hung_child_that_dumps_nothing_is_killed_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, behaviour: object
) -> None:
    monkeypatch.setattr(supervised_child, "DUMP_S", 0.05)
    run = Run(tmp_path, animal(behaviour, "mute", handler_deadline_s=0.05, restart=NEVER))  # type: ignore[arg-type]
    run.incarnations.busy["mute"] = IN_HANDLER
    assert run.play() == 1
    assert run.last("mute").reason.startswith("hung in handler 3 for 0.")
    assert "s: killed by SIGKILL" in run.last("mute").reason


def test_child_without_work_that_a_signal_has_stopped_is_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervised_child, "DUMP_S", 0.05)
    run = Run(tmp_path, animal(zoo.stops_itself, "idle", handler_deadline_s=0.05, restart=NEVER))
    assert run.play() == 1
    assert run.last("idle").reason.startswith("stopped by a signal such as SIGSTOP for 0.")


def test_hung_child_is_restarted_even_long_after_its_dump(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervised_child, "DUMP_S", 0.0)
    slow = RestartPolicy(backoff_s=0.1)
    run = Run(tmp_path, animal(zoo.hangs, handler_deadline_s=0.02, restart=slow))
    run.incarnations.busy["hangs"] = IN_HANDLER

    def scenario() -> Scenario:
        yield lambda: BACKOFF in run.states("hangs")
        del run.incarnations.busy["hangs"]
        yield lambda: run.states("hangs").count(RUNNING) == 2
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_hangs_use_up_the_restart_budget(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.hangs, handler_deadline_s=0.02))
    run.incarnations.busy["hangs"] = IN_HANDLER
    assert run.play() == 1
    assert run.states("hangs").count(BACKOFF) == 2
    assert run.last("hangs").new is FAILED


@pytest.mark.parametrize("doing", [IN_HANDLER, IN_TEARDOWN])
def test_only_the_grace_limits_an_ordered_stop(tmp_path: Path, doing: Doing) -> None:
    """A large map may take longer to write than any message to handle."""
    run = Run(tmp_path, animal(zoo.ignores_sigterm, handler_deadline_s=0.05, stop_grace_s=0.4))

    def scenario() -> Scenario:
        yield run.all_running
        run.tree.stop("test")
        run.incarnations.busy["ignores_sigterm"] = doing

    assert run.play(scenario()) == 1
    assert run.last("ignores_sigterm").reason.startswith("did not stop within 0.4 s")


def test_pause_of_the_whole_machine_causes_no_time_out(tmp_path: Path) -> None:
    paused_s = 0.0
    run = Run(
        tmp_path,
        animal(zoo.works, "busy", handler_deadline_s=60.0),
        animal(zoo.is_never_ready, "slow", start_deadline_s=60.0),
        clock=lambda: time.monotonic() + paused_s,
    )
    run.incarnations.busy["busy"] = IN_HANDLER

    def scenario() -> Scenario:
        nonlocal paused_s
        yield lambda: run.is_running("busy")
        turns = run.turns
        yield lambda: run.turns > turns + 3
        paused_s = 3600.0
        yield lambda: run.turns > turns + 10
        assert run.is_running("busy")
        assert run.states("slow") == [ChildState.STARTING]
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_signal_of_the_watchdog_reaches_only_the_hung_child(tmp_path: Path) -> None:
    run = Run(tmp_path, animal(zoo.works, "good", handler_deadline_s=0.05), animal(zoo.hangs, restart=NEVER))

    def scenario() -> Scenario:
        yield run.all_running
        os.kill(run.incarnations.pids["hangs", 1], signal.SIGABRT)
        yield lambda: run.last("hangs").new is FAILED
        assert run.is_running("good")
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 1
    assert run.last("hangs").reason.startswith("killed by SIGABRT")


@contextlib.contextmanager
def rivals_for_one_processor() -> Iterator[int]:
    """Keep one processor busy, each rival in a session of its own so that each has a share of its own."""
    processor = min(os.sched_getaffinity(0))
    script = f"import os; os.sched_setaffinity(0, [{processor}]); print(flush=True)\nwhile True: pass"
    command = [sys.executable, "-S", "-c", script]
    with contextlib.ExitStack() as ends:
        started = []
        for _ in range(RIVALS):
            process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.PIPE)
            started.append(ends.enter_context(process))
            ends.callback(process.kill)
        for process in started:
            assert process.stdout
            process.stdout.readline()
        yield processor


def test_starved_child_does_not_count_as_hung(tmp_path: Path) -> None:
    """It uses 0.3 s of a processor that it shares with five others, and its deadline passes meanwhile."""
    spec = animal(zoo.computes, "busy", handler_deadline_s=DEADLINE_S, restart=NEVER)
    with rivals_for_one_processor() as processor:
        environment = {**spec.environment, "PROCESSOR": str(processor)}
        run = Run(tmp_path, dataclasses.replace(spec, environment=environment))
        run.incarnations.busy["busy"] = IN_TICK
        took_s = time.monotonic()

        def scenario() -> Scenario:
            nonlocal took_s
            yield run.all_running
            took_s = time.monotonic()
            yield (run.incarnations.folder / "busy.1.done").exists
            took_s = time.monotonic() - took_s
            del run.incarnations.busy["busy"]
            run.tree.stop("seen enough")

        assert run.play(scenario()) == 0
    assert took_s > DEADLINE_S, "it was not starved; this says nothing"
    assert run.states("busy") == [ChildState.STARTING, ChildState.RUNNING, ChildState.STOPPED]


def test_sleeping_child_counts_as_hung_even_on_a_busy_processor(tmp_path: Path) -> None:
    with rivals_for_one_processor():
        run = Run(tmp_path, animal(zoo.works, "idle", handler_deadline_s=0.3, restart=NEVER))
        run.incarnations.busy["idle"] = IN_TICK
        assert run.play() == 1
    assert run.last("idle").reason.startswith("hung in tick")
