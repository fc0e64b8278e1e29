"""Keys do not drive while a menu has the focus, and the map has it while something is placed there."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  known: {class: "zoo.known_robot:KnownRobot"}
"""
DRIVING_KEYS = ("KeyW", "KeyA", "ArrowUp", "ArrowDown")
IN_MENU = "document.querySelector('#map-drawings')?.contains(document.activeElement)"
COUNT = """() => {
  window.driven = 0;
  const count = ({ detail: { linear, angular } }) => (window.driven += linear || angular ? 1 : 0);
  addEventListener("robbie-driven", count);
}"""
"""Counts how often the page asks for motion."""


def test_keys_do_not_drive_in_a_menu_and_the_map_has_the_focus_while_one_places(robot: Robot) -> None:
    known = Path(__file__).parent / "_support" / "known_robot.py"
    (robot.folder / "zoo" / "known_robot.py").write_text(known.read_text())
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector("#layouts:has-text('Playback')")  # because a log plays
        page.keyboard.press("4")  # Tablet has the pad and the map, and no 3-D view that takes both processors
        page.wait_for_selector("#drive-pad")
        page.evaluate(COUNT)
        page.click("#map-draw")
        keys_in_the_menu_do_not_drive(page)
        page.click("#map-draw-place")
        map_has_the_focus_while_one_places(page, "place")
        page.click("#map-mode >> text=Set goal")
        map_has_the_focus_while_one_places(page, "goal")
        page.keyboard.down("KeyW")  # which shows that keys drive, and are counted
        page.wait_for_function("window.driven > 0")
        page.keyboard.up("KeyW")


def keys_in_the_menu_do_not_drive(page: Page) -> None:
    page.wait_for_function(IN_MENU)
    for key in DRIVING_KEYS:
        page.keyboard.down(key)
        page.keyboard.up(key)
    assert page.evaluate(IN_MENU)
    assert page.evaluate("window.driven") == 0


def map_has_the_focus_while_one_places(page: Page, what: str) -> None:
    page.wait_for_selector(f"#map-view[data-placing={what}]")
    page.wait_for_function("document.activeElement.id == 'map-view'")
