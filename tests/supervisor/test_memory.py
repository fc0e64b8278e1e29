"""How the supervisor manages the memory of all processes of a run."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.profile.model import ModuleSpec, Profile
from robbie_mp.run.plan import RunPlan
from robbie_mp.supervisor.memory import RunMemory
from robbie_mp.transport import names
from robbie_mp.transport.layout import SegmentKind
from robbie_mp.transport.run_memory import IncarnationMemory, attach_wakeup
from robbie_mp.transport.segment import Segment
from robbie_mp.transport.shared_folder import make_folder

RUN_ID = f"test{os.getpid()}"
PROFILE = Profile("p", (ModuleSpec("laser", "zoo:Laser"),))
PLAN = RunPlan.of_profile(PROFILE, RUN_ID, Path(), Path(), os.getpid())


@pytest.fixture
def memory() -> Iterator[RunMemory]:
    make_folder(RUN_ID)
    made = RunMemory(PLAN)
    yield made
    made.close()


def test_core_modules_and_tools_are_woken_when_the_wall_clock_is_set(
    memory: RunMemory,
) -> None:
    """Else a tool that waits for 0.1 s when the clock is set back by an hour sleeps for an hour."""
    tool = PLAN.tool_names[0]
    memory.open("laser", 1)
    memory.open(tool, 1)
    memory.attached(tool, 1, os.getpid())
    tables = Segment.attach(names.core(RUN_ID), SegmentKind.CORE)
    core = attach_wakeup(RUN_ID, tables)
    tables.close()
    core.wait(0.0)
    assert not core.wait(0.0)
    attached = [
        IncarnationMemory.attach_as_module(RUN_ID, PLAN.names.index(name), 1) for name in ("laser", tool)
    ]
    memory.wake_all()
    woken = [core.wait(0.0), *(entry.wakeup.wait(0.0) for entry in attached)]
    for entry in attached:
        entry.close()
    core.close()
    assert woken == [True, True, True]
