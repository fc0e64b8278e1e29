"""Many ways to crash: each leaves a capsule, and crashes again at the same line."""

import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.logs.capsule.read import read_capsule
from robbie_mp.logs.capsule.replay import judge, replay
from tests._support.robot import COMMAND, robot_in
from tests.logs._support import crash_zoo

ZOO = Path(crash_zoo.__file__)
GROUP = 12
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def capsules(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Let all modules crash, some at a time; the newest capsule of each kind."""
    found = {}
    names = list(crash_zoo.KINDS)
    for begin in range(0, len(names), GROUP):
        folder = tmp_path_factory.mktemp("crashes")
        with robot_in(folder) as robot:
            (robot.folder / "crashes.py").write_text(ZOO.read_text())
            robot.write_profile(crash_zoo.profile(names[begin : begin + GROUP]))
            robot.run()
        for name in names[begin : begin + GROUP]:
            files = sorted(
                (robot.output / "log" / "crashes").glob(f"{crash_zoo.module_name(name)}-*.capsule")
            )
            if files:
                found[name] = files[-1]
    return found


@pytest.mark.sampled(15)
@pytest.mark.parametrize("name", [*crash_zoo.KINDS])
def test_crash_is_replayed_at_the_same_line(capsules: dict[str, Path], name: str) -> None:
    path = capsules[name]
    workspace = path.parents[3]
    if name == "SetOrder":  # for which Python must be started with the hash seed of then
        ended = subprocess.run(
            [*COMMAND, "replay", str(path)], cwd=workspace, check=False, capture_output=True
        )
        assert ended.returncode == 0, ended
        return
    capsule = read_capsule(path)
    verdict = judge(capsule, replay(capsule, workspace, limit_s=5.0, quiet=True))
    assert verdict.is_same, "\n".join(verdict.lines)
    assert len(verdict.lines) == 1, "what it published differs"


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        (
            "AfterTwoTopics",
            ['harness.send(Number(value=9), topic="a")', 'harness.send(Number(value=10), topic="b")'],
        ),
        ("SettingChanged", ['harness.change_setting("gain", 0)', 'topic="a")']),
        ("NthTick", ["harness.advance("]),
        ("Restored", ['restored={"n": 8}']),
        ("ReplyHandler", ["(request,) = harness.take(Ask)", "harness.reply(request, Answer("]),
    ],
)
def test_test_is_written_that_crashes_likewise(
    capsules: dict[str, Path], name: str, lines: list[str]
) -> None:
    path, test = capsules[name], f"tests/test_{name.lower()}.py"
    workspace = path.parents[3]
    command = [*COMMAND, "replay", str(path), "--as-test", test]
    ended = subprocess.run(command, cwd=workspace, check=False, capture_output=True, text=True)
    assert ended.returncode == 0, ended
    text = (workspace / test).read_text()
    assert all(line in text for line in lines), text
    assert text.count("harness.send(") <= 5, text
    for runner, said in {"pytest": "1 failed", "unittest": "FAILED ("}.items():
        command = [sys.executable, "-m", runner, test]
        ran = subprocess.run(command, cwd=workspace, check=False, capture_output=True, text=True)
        assert ran.returncode == 1, ran.stdout
        assert said in ran.stdout + ran.stderr
