"""Fixtures of the tests of the hot path in C."""

from pathlib import Path
from types import ModuleType

import pytest

from tests.core._support.simulated_run import SimulatedRun
from tests.hot._support.build import compiler, fused_module
from tests.hot._support.memory import FusedMemory


@pytest.fixture(scope="session")
def compiler_command() -> list[str]:
    """The C compiler; without one, these tests cannot tell anything."""
    command = compiler()
    if command is None:
        pytest.skip("NOT TESTED, there is no C compiler here")
    return command


@pytest.fixture(scope="session")
def built(
    compiler_command: list[str], pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> ModuleType:
    """The test build of the hot path; kept between sessions as long as its sources are the same."""
    assert compiler_command
    cache = getattr(pytestconfig, "cache", None)
    return fused_module(tmp_path_factory.mktemp("hot") if cache is None else Path(cache.mkdir("hot")))


@pytest.fixture
def runs_in_c(built: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """All simulated runs of a test use the hot path in C."""
    monkeypatch.setattr(SimulatedRun, "memory", FusedMemory(built, with_c=True))
