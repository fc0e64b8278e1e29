"""After a kill at any point, the previous checkpoint or the new one is present and complete."""

import subprocess
import sys

import pytest

from robbie_mp.bus.transport.shared_folder import remove_names
from tests._support.places import PROJECT
from tests.bus.checkpoint._support.killing import run_of

SCENARIOS = {"first": 60, "second": 60, "third": 30, "larger": 60, "smaller": 30, "at random": 40}
"""Minimum number of deaths, so that a scenario without kills is not a success."""


def deaths(scenario: str) -> int:
    command = [sys.executable, "-m", "tests.bus.checkpoint._support.killing", scenario]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=PROJECT, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            printed, errors = process.communicate(timeout=50)
        finally:
            process.kill()
            remove_names(run_of(process.pid))  # a process that is killed cannot
    assert process.returncode == 0, errors
    return int(printed)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_killed_process_leaves_a_complete_checkpoint_in_shared_memory(scenario: str) -> None:
    assert deaths(scenario) >= SCENARIOS[scenario]


@pytest.mark.parametrize("scenario", ["file", "file at random"])
def test_killed_process_leaves_a_complete_file(scenario: str) -> None:
    assert deaths(scenario) >= 25
