"""Fixtures for all tests; the first one fails any test that leaves something behind."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from hypothesis import settings

from robbie_mp.run import run_directory
from tests._support.left_behind import leaving_nothing_behind
from tests._support.others_runs import OthersRuns, Session, remove_names_of_dead_tests, watched
from tests._support.own_runs import VARIABLE, own_base_folders
from tests._support.robot import Robot, robot_in
from tools.loop_disk import LoopDisk, NoLoopDisk
from tools.test_network.network import Network, NoTestNetwork

settings.register_profile("robbie", deadline=None)  # a busy machine may stop any test for a second
settings.load_profile("robbie")

HERE = Path(__file__).parent
SLOW_FOLDERS = [HERE / "robot", HERE / "security" / "station", HERE / "tools"]
"""Campaigns and whole robots; in other folders, tests are marked one by one."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the slow folders."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in SLOW_FOLDERS):
            item.add_marker(pytest.mark.slow)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a test that tries many cases try all of them."""
    parser.addoption("--exhaustive", action="store_true", help="all kill points, 2,000 cuts of a log")


@pytest.fixture(autouse=True, scope="session")
def interrupts_take_effect() -> None:
    """Undo what a shell does to commands in the background: they, and their children, ignore SIGINT."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def bytecode_is_kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let the many interpreters that tests start find compiled code, even on read-only folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        patch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path_factory.mktemp("bytecode")))
        yield


@pytest.fixture(autouse=True, scope="session")
def no_runs_but_our_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hide the runs of the user, who may have a robot running, and of other tests on this machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        patch.setattr(run_directory, "base_folders", own_base_folders)
        yield


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    """An empty workspace with the zoo's modules; no other runs are listed."""
    with robot_in(tmp_path) as made:
        yield made


@pytest.fixture
def disk() -> Iterator[LoopDisk]:
    """A disk that can be frozen. A process that writes to a frozen disk cannot even be killed."""
    try:
        made = LoopDisk().__enter__()
    except NoLoopDisk as error:
        pytest.skip(f"NOT TESTED, no disk can be frozen here: {error}")
    try:
        yield made
    finally:
        made.__exit__(None, None, None)


@pytest.fixture
def network() -> Iterator[Network]:
    """The hosts "robot" and "laptop", with a perfect network between them that a test makes bad."""
    try:
        made = Network("robot", "laptop").__enter__()
    except NoTestNetwork as error:
        pytest.skip(f"NOT TESTED, there can be no bad network here: {error}")
    try:
        yield made
    finally:
        made.__exit__(None, None, None)


@pytest.fixture(scope="session")
def others_runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OthersRuns]:
    """Mark the processes that tests start, and record the runs of others on this machine."""
    remove_names_of_dead_tests()
    session = Session(os.getpid(), f"{os.getpid()}-{time.monotonic_ns()}")
    seen = tmp_path_factory.mktemp("others_runs") / "seen"
    with pytest.MonkeyPatch.context() as patch, watched(session, seen):
        patch.setenv(VARIABLE, session.mark)
        yield OthersRuns(session, seen)


@pytest.fixture(scope="session")
def left_behind_check(others_runs: OthersRuns) -> Callable[[], AbstractContextManager[None]]:
    """Give a context that fails what leaves a process, a thread, a descriptor or a name in shared memory."""
    return lambda: leaving_nothing_behind(others_runs)


@pytest.fixture(autouse=True)
def nothing_left_behind(left_behind_check: Callable[[], AbstractContextManager[None]]) -> Iterator[None]:
    """Fail a test that leaves a process, a thread, a descriptor or a name in shared memory."""
    with left_behind_check():
        yield
