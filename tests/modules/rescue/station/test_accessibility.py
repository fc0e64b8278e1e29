"""In a real browser, axe-core finds no serious fault on any layout, panel, menu or dialog, dark or light."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

import robbie_mp.station
import robbie_robots
from robbie_mp.station.page.layouts import default_layouts
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Robot, robot_in
from tests.station._support.accessibility import CONTRAST, Walk, let_check, scripted_popups, serious_faults
from tests.station._support.browser import (
    begin_drawing,
    browser,
    choose_layout,
    needs_chromium,
    open_panel,
    page_of,
    release,
)
from tests.station.test_driving import ARENA
from tests.station.test_page import address_of
from tests.station.test_panels import log_in

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(600)]
ROOT = Path(__file__).parents[4]
MODULES = {
    "known_robot": Path("tests/station/_support/known_robot.py"),
    "rescuer": Path("tests/modules/rescue/station/_support/rescuer.py"),
}
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
      panels: ["robbie_robots.modules.rescue.station.mission_panel:MissionPanel"]
      poses: {wave: {wrist: 0.5}}
      speech_commands: [come here]
      persons: [Anna]
      objects: [cup]
  known: {class: "zoo.known_robot:KnownRobot"}
  fragile: {class: "zoo.known_robot:Fragile"}
  rescuer: {class: "zoo.rescuer:Rescuer"}
  link: {class: "robbie_mp.connect.link.module:Link", settings: {robot: red, listen: [], prefix_topics: true}}
  base: {class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {arena: arena.yaml}}
  battery:
    class: robbie_robots.modules.devices.battery:SimulatedBatteryModule
    settings: {arena: arena.yaml}
  bumper:
    class: robbie_robots.modules.devices.bumper:SimulatedBumperModule
    settings: {arena: arena.yaml}
  laser:
    class: robbie_robots.modules.devices.laser:SimulatedLaserRangeFinder
    settings: {arena: arena.yaml}
  lamps: {class: "robbie_robots.modules.devices.lights:SimulatedLightsModule"}
  arm:
    class: robbie_robots.modules.devices.joints:SimulatedJointsModule
    settings: {names: [wrist, gripper], period_s: 0.1}
black_box: {before_s: 2, after_s: 0}
"""
AS_TEXT = """() => {
  const range = document.createRange();
  return [...document.querySelectorAll(".material-icons, .q-icon")].filter((one) => {
    range.selectNodeContents(one);
    return range.getBoundingClientRect().width > 1.2 * parseFloat(getComputedStyle(one).fontSize);
  }).map((one) => one.textContent);
}"""
FILES = "() => performance.getEntriesByType('resource').map((one) => one.name)"
LARGE = re.compile(r"tailwindcss|\.woff2")
"""What our own panels do not need: all icons, and the compiler of styles."""
REFUSED = ("Failed to load resource: the server responded with a status of 403",)
"""What a browser says of a wrong token."""
OF_SCRIPTS = (Path(robbie_mp.station.__file__).parent, Path(robbie_robots.__file__).parent / "modules")


@pytest.fixture(autouse=True, scope="module")
def nothing_left_behind() -> Iterator[None]:
    """Check once, after all tests, which share a robot and a browser."""
    with leaving_nothing_behind():
        yield


@pytest.fixture(scope="module")
def started(nothing_left_behind: None) -> Iterator[Browser]:
    """The browser of all tests."""
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def known(nothing_left_behind: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot that fills every panel."""
    with robot_in(tmp_path_factory.mktemp("known")) as robot:
        start(robot)
        yield robot


def start(robot: Robot) -> None:
    for name, file in MODULES.items():
        (robot.folder / "zoo" / f"{name}.py").write_text((ROOT / file).read_text())
    robot.write_secret("operator.token", "opens-everything")
    robot.write_secret("observer.token", "opens-all-our-eyes")
    (robot.folder / "arena.yaml").write_text(ARENA)
    robot.write_profile(PROFILE, has_black_box=True)
    robot.start()


def test_no_layout_has_a_serious_fault_of_accessibility_in_either_look(
    known: Robot, started: Browser
) -> None:
    with page_of(started, address_of(known)) as page:
        let_check(page)
        log_in(page, "opens-everything")
        page.wait_for_selector("#state-time")
        found = [f"dark, {fault}" for fault in faults_of_all_layouts(page, {})]
        page.click("#look")
        page.wait_for_selector("body.body--light")
        found += [f"light, {fault}" for fault in faults_of_all_layouts(page, CONTRAST)]
        assert not found, "\n".join(found)
        assert not [file for file in page.evaluate(FILES) if LARGE.search(file)]
        page.reload()
        page.wait_for_selector("body.body--light")  # the browser has kept it


@pytest.mark.parametrize("look", ["dark", "light"])
def test_no_panel_menu_or_dialog_has_a_serious_fault(known: Robot, started: Browser, look: str) -> None:
    with page_of(started, address_of(known), may_say=REFUSED) as page:
        let_check(page)
        page.goto(f"{page.url.rpartition('/')[0]}/login")
        options: dict[str, Any] = {} if look == "dark" else CONTRAST
        found = [f"the login, {fault}" for fault in serious_faults(page, {})]
        log_in(page, "opens-nothing")
        page.wait_for_selector(".error:has-text('token')")
        found += [f"the refusal, {fault}" for fault in serious_faults(page, {})]
        log_in(page, "opens-everything")
        page.wait_for_selector("#state-time")
        if look == "light":
            page.click("#look")
            page.wait_for_selector("body.body--light")
        known.command("module", "restart", "fragile")
        page.click("#mark")
        walk = Walk(page, options)
        found += [
            *walk.faults(),
            *faults_while_one_draws(page, options),
            *faults_while_stopped(page, options),
        ]
        assert not found, "\n".join(found)
        assert scripted_popups(OF_SCRIPTS) <= walk.seen


def test_an_observers_page_has_no_serious_fault(known: Robot, started: Browser) -> None:
    with page_of(started, address_of(known)) as page:
        let_check(page)
        log_in(page, "opens-all-our-eyes")
        page.wait_for_selector("#role:text-is('observer')")
        found = [*Walk(page, {}).faults()]
        assert not found, "\n".join(found)


def faults_while_one_draws(page: Page, options: dict[str, Any]) -> Iterator[str]:
    """Check the map while a place is pressed, and the card that asks for its name."""
    open_panel(page, "map")
    begin_drawing(page, "place")
    yield from (f"a place is drawn, {fault}" for fault in serious_faults(page, options, "#tile-map"))
    page.click("#map-view")
    page.wait_for_selector("#map-card-name")
    yield from (f"a place is named, {fault}" for fault in serious_faults(page, options, "#tile-map"))
    page.click("#map-card-close")


def faults_while_stopped(page: Page, options: dict[str, Any]) -> Iterator[str]:
    """Check the page of a robot that was stopped."""
    page.click("#emergency-stop")
    page.wait_for_selector("#emergency-stop-state:text-is('STOPPED')")
    yield from (f"stopped, {fault}" for fault in serious_faults(page, options))
    release(page)


def drawn_as_text(page: Page) -> list[str]:
    """Return each icon that is wider than one sign, because no font has it."""
    found: list[str] = page.evaluate(AS_TEXT)
    return found


def faults_of_all_layouts(page: Page, options: dict[str, Any]) -> list[str]:
    layouts = [*default_layouts([*FRAMEWORK_PANELS, "mission"], ["mission"])]
    assert layouts == ["Drive", "Mission", "Engineer", "Tablet", "Playback"]
    found: list[str] = []
    for number, layout in enumerate(layouts, 1):
        choose_layout(page, number, layout)
        found += [f"{layout}: {fault}" for fault in serious_faults(page, options)]
        found += [
            f"{layout}: the icon {icon} is not in the page's first file" for icon in drawn_as_text(page)
        ]
    return found
