"""The stop guards of a process."""

import os
import time

import psutil

from robbie_robots.hw.connection import stop_guard
from tests._support.robot import command_of

LIMIT_S = 20.0


def guards(pid: int | None = None) -> list[psutil.Process]:
    """Return the stop guards that a process has started and that run; None: this process."""
    return [
        child
        for child in psutil.Process(pid or os.getpid()).children()
        if stop_guard.__file__ in command_of(child)
    ]


def new_guard(pid: int, before: list[psutil.Process]) -> psutil.Process:
    """Wait until a process has replaced one of its guards, and return the new one."""
    give_up_s = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up_s:
        for guard in guards(pid):
            if guard not in before:
                return guard
        time.sleep(0.002)
    raise AssertionError("the lost guard was not replaced")
