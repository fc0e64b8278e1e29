"""What a user sees of a crash: the first traceback whole and without our frames, then one line each time."""

import pytest

from robbie_mp.cli.screen import ordinal
from tests._support.robot import Robot

MODULES = """
import serial
from robbie_mp import Module
from robbie_mp.messages import DriveCommand


class Divides(Module):
    period_s = 0.01

    def tick(self):
        self.divide(0)

    def divide(self, number):
        return 1 / number


class Plugs(Module):
    def setup(self):
        serial.Serial("/dev/ttyNone")


class Misspells(Module):
    period_s = 0.01

    def tick(self):
        self.publish(DriveCommand(linear_m_per_s="fast"))
"""


CHANGES_AN_ARRAY = """
import numpy as np
from robbie_mp import Module
from robbie_mp.messages import LaserScan

class Changes(Module):
    period_s = 0.01

    def setup(self):
        self.subscribe(LaserScan, self.on_scan)

    def tick(self):
        self.publish(LaserScan(ranges=np.ones(3, np.float32)))

    def on_scan(self, scan):
        scan.ranges[0] = 2.0
"""
NEVER = "restart: {policy: never}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("written", "instead", "advice"),
    [
        ("scan.ranges[0]", "scan.ranges[0]", "read-only; all subscribers share the arrays of a message"),
        ("scan.ranges[0] = 2.0", "input()", "EOF when reading a line; a module has no terminal"),
        ("scan.ranges[0] = 2.0", "scan.rangse", "has no attribute 'rangse'; did you mean 'ranges'"),
        (
            "scan.ranges[0] = 2.0",
            "self.publish_(scan)",
            "has no attribute 'publish_'; did you mean 'publish'",
        ),
    ],
)
def test_mistake_that_python_does_not_explain_comes_with_advice(
    robot: Robot, written: str, instead: str, advice: str
) -> None:
    (robot.folder / "wrong.py").write_text(CHANGES_AN_ARRAY.replace(written, instead))
    robot.write_profile(f"modules: {{one: {{class: 'wrong:Changes', essential: true, {NEVER}}}}}")
    assert advice in robot.command("run", "robot").stderr


@pytest.mark.sampled(2)
@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--quiet",)], ids=["all", "quiet"])
@pytest.mark.parametrize(
    ("name", "error", "frames"),
    [
        ("Divides", "ZeroDivisionError", 2),
        ("Misspells", "FieldTypeError", 1),
        ("Plugs", "SerialException", 1),
    ],
)
def test_same_crash_is_one_traceback_and_then_a_line_each_time(
    robot: Robot, options: tuple[str, ...], name: str, error: str, frames: int
) -> None:
    (robot.folder / "wrong.py").write_text(MODULES)
    restart = "restart: {max_restarts: 3}"
    robot.write_profile(f"modules: {{one: {{class: 'wrong:{name}', essential: true, {restart}}}}}")
    ended = robot.command("run", "robot", *options)
    assert ended.returncode == 1
    assert ended.stderr.count("Traceback (most recent call last)") == 1, ended.stderr
    assert ended.stderr.count('  File "') == ended.stderr.count("wrong.py") == frames
    assert [f"again, {nth} time" in ended.stderr for nth in ("2nd", "3rd", "4th", "5th")] == [True] * 3 + [
        False
    ]
    assert ended.stderr.count(error) >= 1


def test_ordinals_are_those_of_english() -> None:
    numbers = (1, 2, 3, 4, 10, 11, 12, 13, 21, 102, 111)
    assert [ordinal(number) for number in numbers] == (
        ["1st", "2nd", "3rd", "4th", "10th", "11th", "12th", "13th", "21st", "102nd", "111th"]
    )
