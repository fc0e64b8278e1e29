"""The end of a real mission keeps the run: its operator drives by hand, and starts another mission."""

import pytest

from robbie_mp.run.operator_link import read_link
from tests._support.robot import Robot
from tests.station._support.browser import browser, needs_chromium, page_of, press_until

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
SMALL = "robbie:hw/simulation/arenas/rescue_small.yaml"
PROFILE = f"""
parents: [robbie:rescue]
modules:
  operator: {{settings: {{port: 0}}}}
  base: {{settings: {{arena: {SMALL}}}}}
  laser: {{settings: {{arena: {SMALL}}}}}
  camera: {{settings: {{arena: {SMALL}}}}}
  battery: {{settings: {{arena: {SMALL}}}}}
  rear_camera: null
"""


def test_end_of_a_mission_keeps_the_run_for_manual_drive_and_another_mission(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    run = robot.start()
    robot.until(lambda modules: "http://" in modules["operator"]["status"])
    with browser() as started, page_of(started, read_link(robot.known_run().folder)) as page:
        press_until(page, "#tab-mission", "#mission-abort:enabled")
        press_until(page, "#mission-abort", "#confirm-abort")
        page.click("#confirm-abort")
        page.wait_for_selector("#mission-results h2:has-text('The mission was aborted')")
        with page.expect_download() as report:
            page.click("#mission-results a:text-is('rescue_map.png')")
        assert report.value.path().read_bytes().startswith(b"\x89PNG")
        page.click("#close-results")
        page.click("#tab-drive")
        page.wait_for_selector("#drive-pad")  # a key that is pressed before does not drive
        page.keyboard.down("KeyS")
        page.wait_for_selector("#control-who:text-is('you drive')")
        page.keyboard.up("KeyS")
        page.wait_for_selector("#control-mode:has-text('HOLD')")
        page.keyboard.press("g")
        page.wait_for_selector("#control-mode:has-text('AUTO')")
        page.wait_for_selector("#state-mission:not(:has-text('ABORTED'))")
        assert run.poll() is None
    assert robot.top()["mission"]["state"] == "RUNNING"
