"""A module that overwrites all memory that it may write costs the run that module alone."""

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.base.linux.bus_error import surviving_truncation
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from tests._support.robot import COMMAND, LIMIT_S, Ended, Robot, kill

PROFILE = """
modules:
  listener: {{class: "zoo.modules:Listener"}}
  pulse: {{class: "zoo.modules:Pulse", settings: {{burst: 1}}}}
  viewer: {{class: "zoo.modules:Viewing"}}
  wild:
    class: "zoo.modules:{wild}"
    settings: {settings}
    restart: {{max_restarts: {restarts}, backoff_s: 0.05, backoff_cap_s: 0.1}}
"""
Figures = dict[str, dict[str, Any]]


@pytest.fixture(params=["0", "1"], ids=["c", "python"])
def pure_python(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBBIE_PURE_PYTHON", request.param)


def cut(path: Path) -> None:
    os.truncate(path, 0)


def replace_by_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()
    (path / "file").touch()


def check_end(robot: Robot, process: Any, pids: dict[str, int]) -> None:
    """End the run in order; nothing was lost between the others, which are the same processes as before."""
    handled = robot.top()["listener"]["handled"]
    figures = robot.until(lambda top: top["listener"]["handled"] > handled + 20)
    assert {name: figures[name]["pid"] for name in pids} == pids
    process.send_signal(signal.SIGINT)
    Ended.wait_for(process)
    numbers = robot.journal("listener")
    assert numbers == list(range(len(numbers)))
    assert len(numbers) == robot.journal("pulse")[0]


@pytest.mark.sampled(3)
@pytest.mark.slow
@pytest.mark.usefixtures("pure_python")
@pytest.mark.parametrize("only", ["", "wakeup", "out", "data", "checkpoint"])
def test_module_that_fills_its_memory_with_random_bytes_costs_nobody_else(robot: Robot, only: str) -> None:
    robot.write_profile(PROFILE.format(wild="Scribbler", settings=f'{{only: "{only}"}}', restarts=3))
    process = robot.start()
    others = ("pulse", "listener", "viewer")
    figures = robot.until(lambda top: all(top[name]["state"] == "RUNNING" for name in others))
    pids = {name: figures[name]["pid"] for name in others}
    if only in ("", "out"):
        robot.until(lambda top: top["wild"]["state"] == "FAILED")
    else:
        handled = robot.top()["listener"]["handled"]
        robot.until(lambda top: top["listener"]["handled"] > handled + 100)
    check_end(robot, process, pids)


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.usefixtures("pure_python")
def test_modules_that_overwrite_other_places_in_each_life_cost_nobody_else(robot: Robot) -> None:
    robot.write_profile(PROFILE.format(wild="Scrawler", settings="{seed: 1}", restarts=4))
    process = robot.start()
    others = ("pulse", "listener", "viewer", "core")
    figures = robot.until(lambda top: all(top[name]["state"] == "RUNNING" for name in others))
    pids = {name: figures[name]["pid"] for name in others}
    robot.until(lambda top: top["wild"]["state"] == "FAILED")
    assert len(robot.journal("wild")) > 3, "it dies rarely in its setup"
    check_end(robot, process, pids)


@pytest.mark.sampled(2)
@pytest.mark.slow
@pytest.mark.parametrize("names", ["out-4-*", "in-4-*", "wakeup-4-*"])
def test_module_that_truncates_its_memory_costs_nobody_else(robot: Robot, names: str) -> None:
    """Core and supervisor, which have mapped it, too, got SIGBUS."""
    robot.write_profile(PROFILE.format(wild="Truncator", settings=f'{{names: "{names}"}}', restarts=2))
    process = robot.start()
    others = ("listener", "pulse", "viewer")
    with surviving_truncation(f"{SHARED_MEMORY}/robbie-"):  # this process looks, too
        figures = robot.until(lambda top: all(top[name]["state"] == "RUNNING" for name in others))
        pids = {name: figures[name]["pid"] for name in others}
        robot.until(lambda top: top["wild"]["state"] == "FAILED")
        check_end(robot, process, pids)


@pytest.mark.sampled(3)
@pytest.mark.slow
@pytest.mark.parametrize("name", ["board", "core", "clock", "wakeup-core", "out-0-1", "in-0-1", "wakeup-0-1"])
def test_run_whose_own_memory_is_truncated_ends_with_the_reason(robot: Robot, name: str) -> None:
    """It went on without its core, and said nothing."""
    robot.write_profile(PROFILE.format(wild="Truncator", settings="{names: none}", restarts=2))
    process = robot.start()
    robot.until(lambda top: top["listener"]["handled"] > 20)
    run = robot.known_run()
    path = Path(f"{SHARED_MEMORY}/robbie-{run.run_id}/{name}")
    os.truncate(path, 0)
    assert Ended.wait_for(process).exit_code == 1
    assert f"the run stops: {path} was truncated, and no process can start without it" in robot.log(
        "supervisor"
    )


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.parametrize("name", ["board", "core"])
def test_command_ends_in_order_when_the_memory_that_it_reads_is_truncated(robot: Robot, name: str) -> None:
    """It ended by SIGBUS."""
    robot.write_profile(PROFILE.format(wild="Truncator", settings="{names: none}", restarts=2))
    process = robot.start()
    robot.until(lambda top: top["listener"]["handled"] > 20)
    command = [*COMMAND, "top", "--csv", "-"]
    with subprocess.Popen(command, cwd=robot.folder, stdout=subprocess.PIPE, text=True) as watching:
        try:
            assert watching.stdout is not None
            assert watching.stdout.readline()  # it has mapped the run's memory
            os.truncate(f"{SHARED_MEMORY}/robbie-{robot.known_run().run_id}/{name}", 0)
            watching.communicate(timeout=LIMIT_S)
        finally:
            watching.kill()
    assert watching.returncode == 0
    assert Ended.wait_for(process).exit_code == 1


@pytest.mark.sampled(5)
@pytest.mark.slow
@pytest.mark.parametrize("damage", [cut, Path.unlink, replace_by_folder])
@pytest.mark.parametrize("kind", ["out", "in", "wakeup", "data"])
def test_module_whose_memory_is_damaged_is_killed_alone(
    robot: Robot, kind: str, damage: Callable[[Path], None]
) -> None:
    """A subscriber that read a message just then got SIGBUS from its publisher's memory, and the operator
    station got it from the figures of any module. The supervisor, which could not remove a folder, ended."""
    profile = PROFILE.format(wild="Scribbler", settings='{only: "nothing"}', restarts=2)
    robot.write_profile(profile.replace("Viewing", "Watching"))
    process = robot.start()
    others = ("pulse", "listener", "viewer")
    figures = robot.until(lambda top: top["viewer"]["handled"] > 5)
    pids = {name: figures[name]["pid"] for name in others}
    run = robot.known_run()
    with surviving_truncation(f"{SHARED_MEMORY}/robbie-"):  # this process looks, too
        for path in Path(f"{SHARED_MEMORY}/robbie-{run.run_id}").glob(f"{kind}-4-1*"):
            damage(path)
        if kind == "data" and damage is not cut:  # those that know the segment have mapped it
            kill(figures["wild"]["pid"])
        robot.until(lambda top: top["wild"]["incarnation"] == 2 and top["wild"]["state"] == "RUNNING")
        check_end(robot, process, pids)
