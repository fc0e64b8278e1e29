"""Modules wait for the run's time; its source may take long, or never set it."""

import time

import pytest

from tests._support.robot import Ended, Robot, wait_until

pytestmark = pytest.mark.slow

PROFILE = """
modules:
  follows: {class: "zoo.modules:Ticker", start_deadline_s: 0.1, restart: {policy: never}}
  source: {class: "zoo.modules:LateSource", start_deadline_s: 100.0, stop_grace_s: 0.1}
clock: {source: source}
"""


def test_module_waiting_for_the_time_is_not_hung_and_stops_at_once(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    waits = "waiting for source to set the run's time"
    robot.until(lambda modules: modules["follows"]["status"] == waits)
    since_s = time.monotonic()
    wait_until(lambda: time.monotonic() > since_s + 0.5)
    process.terminate()
    ended = Ended.wait_for(process)
    assert ended.exit_code == 1, ended.stderr  # the module never came up
    follows = ended.modules["follows"]
    assert (follows["state"], follows["reason"]) == ("STOPPED", "killed by SIGTERM")
