"""What docs/debugging.md says works as described: breakpoints, reloading, and a crash that becomes a test."""

import re
import subprocess
import sys

import pytest

from tests._support.robot import COMMAND, Robot, wait_until
from tests.docs._support.pages import block

PAGE = "docs/debugging.md"
LASER = """
import numpy as np

from robbie_mp import Module
from robbie_mp.messages import LaserScan


class Laser(Module):
    period_s = 0.02

    def tick(self):
        self.publish(LaserScan(header=self.header("laser"), ranges=np.full(360, 2.0, np.float32)))
"""
FIELD = """
modules:
  laser: {class: "laser:Laser"}
  warner: {class: "warner:Warner"}
"""
"""A smaller robot than the page's, where the robot does not matter."""


def fixed(code: str) -> str:
    return code.replace("near.min()", "near.min(initial=self.near_m)")


def commands(mark: str) -> list[list[str]]:
    return [line.split()[1:] for line in block(PAGE, mark).splitlines()]


def run_test(robot: Robot, *words: str) -> int:
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, cwd=robot.folder, capture_output=True, check=False).returncode


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_walk_through_leads_from_a_crash_to_a_test_that_fails(robot: Robot) -> None:
    (robot.folder / "warner.py").write_text(block(PAGE, "module"))
    robot.write_profile(block(PAGE, "profile"))
    robot.start("--set", "operator.port=0")
    robot.until(lambda top: top["warner"]["restarts"] > 0)
    robot.until(lambda _top: bool(list((robot.output / "log" / "crashes").glob("warner-*-1.capsule"))))
    robot.command("stop")
    (capsule,) = (robot.output / "log" / "crashes").glob("warner-*-1.capsule")
    capsule.rename(robot.folder / "warner.capsule")

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
    test = robot.folder / "tests" / "test_warner.py"
    assert block(PAGE, "written").rpartition("harness.send(")[0] in test.read_text()
    assert run_test(robot, "pytest", str(test)) == 1
    assert run_test(robot, "unittest") == 1
    code = robot.folder / "warner.py"
    code.write_text(fixed(code.read_text()))
    assert run_test(robot, "pytest", str(test)) == 0
    assert run_test(robot, "unittest") == 0
    assert robot.command(*commands("replay")[0]).stdout.count("no crash") == 1


@pytest.mark.slow
def test_saved_code_is_reloaded_and_stops_at_its_breakpoint(robot: Robot) -> None:
    code = robot.folder / "warner.py"
    right = fixed(block(PAGE, "module"))
    code.write_text(right)
    (robot.folder / "laser.py").write_text(LASER)
    robot.write_profile(FIELD, "field")
    ((*command, _field, option),) = commands("reload")
    robot.start(option, command=command, profile="field")
    robot.until(lambda top: top["warner"]["handled"] > 0)

    code.write_text(right.replace("scan: LaserScan) -> None:", "scan: LaserScan) -> None"))
    wait_until(lambda: block(PAGE, "mistake").strip() in robot.log("warner"))
    assert robot.top()["warner"]["restarts"] == 0
    code.write_text(right.replace("        near =", "        breakpoint()\n        near ="))
    wait_until(lambda: "stands at a breakpoint" in robot.log("warner"))

    said = block(PAGE, "attached")
    typed = re.findall(r"\(Pdb\) (.*)", said)
    (words,) = commands("attach")
    debugged = subprocess.run(
        [*COMMAND, *words],
        cwd=robot.folder,
        input="\n".join(["n" if sys.version_info >= (3, 13) else "p 0", *typed]),
        capture_output=True,
        text=True,
        check=False,
    )
    line, _, answer, _ = said.splitlines()
    assert line in debugged.stdout, debugged
    assert answer in debugged.stdout
    assert robot.top()["warner"]["restarts"] == 1


@pytest.mark.slow
def test_profile_for_an_editor_is_valid(robot: Robot) -> None:
    (robot.folder / "warner.py").write_text(block(PAGE, "module"))
    (robot.folder / "laser.py").write_text(LASER)
    robot.write_profile(FIELD, "field")
    robot.write_profile(block(PAGE, "editor"), "debug")
    shown = robot.command("profile", "show", "debug")
    assert shown.returncode == 0, shown.stderr
    assert re.search(r"start_deadline_s: 600.0 +# profiles/debug.yaml", shown.stdout)
