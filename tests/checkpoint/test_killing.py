"""After a kill at any point, the previous checkpoint or the new one is present and complete."""

import subprocess
import sys
from pathlib import Path

import pytest

SCENARIOS = {"first": 60, "second": 60, "third": 30, "larger": 60, "smaller": 30, "at random": 40}
"""Minimum number of deaths, so that a scenario without kills is not a success."""
PROJECT = Path(__file__).parents[2]


def deaths(scenario: str) -> int:
    command = [sys.executable, "-m", "tests.checkpoint._support.killing", scenario]
    ended = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=50, check=False)
    assert ended.returncode == 0, ended.stderr
    return int(ended.stdout)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_killed_process_leaves_a_complete_checkpoint_in_shared_memory(scenario: str) -> None:
    assert deaths(scenario) >= SCENARIOS[scenario]


@pytest.mark.parametrize("scenario", ["file", "file at random"])
def test_killed_process_leaves_a_complete_file(scenario: str) -> None:
    assert deaths(scenario) >= 25
