"""Fixtures for all tests; the first one fails any test that leaves something behind."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests._support.session_memory import SESSION_MEMORY  # isort: skip (robbie_mp looks at what it sets)
from robbie_mp.run import run_directory
from tests._support import own_memory
from tests._support.disks import freezable_disk
from tests._support.left_behind import leaving_nothing_behind
from tests._support.own_runs import own_base_folders
from tests._support.robot import Robot, robot_in
from tools.loop_disk import LoopDisk
from tools.test_network.network import Network, NoTestNetwork

settings.register_profile("robbie", deadline=None)  # a busy machine may stop any test for a second
settings.load_profile("robbie")

HERE = Path(__file__).parent
SLOW_FOLDERS = [HERE / "robot", HERE / "security" / "station", HERE / "tools"]
"""Campaigns and whole robots; in other folders, tests are marked one by one."""
SLOW_TIMEOUT_S = 600
"""Tests that try all kill points take 20 s, and ten times as long on a machine that does much else."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of the slow folders; give slow ones time where other programs use the processors."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in SLOW_FOLDERS):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            limit_s = 0 if config.getoption("--exhaustive") else SLOW_TIMEOUT_S  # 0: none
            item.add_marker(pytest.mark.timeout(limit_s))
    if not config.getoption("--exhaustive"):
        leave_out_cases(config, items)
    if turn := config.getoption("--turn"):
        leave_out_other_turns(config, items, *map(int, turn.split("/")))


def leave_out_cases(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of each test that is `sampled`, keep as many cases as it says, among them the first."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sampled"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    left_out = set[pytest.Item]()
    for tried in cases.values():
        count = min(sample_size(tried[0]), len(tried))
        kept = {number * len(tried) // count for number in range(count)}
        left_out |= {item for number, item in enumerate(tried) if number not in kept}
    leave_out(config, items, left_out)


def leave_out_other_turns(config: pytest.Config, items: list[pytest.Item], turn: int, turns: int) -> None:
    """Of the slow tests that are not of `every_turn`, keep those of every `turns`th file."""
    slow = {item for item in items if item.get_closest_marker("slow")}
    rotated = {item for item in slow if not item.get_closest_marker("every_turn")}
    files = sorted({item.path for item in rotated})
    kept = set(files[turn % turns :: turns])
    leave_out(config, items, {item for item in rotated if item.path not in kept})


def leave_out(config: pytest.Config, items: list[pytest.Item], left_out: set[pytest.Item]) -> None:
    items[:] = [item for item in items if item not in left_out]
    config.hook.pytest_deselected(items=list(left_out))


def sample_size(item: pytest.Item) -> int:
    return next(int(mark.args[0]) for mark in item.iter_markers("sampled"))


def pytest_unconfigure() -> None:
    """Remove the session's folder in shared memory."""
    own_memory.remove(SESSION_MEMORY)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let a test that tries many cases try all of them, and a run try a part of the slow files."""
    parser.addoption(
        "--exhaustive",
        action="store_true",
        help="all cases, all kill points, 2,000 cuts of a log",
    )
    parser.addoption(
        "--turn",
        metavar="N/M",
        help="of the files with slow tests, each Mth from the Nth on, and the tests of `every_turn`",
    )


@pytest.fixture(autouse=True, scope="session")
def interrupts_take_effect() -> None:
    """Undo what a shell does to commands in the background: they, and their children, ignore SIGINT."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def bytecode_is_kept() -> Iterator[None]:
    """Let the many interpreters that tests start find compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
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
    with freezable_disk() as made:
        yield made


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


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """Fail a test that leaves a process, a thread, a descriptor or a name in shared memory."""
    with leaving_nothing_behind():
        yield
