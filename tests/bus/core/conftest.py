"""Fixtures of the core's tests."""

import pytest

from tests.bus.core._support.simulated_run import SimulatedRun
from tests.bus.hot._support.memory import FusedMemory
from tests.bus.hot.conftest import built, compiler_command, kept_builds

__all__ = ["built", "compiler_command", "kept_builds"]

ONCE = ("test_lockstep", "test_recovery_mutations", "test_working_alone")
"""Lockstep is never in C, what is broken on purpose is Python, and only C works alone."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Play every test of the core twice."""
    if metafunc.module.__name__.rpartition(".")[2] not in ONCE:
        metafunc.parametrize("hot_path", ["Python", "C"], indirect=True)


@pytest.fixture(autouse=True)
def hot_path(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Let all simulated runs of a test use the hot path in this language."""
    language: str = getattr(request, "param", "Python")
    if language == "C":
        monkeypatch.setattr(
            SimulatedRun, "memory", FusedMemory(request.getfixturevalue("built"), with_c=True)
        )
    return language
