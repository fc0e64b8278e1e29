"""The rescue robot's panel: mission, victims (table, map, 3-D view) and the question; in a real browser."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot, wait_until
from tests.station._support.browser import RECONNECTING, TABLET, browser, needs_chromium, page_of
from tests.station.test_page import address_of
from tests.station.test_panels import FITS, log_in

pytestmark = [needs_chromium, pytest.mark.timeout(600)]
BUTTONS = ("#mission-start", "#mission-pause", "#mission-return", "#mission-abort")
MIN_TARGET_PX = 48
PLACES = """() => {
  const found = [...document.querySelectorAll(".tile, .mission-buttons button, #mission-states")];
  return found.map((one) => [one.id, ...Object.values(one.getBoundingClientRect().toJSON())].join());
}"""
SUPPORT = Path(__file__).parent / "_support"
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
      panels: ["robbie_robots.modules.rescue.station.mission_panel:MissionPanel"]
  rescuer: {class: "zoo.rescuer:Rescuer", ends_run: true}
"""


@pytest.mark.slow
def test_operator_answers_and_steers_the_mission_and_observers_cannot(robot: Robot) -> None:
    (robot.folder / "zoo" / "rescuer.py").write_text((SUPPORT / "rescuer.py").read_text())
    robot.write_secret("operator.token", "opens-everything")
    robot.write_secret("observer.token", "opens-all-our-eyes")
    robot.write_profile(PROFILE)
    run = robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address, may_say=RECONNECTING) as page:
        log_in(page, "opens-everything")
        answer_is_reached_by_keys(page)
        with page_of(started, address) as other:
            assert other.request.get(f"{address}pictures/victim/7").status == 401
            log_in(other, "opens-all-our-eyes")
            observer_sees_and_does_not_steer(other)
        victim_is_confirmed(page, robot)
        map_and_view_show_the_victim(page)
        mission_is_steered(page, robot)
        states_and_victims_are_listed(page)
        panel_fits(page)
        with page_of(started, address, TABLET) as tablet:
            log_in(tablet, "opens-everything")
            panel_fits(tablet)
        results_stay_when_the_run_ends(page, robot)
    assert run.wait(10) == 0


def heard(robot: Robot, line: str) -> None:
    """Wait until this is the last thing that the robot was told."""
    file = robot.output / "rescue.txt"
    wait_until(lambda: file.read_text().splitlines()[-1:] == [line])


def answer_is_reached_by_keys(page: Page) -> None:
    page.wait_for_selector("#victim-yes:enabled")
    found = False
    for _ in range(50):
        page.keyboard.press("Shift+Tab")  # the question lies below the tiles
        found |= page.evaluate("document.activeElement.closest('[id]')?.id") == "victim-yes"
    assert found


def observer_sees_and_does_not_steer(page: Page) -> None:
    page.wait_for_selector("#role:text-is('observer')")
    page.wait_for_selector("#victim-question:has-text('tag 7, at 4.00 m, 4.00 m')")
    page.click("#tab-mission")
    page.wait_for_selector("#mission-text:has-text('drives about')")
    assert not any(page.locator(button).count() for button in (*BUTTONS, "#victim-yes"))


def victim_is_confirmed(page: Page, robot: Robot) -> None:
    page.wait_for_selector("#victim-question:has-text('tag 7, at 4.00 m, 4.00 m')")
    page.wait_for_selector("#victim-time-left:has-text('s left to answer; 75% sure')")
    left_s = int(page.inner_text("#victim-time-left").split()[0])
    assert 600 < left_s <= 900
    page.wait_for_function("document.querySelector('#victim-question img').naturalWidth == 2")
    for button in ("#victim-yes", "#victim-no", "#victim-later", "#victim-undo"):
        assert is_large(page, button)
    places = page.evaluate(PLACES)
    page.click("#victim-yes")
    heard(robot, "answer 7 1")
    page.wait_for_selector("#victim-question", state="hidden")
    assert page.evaluate(PLACES) == places, "the tiles have moved with the question"


def map_and_view_show_the_victim(page: Page) -> None:
    page.click("#tab-map")
    page.wait_for_selector("#map-text:has-text('robot at 1.50 m, 3.25 m, 0°; 1 victims')")
    page.click("#tab-view")
    page.wait_for_selector("#view-figures:has-text('; 0 points, 1 victims, 0 points of interest')")
    page.wait_for_selector("#view-scene >> text=tag 7")


def mission_is_steered(page: Page, robot: Robot) -> None:
    page.click("#tab-mission")
    page.wait_for_selector("#mission-state:has-text('EXPLORE')")
    page.wait_for_selector("#state-mission:has-text('EXPLORE 1:01 / 10:00')")
    can_press(page, "#mission-pause")
    places = page.evaluate(PLACES)
    page.click("#mission-pause")
    heard(robot, "order 1")
    page.wait_for_selector("#mission-state:has-text('PAUSE')")
    page.wait_for_selector("#state-mission.is-warning:has-text('PAUSE 1:01 / 10:00')")
    can_press(page, "#mission-start", "#mission-return", "#mission-abort")
    assert page.evaluate(PLACES) == places, "the buttons have moved with the name of the state"
    assert all(is_large(page, button) for button in BUTTONS)
    assert page.inner_text("#mission-refusal") == ""
    page.keyboard.press("p")
    page.wait_for_selector(".q-notification:has-text('Pause does not fit the state of the mission')")
    page.keyboard.press("h")
    heard(robot, "order 3")
    page.wait_for_selector("#mission-refusal:has-text('the order was refused: no 3 today')")


def results_stay_when_the_run_ends(page: Page, robot: Robot) -> None:
    page.keyboard.press("x")
    page.click("#confirm-abort")
    heard(robot, "order 2")
    results = page.locator("#mission-results")
    results.wait_for()
    page.wait_for_selector("#mission-results h2:has-text('The mission was aborted')")
    with page.expect_download() as report:
        page.click("#mission-results a:text-is('rescue.txt')")
    assert report.value.path().read_text() == (robot.output / "rescue.txt").read_text()
    assert page.locator("#mission-results a").count() == 1  # and no file elsewhere
    shown = results.inner_text()
    page.wait_for_selector("#station-ended")
    assert results.inner_text() == shown
    for text in ("aborted", "1 confirmed", "1:02 of 10:00", "12.5 m²", "not known, no bumper"):
        assert text in shown
    page.click("#close-results")
    results.wait_for(state="hidden")


def is_large(page: Page, button: str) -> bool:
    """Whether a finger hits it."""
    box = page.locator(button).bounding_box()
    return box is not None and min(box["width"], box["height"]) >= MIN_TARGET_PX


def can_press(page: Page, *wanted: str) -> None:
    """Wait until these of the mission's buttons can be pressed, and no others."""
    for button in BUTTONS:
        page.wait_for_selector(f"{button}:{'enabled' if button in wanted else 'disabled'}")


def states_and_victims_are_listed(page: Page) -> None:
    page.wait_for_selector("#mission-states tr:has-text('LOOK_AROUND'):has-text('all is set')")
    row = page.locator("#mission-victims tbody tr:has-text('confirmed')")
    row.wait_for()
    shown = ["7", "tag", "7", "confirmed", "4.00", "4.00", "75%", "3", "Go", "Show"]
    assert row.inner_text().split() == shown
    page.wait_for_function("document.querySelector('.victim-picture').naturalWidth == 2")
    assert is_large(page, "[aria-label='Go to tag 7']")
    page.click("[aria-label='Go to tag 7']")  # but this robot cannot navigate
    page.wait_for_selector(".q-notification:has-text('the way to tag 7')")
    page.click("[aria-label='Show tag 7 on the map']")
    page.wait_for_selector("#map-view[data-centre='4.00 4.00']")


def panel_fits(page: Page) -> None:
    """The panel is no wider than the page, and nothing hides the emergency stop."""
    page.click("#tab-mission")
    page.wait_for_selector("#panel-mission", state="visible")
    page.wait_for_function(FITS, arg="panel-mission")
    page.click("#emergency-stop", trial=True)
