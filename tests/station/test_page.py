"""The page in a real browser shows the true state, and its buttons work."""

import signal

import pytest
from playwright.sync_api import Page

from robbie_mp.run.operator_link import read_link
from tests._support.robot import Ended, Robot
from tests.station._support.browser import browser, dialog_is_gone, needs_chromium, page_of, release

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.every_turn, pytest.mark.timeout(180)]
LOST = (
    "Failed to load resource: net::ERR_FAILED",
    "Quasar is not defined",
    "Vue is not defined",
    "Cannot destructure property 'h' of 'window.Vue'",
    "Cannot read properties of undefined",
)
"""Begins what a browser says of a script that it could not load."""
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, tabs: {system: Processes, drive: ""}}
  base: {class: "zoo.modules:StandingBase"}
"""


def address_of(robot: Robot) -> str:
    """The link with which the user of the robot opens the page."""
    robot.until(lambda modules: "http://" in modules["operator"]["status"])
    return read_link(robot.known_run().folder)


def titles_of(page: Page) -> list[str]:
    """The titles of the panels that a page can show."""
    return [one.get_attribute("title") or "" for one in page.locator("#panels [id^=tab-]").all()]


def each_lost_script_is_loaded_again(page: Page) -> None:
    """The browser itself does not try again: without one of its scripts, the page would stay empty."""
    for script in ("**/static/quasar.umd*.js", "**/static/vue*.js"):
        page.route(script, lambda route: route.abort(), times=1)
        with page.expect_event("requestfailed"):
            page.reload()
        page.wait_for_selector("#emergency-stop")


def test_page_shows_the_processes_and_the_emergency_stop_reaches_the_base_and_latches(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address, may_say=LOST) as page:
        each_lost_script_is_loaded_again(page)
        page.wait_for_selector("#panel-system td:has-text('StandingBase is ready')")  # the first tab
        assert titles_of(page) == ["Processes", "Drive"]
        for name in ("supervisor", "operator", "base", "core"):
            page.wait_for_selector(f"#panel-system td:text-is('{name}')")
        assert page.inner_text("#role") == "operator"
        page.wait_for_selector("#emergency-stop-state:has-text('ready')")

        page.keyboard.press("Escape")
        page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
        assert robot.top()["base"]["status"].startswith("STOPPED: stopped by hand")
        page.click("#release-emergency-stop")
        page.click("text=Keep it stopped")
        dialog_is_gone(page)
        page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
        release(page, lambda page, button: page.press(button, "Enter"))
        page.focus("#emergency-stop")
        page.keyboard.press("Enter")
        page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
        release(page)
        # On the press, not on the release.
        page.hover("#emergency-stop")
        page.mouse.down()
        page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
    ended = Ended.in_order(process, signal.SIGTERM)
    assert ended.modules["operator"]["state"] == "STOPPED"
    assert "SIGKILL" not in ended.stderr
