"""Kills every module of a robot once while it carries out its mission: for trials of whole missions."""

import contextlib
import random
import signal
import time

from robbie_mp.module.clock import SystemClock
from robbie_mp.run.run_clock import RunClock
from tools.kill_campaign.robot import Robot, RobotTrouble


class Kills:
    """Kills every module of a robot once, at random moments of its mission, by the robot's own clock.

    Args:
        robot: it runs.
        seed: of the moments.
        begin_s: the earliest moment, since now.
        end_s: the latest one.
    """

    def __init__(self, robot: Robot, seed: int, begin_s: float, end_s: float) -> None:
        chance = random.Random(seed)
        names = [name for name in robot.figures() if name != "core"]
        self._robot = robot
        self._left = sorted((chance.uniform(begin_s, end_s), name) for name in names)
        self._run_clock = RunClock.attach(robot.run_id)
        self._clock = self._run_clock if self._run_clock.has_begun else SystemClock()
        self._began_ns = self._clock.now_ns()

    def do_what_is_due(self) -> None:
        """Kill the module whose moment has come, if it runs."""
        if self._left and (self._clock.now_ns() - self._began_ns) / 1e9 >= self._left[0][0]:
            figures = self._robot.figures()[self._left[0][1]]
            if figures.pid and self._robot.send(figures.pid, signal.SIGKILL):
                self._left.pop(0)

    def close(self) -> None:
        """Stop looking at the robot's clock."""
        self._run_clock.close()


def watch(robot: Robot, kills: Kills | None, limit_s: float) -> None:
    """Kill the modules at their times, and wait for the end of the mission.

    Args:
        robot: it runs.
        kills: closed at the end; None: nothing is killed.
        limit_s: maximum duration in real time.

    Raises:
        RobotTrouble: the mission did not end in time.
    """
    end_s = time.monotonic() + limit_s
    with contextlib.closing(kills) if kills is not None else contextlib.nullcontext():
        while robot.is_up and time.monotonic() < end_s:
            if kills is not None:
                kills.do_what_is_due()
            time.sleep(0.02)
    if robot.is_up:
        raise RobotTrouble(f"the mission did not end in {limit_s:g} s")
