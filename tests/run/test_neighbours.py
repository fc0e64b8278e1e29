"""With the defaults, a stopped or hoarding subscriber costs the others no messages."""

import os
import signal
from typing import Any

import psutil
import pytest

from tests._support.robot import Robot, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.alone]

MODULES = '''
from collections import deque

import numpy as np

from robbie_mp.messages import Image
from robbie_mp import Module, setting


class Camera(Module):
    """Publishes images of 6.2 MB, and says how many there were, whether or not there was room for them."""

    period_s = 1 / 30

    def setup(self):
        self.image = Image(height=1080, width=1920, step=3 * 1920, data=np.zeros(1080 * 1920 * 3, np.uint8))
        self.taken = 0

    def tick(self):
        self.taken += 1
        self.publish(self.image)
        self.status = f"{self.taken} images"


class Viewer(Module):
    """Looks at images, and may keep the last ones."""

    keep: int = setting(0, "images to keep")

    def setup(self):
        self.kept = deque(maxlen=self.keep)
        self.subscribe(Image, self.on_image)

    def on_image(self, image):
        self.kept.append(image.data)
'''
PROFILE = """
modules:
  viewer: {class: "zoo.camera:Viewer"}
  idle: {class: "zoo.camera:Viewer"}
  hoarder: {class: "zoo.camera:Viewer", settings: {keep: %d}}
  camera: {class: "zoo.camera:Camera"}
"""
IMAGES = 120
"""Almost three times the capacity of the camera's memory, taken before a module is restarted as hung."""


def taken(figures: dict[str, Any]) -> int:
    return int(figures["camera"]["status"].split()[0] or 0)


@pytest.mark.parametrize(("what", "keep"), [("stopped", 0), ("hoarder", 60)])
def test_healthy_viewer_keeps_its_rate(robot: Robot, what: str, keep: int) -> None:
    (robot.folder / "zoo" / "camera.py").write_text(MODULES)
    robot.write_profile(PROFILE % keep)
    robot.start()
    before = robot.until(lambda modules: modules["viewer"]["handled"] > 5)
    if what == "stopped":
        pid = before["idle"]["pid"]
        os.kill(pid, signal.SIGSTOP)
        wait_until(lambda: psutil.Process(pid).status() == psutil.STATUS_STOPPED)
    after = robot.until(lambda modules: taken(modules) >= taken(before) + IMAGES)
    seen = after["viewer"]["handled"] - before["viewer"]["handled"]
    assert seen >= 0.9 * (taken(after) - taken(before)), f"{seen} seen; {after['camera']}"
    assert after["camera"]["refused"] == 0
