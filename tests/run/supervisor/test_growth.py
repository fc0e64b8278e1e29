"""The resources of a run after many restarts, and after the core has refused the supervisor."""

import dataclasses
import gc
import os
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.model import Profile, RestartPolicy, RestartWhen
from robbie_mp.run.supervisor import run
from robbie_mp.run.supervisor.child_spec import ChildSpec
from robbie_mp.run.supervisor.memory import RunMemory
from robbie_mp.run.supervisor.states import ChildState, StateChange
from tests._support.growth import mappings, open_descriptors
from tests._support.robot import Robot

pytestmark = pytest.mark.slow

MODULES = 3
WARM, MORE = 150, 1500  # so that one object a restart stands out from the 500 that come and go
WINDOW = 30
AT_ONCE = RestartPolicy(
    RestartWhen.ALWAYS, max_restarts=1 << 20, within_s=0.1, backoff_s=0.0, backoff_cap_s=0.0
)
"""The times of the restarts within `within_s` are kept; this shall not be what grows."""
PROFILE = "modules:\n" + "".join(f"  m{number}: {{class: 'zoo.modules:Idle'}}\n" for number in range(MODULES))


def with_restart(spec: ChildSpec, policy: RestartPolicy) -> ChildSpec:
    return dataclasses.replace(spec, module=dataclasses.replace(spec.module, restart=policy))


@pytest.fixture
def quick_run(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> Callable[..., run.RunResult]:
    """Supervises in this process: a true core, and modules that are programs which end at once."""
    robot.write_profile(PROFILE)
    monkeypatch.chdir(robot.folder)
    described = run._children

    def children(profile: Profile, folder: Path, environment: Mapping[str, str]) -> list[ChildSpec]:
        core, *modules = described(profile, folder, environment)
        once = dataclasses.replace(core.module.restart, max_restarts=1, backoff_s=0.0, backoff_cap_s=0.0)
        ends = {"argv": ("/bin/true",), "may_be_warm": False}
        return [
            with_restart(core, once),
            *(with_restart(dataclasses.replace(spec, **ends), AT_ONCE) for spec in modules),  # type: ignore[arg-type]
        ]

    monkeypatch.setattr(run, "_children", children)

    def supervise(
        on_change: Callable[[StateChange], None], on_begin: Callable[[str], None] = lambda _run_id: None
    ) -> run.RunResult:
        listener = run.RunListener(change=on_change, begin=on_begin)
        return run.run_profile(load_profile("robot"), {}, (), robot.output, listener)

    return supervise


class Holdings:
    """The least that supervisor and core were seen to hold; during a start they hold more."""

    def __init__(self) -> None:
        self.least: dict[str, int] = {}

    def look(self, run_id: str, core: int) -> None:
        gc.collect()  # what is only waiting for that is not held
        seen = {
            "blocks": sys.getallocatedblocks(),
            "supervisor's descriptors": open_descriptors(os.getpid()),
            "supervisor's mappings": mappings(os.getpid()),
            "core's descriptors": open_descriptors(core),
            "core's mappings": mappings(core),
            "names in shared memory": len(list(Path(SHARED_MEMORY, f"robbie-{run_id}").iterdir())),
            "files": sum(len(files) for _, _, files in os.walk(Path.cwd().parent)),
        }
        for what, count in seen.items():
            self.least[what] = min(count, self.least.get(what, count))


def test_supervisor_and_core_hold_no_more_after_many_restarts(
    quick_run: Callable[..., run.RunResult],
) -> None:
    early, late = Holdings(), Holdings()
    run_ids: list[str] = []
    restarts = core = 0

    def on_change(change: StateChange) -> None:
        nonlocal restarts, core
        if change.name == "core" and change.new is ChildState.RUNNING:
            (core,) = _children_named("core")
        if change.new is not ChildState.BACKOFF:
            return
        restarts += 1
        if WARM - WINDOW < restarts <= WARM:
            early.look(run_ids[0], core)
        elif MORE - WINDOW < restarts <= MORE:
            late.look(run_ids[0], core)
        elif restarts > MORE:
            os.kill(os.getpid(), signal.SIGINT)

    gc.freeze()  # pytest's own objects need not be looked through each time
    assert quick_run(on_change, run_ids.append).reason.startswith("SIGINT")  # at the end, all are dead
    gc.unfreeze()
    grown = {what: late.least[what] - count for what, count in early.least.items()}
    assert grown.pop("blocks") < (MORE - WARM) / 2, "not even every other restart may leave an object"
    assert max(grown.values()) <= 4 * MODULES, grown  # as many may be starting or ending at a look


def test_core_that_refuses_the_supervisor_is_restarted_and_then_ends_the_run(
    quick_run: Callable[..., run.RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[RunMemory] = []
    begin = RunMemory.__init__

    def remembering(self: RunMemory, *rest: Any) -> None:
        made.append(self)
        begin(self, *rest)

    monkeypatch.setattr(RunMemory, "__init__", remembering)
    changes: list[StateChange] = []

    def on_change(change: StateChange) -> None:
        if change.name == "core" and change.new is ChildState.RUNNING and change.incarnation == 1:
            made[0]._endpoint.send(255)  # type: ignore[arg-type]
        changes.append(change)

    result = quick_run(on_change)
    assert result.exit_code == 1
    assert "core is FAILED: it refused the supervisor's own records" in result.reason
    ends = [change.new for change in changes if change.name == "core" and change.exit_status is not None]
    assert ends == [ChildState.BACKOFF, ChildState.FAILED]


def _children_named(name: str) -> list[int]:
    pids = Path("/proc/self/task", str(os.getpid()), "children").read_text().split()
    return [int(pid) for pid in pids if _command_of(pid) == name]


def _command_of(pid: str) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except (FileNotFoundError, ProcessLookupError):  # it has just ended
        return ""
