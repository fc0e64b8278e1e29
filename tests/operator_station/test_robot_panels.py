"""What 3-D view, plots, parameters and the table of processes show is so, and what is pressed happens."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

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


def set_to(page: Page, value: str, error: str) -> None:
    """Ask for a value, and see the error that stands beside the field then."""
    page.fill("#input-stage-x_m", value)
    page.click("#set-stage-x_m")
    if error:
        page.wait_for_selector(f".q-field:has(#input-stage-x_m) [role=alert]:has-text('{error}')")
    else:
        page.wait_for_selector(".q-field:has(#input-stage-x_m) [role=alert]", state="detached")


def plot(page: Page, messages: str, path: str) -> None:
    """Choose a number."""
    page.fill("#plot-channel", messages)
    page.fill("#plot-field", path)
    page.click("#plot-add")


def view_shows_what_there_is(page: Page) -> None:
    page.click("#tab-view")
    # Two of the scan's rays hit something; the cloud has five points.
    page.wait_for_selector("#view-figures:text-is('robot at 1.50 m, -0.50 m, 0°; 7 points, 1 victims')")
    for name, place in (("base_link", "1.50,-0.50,0.00"), ("laser", "1.70,-0.50,0.10")):
        page.wait_for_function(f"({POSITION.replace('NAME', name)})() === '{place}'")
    page.click("#view-names")
    page.wait_for_selector("#view-scene >> text=laser")


def parameters_are_changed_and_wrong_ones_refused(page: Page, robot: Robot) -> None:
    page.click("#tab-parameters")
    page.wait_for_selector("#value-stage-x_m:text-is('x_m: 1.5')")
    set_to(page, "9.0", "at most 5")
    set_to(page, "'no number'", "number")
    set_to(page, "3.0", "there is a hole at 3 m")
    assert robot.top()["stage"]["status"] == "stands at 1.5 m; red"
    set_to(page, "2.5", "")
    page.wait_for_selector("#value-stage-x_m:text-is('x_m: 2.5 (changed)')")
    robot.until(lambda modules: modules["stage"]["status"] == "stands at 2.5 m; red")
    page.click("#tab-view")
    page.wait_for_selector("#view-figures:has-text('robot at 2.50 m')")


def plots_draw_chosen_numbers(page: Page) -> None:
    page.click("#tab-plots")
    page.wait_for_selector("#plot-channel-offered option[value^=odom]", state="attached")
    plot(page, "odom: nav_msgs/Odometry", "pose.pose.position.x")
    page.wait_for_selector("#plot-lines:has-text('odom.pose.pose.position.x: 2.5')")
    plot(page, "(no topic): sensor_msgs/LaserScan", "ranges[3]")
    page.wait_for_selector("#plot-lines:has-text('LaserScan.ranges[3]: 3')")
    page.wait_for_selector("#panel-plots svg text:has-text('LaserScan.ranges[3]')")
    plot(page, "(no topic): sensor_msgs/LaserScan", "rangers[3]")
    page.wait_for_selector("#panel-plots [role=alert]:has-text(\"did you mean 'ranges'\")")
    page.click("#plot-lines [aria-label=remove] >> nth=0")
    page.wait_for_selector("#plot-lines:has-text('odom')", state="detached")
    page.wait_for_selector("#panel-plots svg text:text-is('3')")


def system_shows_processes_and_restarts_and_stops_them(page: Page, robot: Robot) -> None:
    page.click("#tab-system")
    page.wait_for_selector("#panel-system td:has-text('stands at 2.5 m; red')")
    page.wait_for_selector("#panel-system .nicegui-echart text:text-is('cpu 0')")
    page.click("#panel-system th:has-text('pid')")
    pids = sorted(figures["pid"] for figures in robot.top().values())
    in_order = ".*".join(rf"\b{pid}\b" for pid in pids)
    page.wait_for_function(
        "order => RegExp(order, 's').test(document.querySelector('#panel-system tbody').innerText)",
        arg=in_order,
    )
    pid = robot.top()["stage"]["pid"]
    page.click("#panel-system tr:has(td:text-is('stage')) .q-checkbox")
    page.click("#order-restart")
    page.click("text='No'")
    page.click("#order-restart")
    page.click("#confirm-order")
    page.wait_for_selector(".q-notification:has-text('stage')")
    assert robot.top()["stage"]["pid"] != pid
    page.click("#order-stop")
    page.click("#confirm-order")
    page.wait_for_selector("#panel-system tr:has(td:text-is('stage')) td:text-is('STOPPED')")


def test_panels_show_the_robot_and_change_it(robot: Robot) -> None:
    (robot.folder / "zoo" / "stage.py").write_text((HERE / "stage.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page:
        view_shows_what_there_is(page)
        parameters_are_changed_and_wrong_ones_refused(page, robot)
        plots_draw_chosen_numbers(page)
        system_shows_processes_and_restarts_and_stops_them(page, robot)
