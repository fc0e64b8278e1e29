"""How the supervisor manages the memory of all processes of a run."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.supervisor.memory import RunMemory
from robbie_mp.run.supervisor.own_log import logging_to
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.trace.kinds import Kind

RUN_ID = f"test{os.getpid()}"
PROFILE = Profile("p", (ModuleSpec("laser", "zoo:Laser"),))
PLAN = RunPlan.of_profile(PROFILE, RUN_ID, Path(), Path(), os.getpid())


@pytest.fixture
def memory() -> Iterator[RunMemory]:
    make_folder(RUN_ID)
    made = RunMemory(PLAN)
    yield made
    made.close()


def test_what_the_supervisor_could_not_publish_is_in_the_trace(memory: RunMemory) -> None:
    """It was printed on standard error, where a stopped terminal stopped the supervisor."""
    said: list[tuple[Kind, str]] = []
    change = StateChange("laser", 1, ChildState.STARTING, ChildState.RUNNING, "ready", 0.0)
    with logging_to(lambda kind, text: said.append((kind, text))):
        for _ in range(2 * PLAN.sizes.records):  # no core takes anything
            memory.state_changed(change)
    assert said[0][0] is Kind.WARNING
    assert "refused to publish a robbie_msgs/msg/ModuleState" in said[0][1]


@pytest.mark.parametrize("instead", ["nothing", "a file"])
def test_supervisor_goes_on_where_a_module_has_moved_the_folder(memory: RunMemory, instead: str) -> None:
    """It reports the files that are gone; it ended where it could not look for more."""
    (SHARED_MEMORY / names.data(RUN_ID, 0, 1, 1)).touch()
    assert memory.data_files()
    folder = SHARED_MEMORY / names.folder(RUN_ID)
    moved = folder.rename(folder.with_name(f"{folder.name}-moved"))
    try:
        if instead == "a file":
            folder.touch()
        assert memory.data_files() == {}
    finally:
        folder.unlink(missing_ok=True)
        moved.rename(folder)
