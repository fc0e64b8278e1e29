"""A text that no other process could read is a module's own affair, and ends nobody."""

import pytest

from tests._support.robot import Robot

pytestmark = pytest.mark.slow

PROFILE = """
modules:
  odd: {class: zoo.modules:NotText, ends_run: true, restart: {policy: never}}
"""


def test_text_that_is_not_utf8_is_shown_escaped_and_ends_no_module(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    ended = robot.run()
    assert ended.exit_code == 0, robot.log("odd")
    odd = ended.modules["odd"]
    assert odd["status"] == "reads m\\udcfcll.txt"
    log = robot.log("odd")
    for line in ("logs m\\udcfcll.txt", "by another name", "prints m\\udcfcll.txt"):
        assert line in log


def test_topic_that_is_not_utf8_is_refused_by_name(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    ended = robot.run("--set", "odd.topic=true")
    assert ended.exit_code == 1
    said = r"InvalidTopic: 'm\udcfcll.txt' is no name of a topic"
    assert said in robot.log("odd")
