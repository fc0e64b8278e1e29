"""A synchronizer in a live robot: what waits stays in shared memory, bounded, and a restart begins again."""

import pytest

from tests._support.robot import Robot, kill, wait_until

MODULES = '''
import numpy as np

from robbie_mp import Header, Input, Synchronizer, Time, setting
from robbie_mp.messages import Image, LaserScan
from zoo.modules import Journal


class Sensor(Journal):
    """Publishes numbered images, and a scan for each tenth."""

    period_s = 0.002
    scans: bool = setting(True, "publish scans at all")

    def setup(self):
        self.number = 0

    def tick(self):
        self.number += 1
        header = Header(stamp=Time.from_nanoseconds(self.number * 1000))
        self.publish(Image(header=header, data=np.full(100_000, self.number % 256, np.uint8)), topic="camera")
        if self.scans and self.number % 10 == 0:
            self.publish(LaserScan(header=header), topic="laser")


class Pairs(Journal):
    """Journals the number of each pair."""

    def setup(self):
        self.pairs = Synchronizer(
            self, Input(Image, "camera"), Input(LaserScan, "laser"), handler=self.on_pair
        )
        self.period_s = 0.05

    def on_pair(self, image, scan):
        number = image.header.stamp.nanoseconds // 1000
        assert number == scan.header.stamp.nanoseconds // 1000
        assert (image.data == number % 256).all(), "the image changed while it waited"
        self.note(number)

    def tick(self):
        self.status = str([count.waiting for count in self.pairs.counts])
'''
PROFILE = """
modules:
  pairs: {class: "zoo.pairs:Pairs"}
  sensor: {class: "zoo.pairs:Sensor", settings: {scans: SCANS}}
"""


def start(robot: Robot, scans: str) -> None:
    (robot.folder / "zoo" / "pairs.py").write_text(MODULES)
    robot.write_profile(PROFILE.replace("SCANS", scans))
    robot.start()


@pytest.mark.slow
def test_pairs_are_exact_and_go_on_after_a_crash(robot: Robot) -> None:
    start(robot, "true")
    wait_until(lambda: len(robot.journal("pairs")) > 10)
    kill(robot.top()["pairs"]["pid"])
    before = len(robot.journal("pairs"))
    wait_until(lambda: len(robot.journal("pairs")) > before + 10)
    numbers = robot.journal("pairs")
    assert numbers == sorted(set(numbers))
    assert all(number % 10 == 0 for number in numbers)


@pytest.mark.slow
def test_messages_that_wait_for_a_silent_topic_are_bounded(robot: Robot) -> None:
    start(robot, "false")
    robot.until(lambda modules: modules["pairs"]["handled"] > 300)
    figures = robot.until(lambda modules: modules["pairs"]["status"] == "[10, 0]")
    assert 0 < figures["pairs"]["pinned"] <= 10
    assert figures["sensor"]["refused"] == 0
    assert robot.journal("pairs") == []
