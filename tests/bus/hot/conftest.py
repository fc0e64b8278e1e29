"""Fixtures of the tests of the hot path in C."""

from pathlib import Path
from types import ModuleType

import pytest

from tests.bus.hot._support.build import compiler, fused_module


@pytest.fixture(scope="session")
def compiler_command() -> list[str]:
    """The C compiler; without one, these tests cannot tell anything."""
    command = compiler()
    if command is None:
        pytest.skip("NOT TESTED, there is no C compiler here")
    return command


@pytest.fixture(scope="session")
def kept_builds(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for builds, which are kept between sessions as long as their sources are the same."""
    cache = getattr(pytestconfig, "cache", None)
    return tmp_path_factory.mktemp("hot") if cache is None else Path(cache.mkdir("hot"))


@pytest.fixture(scope="session")
def built(compiler_command: list[str], kept_builds: Path) -> ModuleType:
    """The test build of the hot path."""
    assert compiler_command
    return fused_module(kept_builds)
