"""What docs/debugging.md says works as described: breakpoints, reloading, and a crash that becomes a test."""

import re
import subprocess
import sys

import pytest

from tests._support.robot import COMMAND, Robot, wait_until
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


@pytest.mark.slow
def test_saved_code_is_reloaded_and_stops_at_its_breakpoint(robot: Robot) -> None:
    code = robot.folder / "bumper.py"
    right = block(PAGE, "module").replace("if seen.min()", "if len(seen) and seen.min()")
    code.write_text(right)
    robot.write_profile(block(PAGE, "profile"), "field")
    ((*command, _field, option),) = commands("reload")
    robot.start(option, command=command, profile="field")
    robot.until(lambda top: top["bumper"]["handled"] > 0)

    code.write_text(right.replace("scan: LaserScan) -> None:", "scan: LaserScan) -> None"))
    wait_until(lambda: block(PAGE, "mistake").strip() in robot.log("bumper"))
    assert robot.top()["bumper"]["restarts"] == 0
    code.write_text(right.replace("        seen =", "        breakpoint()\n        seen ="))
    wait_until(lambda: "stands at a breakpoint" in robot.log("bumper"))

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
    assert robot.top()["bumper"]["restarts"] == 1


def test_profile_for_an_editor_is_valid(robot: Robot) -> None:
    (robot.folder / "bumper.py").write_text(block(PAGE, "module"))
    robot.write_profile(block(PAGE, "profile"), "field")
    robot.write_profile(block(PAGE, "editor"), "debug")
    shown = robot.command("profile", "show", "debug")
    assert shown.returncode == 0, shown.stderr
    assert re.search(r"start_deadline_s: 600.0 +# profiles/debug.yaml", shown.stdout)
