"""Programs in a profile: started, watched and ended as modules are, with all that they have started."""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.messages import String
from robbie_mp.run.program.module import Program, ProgramSilent
from tests._support.robot import Robot, command_of, wait_until

FOREVER = 987
"""Seconds that the processes of these tests would sleep."""
TREE = """
sleep {mark} &
(setsid sleep {mark} &)
(setsid env -i "$(command -v sleep)" {mark} &)
trap 'echo asked; exit 0' TERM
echo ready >&2
while :; do sleep 0.05; done
"""
"""A program with a child, one in a session of its own, and one that has lost its environment, too."""


@pytest.fixture
def mark() -> Iterator[str]:
    """The argument of the processes of a test, by which they are found."""
    mark = f"{FOREVER}.{time.monotonic_ns()}"
    yield mark
    for process in marked(mark):
        process.kill()
    assert not marked(mark)


def marked(mark: str) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline", "status"]):
        if mark in " ".join(process.info["cmdline"] or ()) and process.info["status"] != psutil.STATUS_ZOMBIE:
            found.append(process)
    return found


def shell(text: str) -> list[str]:
    return ["/bin/sh", "-c", text]


def run(text: str, **settings: object) -> ModuleHarness[Program]:
    return ModuleHarness(Program, {"command": shell(text), **settings})


def until(harness: ModuleHarness[Program], condition: Callable[[], bool]) -> None:
    def check() -> bool:
        harness.advance(0.05)
        return condition()

    wait_until(check)


def test_a_program_is_asked_to_end_and_nothing_of_its_tree_is_left(
    mark: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with run(TREE.format(mark=mark), ready_line="ready") as harness:
        wait_until(lambda: len(marked(mark)) >= 4)  # with the shell itself
        harness.advance(1.5)
        assert "processes" in harness.module.status
    assert not marked(mark)
    printed = capfd.readouterr()
    assert "asked" in printed.out
    assert "ready" in printed.err


def test_a_program_that_does_not_end_is_killed(mark: str) -> None:
    with run(
        f"trap '' TERM; echo ready; while :; do sleep 0.1; done # {mark}", ready_line="ready"
    ) as harness:
        harness.module.process._grace_s = 0.1
    assert not marked(mark)


def test_a_program_that_has_ended_takes_its_children_with_it(mark: str) -> None:
    with run(f"(setsid sleep {mark} &); exit 3") as harness:
        with pytest.raises(SystemExit, match="3"):
            until(harness, lambda: False)
        assert not marked(mark)


def test_a_program_that_ends_well_ends_its_module() -> None:
    with run("true") as harness:
        until(harness, lambda: harness.module.stop_requested)


def test_when_its_module_dies_the_program_ends(mark: str) -> None:
    with run(TREE.format(mark=mark), ready_line="ready") as harness:
        assert harness.module.process._popen.stdin is not None
        harness.module.process._popen.stdin.close()
        wait_until(lambda: not marked(mark))


@pytest.mark.parametrize(
    ("text", "settings", "problem"),
    [
        ("echo alive; sleep 20", {"alive_line": "alive"}, "no line with 'alive'"),
        ("sleep 20", {"alive_topic": "String sign"}, "no message of String sign"),
    ],
)
def test_a_program_without_a_sign_of_life_is_ended(text: str, settings: dict[str, Any], problem: str) -> None:
    with run(text, within_s=0.2, **settings) as harness, pytest.raises(ProgramSilent, match=problem):
        until(harness, lambda: False)


def test_a_port_that_answers_no_longer_is_no_sign_of_life() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        harness = run("sleep 20", within_s=0.3, alive_port=server.getsockname()[1])
        harness.__enter__()
    with pytest.raises(ProgramSilent, match="no answer at port"):
        until(harness, lambda: False)
    harness.__exit__(None, None, None)


def test_a_topic_that_keeps_coming_is_a_sign_of_life() -> None:
    with run("sleep 20", within_s=0.2, alive_topic="String sign") as harness:
        for _ in range(6):
            time.sleep(0.06)
            harness.send(String(data="here"), topic="sign")
            harness.advance(0.05)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"command": []}, "expected a program"),
        ({"command": ["./no-such-program"]}, "there is no program './no-such-program'$"),
        ({"command": [__file__]}, rf"there is no program '{__file__}'; `chmod \+x {__file__}` makes it one"),
        ({"command": ["no-such-program"]}, "there is no program 'no-such-program' in PATH"),
        ({"command": ["true"], "alive_topic": "a b c"}, "expected a type"),
    ],
)
def test_wrong_settings_are_explained(settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(SettingError, match=problem), ModuleHarness(Program, settings):
        pass


PROFILE = """
modules:
  driver:
    program: [/bin/sh, tree.sh]
    settings: {ready_line: ready}
    restart: {backoff_s: 0.01}
    memory: {process_bytes: 300000000}
  tunable: {class: "zoo.modules:Tunable"}
"""


def program_of(figures: dict[str, dict[str, Any]]) -> psutil.Process:
    """The process of the program itself; its guardian has its name among its arguments, too."""
    tree = psutil.Process(figures["driver"]["pid"]).children(recursive=True)
    (program,) = [one for one in tree if command_of(one) == ["/bin/sh", "tree.sh"]]
    return program


def has_returned(modules: dict[str, dict[str, Any]]) -> bool:
    return bool(modules["driver"]["restarts"] == 1 and modules["driver"]["state"] == "RUNNING")


@pytest.mark.slow
def test_a_killed_program_comes_back_and_killed_supervisors_leave_nothing(robot: Robot, mark: str) -> None:
    limit = f"echo {mark} $(ulimit -v)\n"
    (robot.folder / "tree.sh").write_text(limit + TREE.format(mark=mark) + f"# {mark}\n")
    robot.write_profile(PROFILE)
    robot.start()
    figures = robot.until(lambda modules: "processes" in modules["driver"]["status"])
    first = {process.pid for process in marked(mark)}
    assert len(first) == 3
    program = program_of(figures)
    program.kill()
    figures = robot.until(
        lambda modules: modules["driver"]["restarts"] == 1 and modules["driver"]["state"] == "RUNNING"
    )
    wait_until(lambda: len(marked(mark)) == 3)
    assert first.isdisjoint(process.pid for process in marked(mark))
    assert "killed by SIGKILL" in robot.log("driver")
    assert f"{mark} 292968" in robot.log("driver")
    supervisor, core = (figures[name]["pid"] for name in ("supervisor", "core"))
    program = program_of(figures)
    for pid in (core, supervisor, program.pid):
        os.kill(pid, signal.SIGKILL)
    wait_until(lambda: not marked(mark) and not program.is_running())
    robot.command("clean")


@pytest.mark.slow
def test_an_essential_program_that_fails_ends_the_run(robot: Robot) -> None:
    robot.write_profile(
        "modules:\n  driver: {program: [/bin/sh, -c, 'exit 3'], essential: true, restart: {policy: never}}\n"
    )
    ended = robot.command("run", "robot")
    assert ended.returncode != 0
    assert "exit code 3" in ended.stdout + ended.stderr


@pytest.mark.slow
@pytest.mark.every_turn
def test_a_profile_has_a_class_or_a_program(robot: Robot) -> None:
    robot.write_profile('modules:\n  driver: {program: ["true"], class: "zoo.modules:Tunable"}\n')
    checked = robot.command("run", "robot")
    assert checked.returncode == 2
    assert "expected either class or program" in checked.stderr
    robot.write_profile('modules:\n  driver: {program: ["no-such-program"]}\n')
    checked = robot.command("run", "robot")
    assert checked.returncode == 2
    assert "there is no program" in checked.stderr


def test_the_guardian_says_what_cannot_be_started(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "script"
    script.write_text("#!/no/such/interpreter\n")
    script.chmod(0o755)
    with ModuleHarness(Program, {"command": [str(script)]}) as harness, pytest.raises(SystemExit):
        until(harness, lambda: False)
    assert f"{script} cannot be started: No such file" in capfd.readouterr().err


def test_a_guardian_needs_no_package_of_ours() -> None:
    assert "robbie_mp" not in Path(sys.modules["robbie_mp.run.program.guardian"].__file__ or "").read_text()
