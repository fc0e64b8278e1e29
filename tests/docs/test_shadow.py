"""The commands of docs/shadow.md work on its robot."""

import json

import pytest

from tests._support.robot import Robot
from tests.docs._support.pages import block

PAGE = "docs/shadow.md"


def commands(mark: str) -> list[list[str]]:
    return [line.split()[1:] for line in block(PAGE, mark).splitlines()]


@pytest.fixture
def robot_of_the_page(robot: Robot) -> Robot:
    code = block(PAGE, "module")
    (robot.folder / "nearest.py").write_text(code)
    (robot.folder / "fixed").mkdir()
    (robot.folder / "fixed" / "nearest.py").write_text(
        code.replace("float(scan.ranges.min())", "float(np.sort(scan.ranges)[1])")
    )
    robot.write_profile(block(PAGE, "profile"))
    robot.start()
    robot.until(lambda top: top["nearest"]["handled"] > 0)
    return robot


@pytest.mark.slow
def test_shadow_shows_what_the_mend_changes(robot_of_the_page: Robot) -> None:
    first, second = commands("shadow")
    done = robot_of_the_page.command(*first)
    assert done.returncode == 1, done.stderr
    assert "pose.position.x" in done.stdout
    report = json.loads(robot_of_the_page.command(*second).stdout)
    (channel,) = report["channels"]
    assert channel["equal"] + channel["different"] > 0
    assert channel["only_in_module"] == channel["only_in_shadow"] == 0

    assert robot_of_the_page.command("record", "-o", "recording", "--duration", "1s").returncode == 0
    (words,) = commands("log")
    done = robot_of_the_page.command(*words)
    assert done.returncode == 1, done.stderr
    assert "pose.position.x" in done.stdout


@pytest.mark.slow
def test_swap_and_back(robot_of_the_page: Robot) -> None:
    for words in commands("swap"):
        done = robot_of_the_page.command(*words)
        assert done.returncode == 0, done.stderr
        assert done.stdout.endswith("messages that it missed meanwhile: none\n")
