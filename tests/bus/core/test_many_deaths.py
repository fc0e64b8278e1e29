"""Robots drawn at random whose cores die three or four times, modules besides."""

import pytest

from tests.bus.core._support.crowd import Crowd

pytestmark = pytest.mark.slow

PLAYS = 400
EXHAUSTIVE_PLAYS = 20_000


@pytest.mark.parametrize("deaths", [0, 3, 4])
def test_any_robot_survives_many_deaths(deaths: int, pytestconfig: pytest.Config) -> None:
    plays = EXHAUSTIVE_PLAYS // 2 if pytestconfig.getoption("--exhaustive") else PLAYS // 2
    died = messages = 0
    for seed in range(plays):
        crowd = Crowd(seed, deaths)
        try:
            crowd.play()
        except Exception as error:
            raise AssertionError(f"violated by Crowd({seed}, {deaths})") from error
        died += crowd.run.crashes
        messages += len(crowd.published)
    print(f"{plays} robots, {messages} messages, {died} deaths of cores, 0 violations")
