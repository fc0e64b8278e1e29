"""In a real browser, the page tells an operator who drives the robot, and how late the page is."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Robot, robot_in, wait_until
from tests.station._support.browser import LAPTOP, browser, choose_layout, needs_chromium, page_of
from tests.station.test_driving import ARENA, Journal
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0, max_linear_m_per_s: 0.4}}
  base: {class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {arena: arena.yaml}}
  cruise: {class: "zoo.cruise:Cruise"}
  witness: {class: "zoo.witness:Witness"}
"""
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
BUTTONS = ("#go-on", "#hold", "#take-over")
MIN_TARGET_PX = 44


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
def cruising(nothing_left_behind: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot that a module turns."""
    with robot_in(tmp_path_factory.mktemp("cockpit")) as robot:
        for name in ("cruise", "witness"):
            (robot.folder / "zoo" / f"{name}.py").write_text((HERE / "_support" / f"{name}.py").read_text())
        (robot.folder / "arena.yaml").write_text(ARENA)
        robot.write_profile(PROFILE)
        robot.start()
        yield robot


def is_controlled(page: Page, mode: str, who: str) -> None:
    """Wait until the bar says so."""
    page.wait_for_selector(f"#control-mode:has-text('{mode}')")
    page.wait_for_selector(f"#control-who:text-is('{who}')")


def test_drive_key_takes_over_letting_go_holds_and_only_g_goes_on(cruising: Robot, started: Browser) -> None:
    journal = Journal(cruising)
    with page_of(started, address_of(cruising)) as page:
        is_controlled(page, "AUTO", "modules drive")
        page.keyboard.down("KeyW")
        is_controlled(page, "MANUAL", "you drive")
        wait_until(lambda: journal.speed() > 0.1)
        page.keyboard.up("KeyW")
        is_controlled(page, "HOLD", "nobody drives")
        page.wait_for_selector("#control-why:has-text('the operator has let go')")
        assert page.is_disabled("#hold")
        page.keyboard.press("g")
        is_controlled(page, "AUTO", "modules drive")
        assert page.is_disabled("#go-on")


def test_bar_and_its_buttons_stay_at_their_places_in_all_layouts_and_states(
    cruising: Robot, started: Browser
) -> None:
    for device in (LAPTOP, PHONE):
        with page_of(started, address_of(cruising), device) as page:
            places = places_of(page)
            page.click("#hold")
            is_controlled(page, "HOLD", "nobody drives")
            for number, name in enumerate(("Drive", "Mission", "Engineer", "Tablet"), 1):
                choose_layout(page, number, name)
                assert places_of(page) == places
            page.click("#go-on")  # not at once: what is ordered half a second after Hold is refused
            is_controlled(page, "AUTO", "modules drive")
            assert places_of(page) == places


def places_of(page: Page) -> list[tuple[float, ...]]:
    """Where bar and buttons are; each can be touched."""
    page.wait_for_selector("#control-bar #control-who:has-text('drive')")
    boxes = [page.locator(one).bounding_box() for one in ("#control-bar", *BUTTONS)]
    assert all(box and min(box["width"], box["height"]) >= MIN_TARGET_PX for box in boxes)
    return [(box["x"], box["y"], box["width"], box["height"]) for box in boxes if box]


def test_bar_shows_the_age_of_the_pages_own_link(cruising: Robot, started: Browser) -> None:
    with page_of(started, address_of(cruising), may_say=("WebSocket",)) as page:
        page.wait_for_selector("#control-link:not(.is-late):has-text('ms')")
        pid = int(cruising.top()["operator"]["pid"])
        os.kill(pid, signal.SIGSTOP)
        try:
            page.wait_for_selector("#control-link.is-late:has-text('1.5 s')")
        finally:
            os.kill(pid, signal.SIGCONT)
        page.wait_for_selector("#control-link:not(.is-late):has-text('ms')")
