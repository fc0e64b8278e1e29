"""How the supervisor manages the memory of all processes of a run."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.bus.transport.shared_folder import make_folder
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.supervisor.memory import RunMemory

RUN_ID = f"test{os.getpid()}"
PROFILE = Profile("p", (ModuleSpec("laser", "zoo:Laser"),))
PLAN = RunPlan.of_profile(PROFILE, RUN_ID, Path(), Path(), os.getpid())


@pytest.fixture
def memory() -> Iterator[RunMemory]:
    make_folder(RUN_ID)
    made = RunMemory(PLAN)
    yield made
    made.close()
