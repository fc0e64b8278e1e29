"""A module that overwrites all memory that it may write costs the run that module alone."""

import signal
from typing import Any

import pytest

from robbie_mp.base.linux.bus_error import surviving_truncation
from tests._support.robot import Ended, Robot

PROFILE = """
modules:
  listener: {{class: "zoo.modules:Listener"}}
  pulse: {{class: "zoo.modules:Pulse", settings: {{burst: 1}}}}
  viewer: {{class: "zoo.modules:Viewing"}}
  wild:
    class: "zoo.modules:{wild}"
    settings: {settings}
    restart: {{max_restarts: {restarts}, backoff_s: 0.05}}
"""
Figures = dict[str, dict[str, Any]]


@pytest.fixture(params=["0", "1"], ids=["c", "python"])
def pure_python(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBBIE_PURE_PYTHON", request.param)


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


@pytest.mark.slow
@pytest.mark.usefixtures("pure_python")
@pytest.mark.parametrize("names", ["out-4-*", "in-4-*", "wakeup-4-*"])
def test_module_that_truncates_its_memory_costs_nobody_else(robot: Robot, names: str) -> None:
    """Core and supervisor, which have mapped it, too, got SIGBUS."""
    robot.write_profile(PROFILE.format(wild="Truncator", settings=f'{{names: "{names}"}}', restarts=2))
    process = robot.start()
    others = ("listener", "pulse", "viewer")
    with surviving_truncation("/dev/shm/robbie-"):  # this process looks, too
        figures = robot.until(lambda top: all(top[name]["state"] == "RUNNING" for name in others))
        pids = {name: figures[name]["pid"] for name in others}
        robot.until(lambda top: top["wild"]["state"] == "FAILED")
        check_end(robot, process, pids)
