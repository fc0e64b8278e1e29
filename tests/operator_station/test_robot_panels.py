"""What 3-D view, plots, parameters and the table of processes show is so, and what is pressed happens."""

from pathlib import Path

import pytest

from tests.operator_station.browser import browser, needs_chromium, page_of
from tests.operator_station.test_page import address_of
from tests.run.robot import Robot

pytestmark = [needs_chromium, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.services.operator_station:OperatorStation
    settings: {port: 0}
  stage: {class: "zoo.stage:Stage"}
"""
POSITION = """() => {
  const scene = Object.entries(window).find(([name]) => name.startsWith("scene_"))[1];
  const found = scene.getObjectByName("NAME");
  if (!found) return "";
  return found.getWorldPosition(found.position.clone()).toArray().map((x) => x.toFixed(2)).join();
}"""


def test_panels_show_the_robot_and_change_it(robot: Robot) -> None:
    (robot.folder / "zoo" / "stage.py").write_text((HERE / "stage.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page:
        page.click("#tab-view")
        # Two of the scan's rays hit something; the cloud has five points.
        page.wait_for_selector("#view-figures:text-is('robot at 1.50 m, -0.50 m, 0°; 7 points, 1 victims')")
        for name, place in (("base_link", "1.50,-0.50,0.00"), ("laser", "1.70,-0.50,0.10")):
            page.wait_for_function(f"({POSITION.replace('NAME', name)})() === '{place}'")
        page.click("#view-names")
        page.wait_for_selector("#view-scene >> text=laser")
