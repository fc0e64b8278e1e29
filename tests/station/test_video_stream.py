"""Over https and on the robot's machine, the picture to drive by is a stream of H.264; JPEG is there when it fails."""

import statistics
import time

import pytest
from playwright.sync_api import Browser, Page

from tests._support.robot import Robot, wait_until
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(200)]
STREAMS = "document.querySelector('.camera-picture canvas')?.checkVisibility()"


def test_dbg(robot: Robot) -> None:
    robot.write_profile("""
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  camera: {class: "tools.operator.moving_camera:MovingCamera"}
""")
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector(".camera-picture .picture-age")
        t = time.monotonic()
        page.wait_for_function(STREAMS)
        print(time.monotonic() - t)
        page.wait_for_timeout(3000)
        print(page.evaluate("[...document.querySelectorAll('.camera-picture canvas')].map(c=>[c.width,c.height])"))
        page.screenshot(path="/tmp/video/shot.png")
        print(robot.top()["operator"]["status"])
