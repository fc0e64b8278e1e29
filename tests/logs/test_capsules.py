"""Forty ways to crash: each leaves a capsule, and crashes again at the same line."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.logs.capsule.read import read_capsule
from robbie_mp.logs.capsule.replay import environment_of, judge, replay
from tests._support.robot import COMMAND, Robot
from tests.logs._support import crash_zoo

ZOO = Path(crash_zoo.__file__)
ELSEWHERE = {"Killed"}
"""Nobody knows the line of a process that SIGKILL ended; the signal is the same."""
GROUP = 12
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def capsules(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    """Let all modules crash, some at a time; the newest capsule of each kind."""
    found = {}
    names = list(crash_zoo.KINDS)
    for begin in range(0, len(names), GROUP):
        folder = tmp_path_factory.mktemp("crashes")
        robot = Robot(folder)
        (folder / "crashes.py").write_text(ZOO.read_text())
        robot.write_profile(crash_zoo.profile(names[begin : begin + GROUP]))
        robot.run()
        for name in names[begin : begin + GROUP]:
            files = sorted(
                (robot.output / "log" / "crashes").glob(f"{crash_zoo.module_name(name)}-*.capsule")
            )
            if files:
                found[name] = files[-1]
    yield found


@pytest.mark.parametrize("name", crash_zoo.KINDS)
def test_crash_is_replayed_at_the_same_line(capsules: dict[str, Path], name: str) -> None:
    path = capsules[name]
    capsule = read_capsule(path)
    workspace = path.parents[3]
    if environment_of(capsule)["PYTHONHASHSEED"] != os.environ.get("PYTHONHASHSEED") and name == "SetOrder":
        robot_command = [*COMMAND, "replay", str(path)]
        code = os.spawnve(os.P_WAIT, sys.executable, robot_command, {**os.environ, "PWD": str(workspace)})
        assert code == 0 or os.chdir(workspace) is None
        return
    verdict = judge(capsule, replay(capsule, workspace, limit_s=3.0, quiet=True))
    assert verdict.is_same, "\n".join(verdict.lines)
    assert len(verdict.lines) == 1, "what it published differs"
