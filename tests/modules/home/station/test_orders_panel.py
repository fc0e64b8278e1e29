"""The panel Orders: what it shows, and orders in words and by buttons; in a real browser."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot
from tests.station._support.browser import TABLET, browser, needs_chromium, page_of
from tests.station.test_page import address_of
from tests.station.test_panels import FITS, log_in

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(600)]
SUPPORT = Path(__file__).parent / "_support"
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
      panels: ["robbie_robots.modules.home.station.orders_panel:OrdersPanel"]
  household:
    class: robbie_robots.modules.home.household:Household
    settings:
      orders: {bring: ["bring me the <object>"], go: ["go to the <place>"], follow: ["follow me"]}
      words: {object: [soup], place: [desk, hall, sofa]}
      tables: [desk]
  flat: {class: "zoo.flat:Flat"}
"""


OUT_OF_SIGHT = """() => {
  const tile = document.querySelector("#panel-orders").getBoundingClientRect();
  const parts = [...document.querySelectorAll("#panel-orders :is(button, input)")];
  return parts.filter((one) => {
    const { bottom, right } = one.getBoundingClientRect();
    return bottom > tile.bottom || right > tile.right;
  }).map((one) => one.id || one.textContent);
}"""


def test_operator_orders_in_words_and_by_buttons_and_cancels(robot: Robot) -> None:
    (robot.folder / "zoo" / "flat.py").write_text((SUPPORT / "flat.py").read_text())
    robot.write_secret("operator.token", "opens-everything")
    robot.write_secret("observer.token", "opens-all-our-eyes")
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        log_in(page, "opens-everything")
        all_orders_are_in_sight(page)
        order_in_words_is_shown_and_cancelled(page)
        with page_of(started, address_of(robot)) as other:
            log_in(other, "opens-all-our-eyes")
            observer_sees_and_does_not_order(other)
        order_by_buttons_needs_what_it_names(page)
        with page_of(started, address_of(robot), TABLET) as tablet:
            log_in(tablet, "opens-everything")
            tablet.click("#tab-orders")
            tablet.wait_for_selector("#panel-orders", state="visible")
            tablet.wait_for_function(FITS, arg="panel-orders")


def all_orders_are_in_sight(page: Page) -> None:
    """In the first layout, in the small tile beside the pad, without scrolling."""
    page.keyboard.press("1")
    page.wait_for_selector("#layouts:has-text('Drive')")
    page.wait_for_selector("#tile-orders:visible")
    page.wait_for_function("document.querySelector('#orders-task-6')")
    assert page.evaluate(OUT_OF_SIGHT) == []


def order_in_words_is_shown_and_cancelled(page: Page) -> None:
    page.click("#tab-orders")
    page.wait_for_selector("#orders-state:has-text('IDLE')")
    say(page, "dance")
    page.wait_for_selector("#orders-failure:has-text(\"I do not understand 'dance'\")")
    say(page, "go to the hall and follow me")
    page.wait_for_selector("#orders-state:has-text('GO')")
    assert page.inner_text("#orders-tasks") == "▶ go → hall\n· follow"
    page.wait_for_selector("#state-order:has-text('GO go → hall')")
    page.click("#orders-cancel")
    page.wait_for_selector("#orders-state:has-text('IDLE')")
    page.wait_for_selector('#orders-failure:has-text("cancelled on the operator\'s page")')


def observer_sees_and_does_not_order(page: Page) -> None:
    page.click("#tab-orders")
    page.wait_for_selector("#orders-state:has-text('IDLE')")
    assert not page.locator("#orders-cancel, #orders-text, #orders-task-0").count()


def order_by_buttons_needs_what_it_names(page: Page) -> None:
    page.wait_for_selector("#orders-task-0:disabled")
    page.click("label:has(#orders-object)")
    page.click(".q-menu >> text=soup")
    page.click("#orders-task-0")
    page.wait_for_selector("#orders-state:has-text('FETCH')")
    assert page.inner_text("#orders-tasks") == "▶ bring soup"


def say(page: Page, text: str) -> None:
    page.fill("#orders-text", text)
    page.press("#orders-text", "Enter")
