"""The walk-through of docs/debugging.md, from a crash to a test that fails, works as described."""

import subprocess
import sys

import pytest

from tests._support.robot import COMMAND, Robot
from tests.docs._support.pages import block

PAGE = "docs/debugging.md"


def commands(mark: str) -> list[list[str]]:
    return [line.split()[1:] for line in block(PAGE, mark).splitlines()]


@pytest.mark.slow
def test_walk_through_leads_from_a_crash_to_a_test_that_fails(robot: Robot) -> None:
    (robot.folder / "bumper.py").write_text(block(PAGE, "module"))
    robot.write_profile(block(PAGE, "profile"))
    robot.start()
    robot.until(lambda top: top["bumper"]["restarts"] > 0)
    robot.until(lambda _top: bool(list((robot.output / "log" / "crashes").glob("bumper-*-1.capsule"))))
    robot.command("stop")
    (capsule,) = (robot.output / "log" / "crashes").glob("bumper-*-1.capsule")
    capsule.rename(robot.folder / "bumper.capsule")

    (words,) = commands("replay")
    replayed = robot.command(*words)
    assert replayed.returncode == 0, replayed
    assert block(PAGE, "verdict").strip() in replayed.stdout
    for words in commands("look"):
        looked = subprocess.run(
            [*COMMAND, *words], cwd=robot.folder, input="c\nq\n", capture_output=True, text=True, check=False
        )
        assert "LaserScan" in looked.stdout or "ValueError" in looked.stdout, looked

    (words,) = commands("write")
    written = robot.command(*words)
    assert written.returncode == 0, written
    test = robot.folder / "tests" / "test_bumper.py"
    assert block(PAGE, "written").rpartition("harness.send(")[0] in test.read_text()
    test_command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(test)]
    assert subprocess.run(test_command, cwd=robot.folder, capture_output=True, check=False).returncode == 1
    code = robot.folder / "bumper.py"
    code.write_text(code.read_text().replace("if seen.min()", "if len(seen) and seen.min()"))
    assert subprocess.run(test_command, cwd=robot.folder, capture_output=True, check=False).returncode == 0
    assert robot.command(*commands("replay")[0]).stdout.count("no crash") == 1
