"""The emergency stop on the page is always reachable, and its shown state is never wrong."""

import os
import signal
from pathlib import Path

import pytest
from playwright.sync_api import FloatRect, Page

from tests._support.robot import Robot, kill
from tests.station._support.browser import (
    IS_CONNECTED,
    LAPTOP,
    RECONNECTING,
    TABLET,
    browser,
    dialog_is_gone,
    needs_chromium,
    page_of,
    press_until,
    release,
)
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.every_turn, pytest.mark.alone]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, tabs: {system: Processes, drive: ""}}
  base: {class: "zoo.deaf_base:DeafBase"}
"""
STATE = "#emergency-stop-state"
WHAT_IS_AT = """([x, y]) => {
  const found = document.elementFromPoint(x, y).closest('button, [id]');
  return found.closest('#emergency-stop, #release-emergency-stop')?.id ?? found.id;
}"""
HAS_FOCUS_IN_DIALOG = "document.activeElement.closest('.q-dialog') !== null"


def test_emergency_stop_is_always_reachable_and_no_press_is_lost(robot: Robot) -> None:
    (robot.folder / "zoo" / "deaf_base.py").write_text((HERE / "_support" / "deaf_base.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address, may_say=RECONNECTING) as page:
        page.wait_for_selector(f"{STATE}:text-is('ready')")
        page.wait_for_function(IS_CONNECTED)
        request_that_the_base_misses_is_repeated_until_it_is_confirmed(page, robot)
        button_is_in_one_place_whatever_the_state(page)
        button_is_there_on_a_tablet(page)
        escape_closes_an_open_menu_and_then_stops_the_robot(page, robot)
        first_press_stops_the_robot_while_a_dialog_is_open(page, robot)
        silent_base_is_grey_with_its_age_and_gets_the_stop_when_it_is_back(page, robot)
        press_while_the_server_stands_still_is_kept_and_delivered(page, robot)
        press_just_before_the_server_is_killed_reaches_the_base(page, robot)
        press_while_there_is_no_server_outlives_the_loading_of_the_page(page, robot)


def box_of(page: Page, selector: str) -> FloatRect:
    box = page.locator(selector).bounding_box()
    assert box, f"{selector} is not to be seen"
    return box


def press(page: Page, box: FloatRect) -> None:
    """Press the mouse where the middle of the emergency stop was, whatever else may be there now."""
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def is_stopped(page: Page, robot: Robot) -> None:
    """The page and the base itself say that it stands."""
    page.wait_for_selector(f"{STATE}:text-is('STOPPED')")
    robot.until(lambda modules: modules["base"]["status"].startswith("STOPPED"))


def server(robot: Robot) -> int:
    return int(robot.top()["operator"]["pid"])


def order(robot: Robot, action: str, module: str) -> None:
    done = robot.command("module", action, module, "--run", robot.known_run().run_id)
    assert done.returncode == 0, done.stderr


def request_that_the_base_misses_is_repeated_until_it_is_confirmed(page: Page, robot: Robot) -> None:
    page.keyboard.press("Escape")
    is_stopped(page, robot)
    assert robot.top()["base"]["status"] == "STOPPED, missed 3"
    release(page)


def button_is_in_one_place_whatever_the_state(page: Page) -> None:
    box, tabs = box_of(page, "#emergency-stop"), box_of(page, "#tab-system")
    press(page, box)
    page.wait_for_selector(f"{STATE}:text-is('STOPPED')")
    assert box_of(page, "#emergency-stop") == box
    assert box_of(page, "#tab-system") == tabs
    for x in (0.02, 0.5, 0.98):
        for y in (0.05, 0.5, 0.95):
            place = [box["x"] + x * box["width"], box["y"] + y * box["height"]]
            assert page.evaluate(WHAT_IS_AT, place) == "emergency-stop"
    press_until(page, "#release-emergency-stop", "#confirm-release")
    for other in (box_of(page, "#release-emergency-stop"), box_of(page, "#confirm-release")):
        assert other["x"] > box["x"] + box["width"] or other["y"] > box["y"] + box["height"]
    page.click("text=Keep it stopped")
    dialog_is_gone(page)
    release(page)
    assert box_of(page, "#emergency-stop") == box


def button_is_there_on_a_tablet(page: Page) -> None:
    page.set_viewport_size(TABLET["viewport"])
    button_is_in_one_place_whatever_the_state(page)
    page.set_viewport_size(LAPTOP["viewport"])


def escape_closes_an_open_menu_and_then_stops_the_robot(page: Page, robot: Robot) -> None:
    press_until(page, "#layouts", "#layouts-menu")
    page.keyboard.press("Escape")
    page.wait_for_selector("#layouts-menu", state="detached")
    assert page.inner_text(STATE) == "ready"
    page.keyboard.press("Escape")
    is_stopped(page, robot)
    release(page)
    press_until(page, "#layouts", "#layouts-menu")
    # The whole menu is kept from the key, as if it hung.
    page.evaluate(
        "addEventListener('keydown', (event) => event.stopImmediatePropagation(), { capture: true })"
    )
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    is_stopped(page, robot)
    page.reload()
    page.wait_for_selector(f"{STATE}:text-is('STOPPED')")
    page.wait_for_function(IS_CONNECTED)
    release(page)


def first_press_stops_the_robot_while_a_dialog_is_open(page: Page, robot: Robot) -> None:
    box = box_of(page, "#emergency-stop")
    open_dialog(page)
    press(page, box)
    is_stopped(page, robot)
    assert page.is_visible("#confirm-order"), "the press has answered the dialog, too"
    page.click(".q-dialog >> text='No'")
    release(page)
    open_dialog(page)
    page.keyboard.press("Escape")
    is_stopped(page, robot)
    release(page)


def open_dialog(page: Page) -> None:
    """Have the page ask something."""
    page.wait_for_function(IS_CONNECTED)
    row = page.locator("#panel-system tr:has(td:text-is('base'))")
    if row.locator(".q-checkbox[aria-checked=true]").count() == 0:
        row.locator(".q-checkbox").click()
    press_until(page, "#order-restart", "#confirm-order")
    page.wait_for_function(HAS_FOCUS_IN_DIALOG)


def silent_base_is_grey_with_its_age_and_gets_the_stop_when_it_is_back(page: Page, robot: Robot) -> None:
    order(robot, "stop", "base")
    page.wait_for_selector(f"{STATE}:text-is('base silent')")
    page.wait_for_selector("#emergency-stop-detail:text-matches('^for [0-9]+ s')")
    page.keyboard.press("Escape")
    page.wait_for_selector(f"{STATE}:text-is('NOT CONFIRMED')")
    page.wait_for_selector("#emergency-stop-detail:has-text('the base does not answer')")
    order(robot, "start", "base")
    is_stopped(page, robot)
    release(page)


def press_while_the_server_stands_still_is_kept_and_delivered(page: Page, robot: Robot) -> None:
    stopped = server(robot)
    os.kill(stopped, signal.SIGSTOP)
    try:
        page.wait_for_selector("#link-lost:has-text('No connection to the robot')")
        assert page.inner_text(STATE) == "no link"
        page.keyboard.press("Escape")
        page.wait_for_selector(f"{STATE}:text-is('NOT DELIVERED')")
        page.wait_for_selector("#emergency-stop-detail:has-text('sent first')")
    finally:
        os.kill(stopped, signal.SIGCONT)
    is_stopped(page, robot)
    page.wait_for_selector("#link-lost", state="hidden")
    release(page)


def press_just_before_the_server_is_killed_reaches_the_base(page: Page, robot: Robot) -> None:
    page.evaluate("window.is_the_old_page = true")
    killed = server(robot)
    os.kill(killed, signal.SIGSTOP)
    page.keyboard.press("Escape")
    kill(killed)
    is_stopped(page, robot)
    page.wait_for_function("window.is_the_old_page === undefined")
    release(page)


def press_while_there_is_no_server_outlives_the_loading_of_the_page(page: Page, robot: Robot) -> None:
    page.evaluate("window.is_the_old_page = true")
    order(robot, "stop", "operator")
    page.wait_for_selector("#link-lost:has-text('No connection to the robot')")
    page.evaluate("location.reload()")  # as NiceGUI does after a while
    page.keyboard.press("Escape")
    page.wait_for_selector(f"{STATE}:text-is('NOT DELIVERED')")
    page.wait_for_selector("#emergency-stop-detail:has-text('pressed 2 s ago')")
    assert page.evaluate("window.is_the_old_page"), "the page was given up, and there is no other"
    order(robot, "start", "operator")
    page.wait_for_function("window.is_the_old_page === undefined")
    is_stopped(page, robot)
    release(page)
