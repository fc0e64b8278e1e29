"""A real mission from start to report, led by an operator who has nothing but the page."""

import csv
import io
import math
import signal
import time

import numpy as np
import pytest
from playwright.sync_api import Page

from robbie_mp.run.operator_link import read_link
from robbie_robots.hw.simulation.arena_file import read_arena
from tests._support.robot import LIMIT_S, Ended, Robot, kill
from tests.modules.rescue.station.test_mission_panel import can_press
from tests.station._support.browser import (
    begin_drawing,
    browser,
    choose_layout,
    needs_chromium,
    page_of,
    press_until,
    release,
)
from tests.station.test_map_page import place_on_page
from tools.trials.missions.rescue import RescueResult, judge

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(700)]
ARENA = """
cell_m: 0.25
start_heading_rad: 0.0
drawing: |
  ######################
  #.........#..........#
  #.........#..........#
  #.........#..........#
  #....................#
  #....................#
  #....................#
  #.........#..........#
  #..R......#..........#
  #.........#.....######
  #.........#..........#
  #.........#..........#
  #.........#..........#
  ######################
victims:
  - {tag: 11, kind: still, x_m: 1.5, y_m: 3.25, height_m: 0.35, facing_rad: -1.5708}
  - {tag: 12, kind: moving, x_m: 5.25, y_m: 2.75, height_m: 0.35, facing_rad: 3.1416}
"""
"""Two rooms; the robot needs some 70 s."""
PROFILE = """
parents: [robbie:rescue]
modules:
  operator: {settings: {port: 0}}
  base: {settings: {arena: arena.yaml, true_path: true}}
  laser: {settings: {arena: arena.yaml}}
  camera: {settings: {arena: arena.yaml}}
  battery: {settings: {arena: arena.yaml}}
  rear_camera: null
  victims: {settings: {confirms_by_itself: false, answer_s: 60.0}}
  mission: {settings: {starts_by_itself: false}}
  mapping: {restart: {policy: never}}
"""
VICTIMS = ("tag 11", "tag 12")
AROUND_HOME = (-0.4, -0.4, 0.4, 0.4)
BAY = (2.7, -1.0, 4.2, -0.4)
"""The bay at the lower right, into which the robot drives: left, bottom, right, top (m, map frame)."""
DRIVES = "/[1-9]/.test(document.querySelector('#velocity').textContent.split(',')[0])"
STANDS = "document.querySelector('#velocity').textContent.startsWith('0.00 m/s, 0.00 rad/s')"
MAP_IS_OLD = "document.querySelector('#map-view').parentElement.dataset.age?.startsWith('Position')"
LOOK_S = 0.2
MISSION_LIMIT_S = 300.0
"""On a busy machine, commands rest on what is too old again and again, and the robot stands meanwhile."""


class Operator:
    """Leads a mission by the page, and answers every question about a victim.

    Args:
        page: the operator's page.
    """

    def __init__(self, page: Page):
        self.page = page
        self.confirmed: set[str] = set()

    def until(self, script: str, limit_s: float = LIMIT_S) -> None:
        """Wait until the page shows something; answer what it asks meanwhile."""
        end_s = time.monotonic() + limit_s
        while not self.page.evaluate(script):
            assert time.monotonic() < end_s, f"not within {limit_s} s: {script}"
            self.answer()
            time.sleep(LOOK_S)

    def until_shown(self, selector: str, text: str, limit_s: float = LIMIT_S) -> None:
        """Wait until the page shows an element whose text has a part."""
        self.until(f"document.querySelector('{selector}')?.innerText.includes('{text}')", limit_s)

    def answer(self) -> None:
        """Confirm the victim that the page asks about, once its picture has come."""
        if self.page.locator("#victim-waiting").count():
            return  # another press would begin the time to undo again
        has_picture = "document.querySelector('#victim-question img')?.naturalWidth > 0"
        if not (self.page.locator("#victim-yes:enabled").count() and self.page.evaluate(has_picture)):
            return
        asked = self.page.inner_text("#victim-question")
        self.page.click("#victim-yes")
        self.confirmed |= {one for one in VICTIMS if one in asked}


def draw_area(page: Page, left_m: float, bottom_m: float, right_m: float, top_m: float) -> None:
    """Draw a no-go area; its name is not given yet."""
    begin_drawing(page, "no_go")
    for corner in ((left_m, bottom_m), (right_m, bottom_m), (right_m, top_m), (left_m, top_m)):
        page.mouse.click(*place_on_page(page, *corner))
    page.mouse.click(*place_on_page(page, left_m, bottom_m))
    page.wait_for_selector("#map-card #map-card-save")


def test_operator_leads_a_mission_by_the_page_alone(robot: Robot) -> None:
    (robot.folder / "arena.yaml").write_text(ARENA)
    robot.write_profile(PROFILE, has_black_box=True)
    run = robot.start()
    robot.until(lambda modules: "http://" in modules["operator"]["status"])
    with browser() as started, page_of(started, read_link(robot.known_run().folder)) as page:
        operator = Operator(page)
        choose_layout(page, 2, "Mission")
        page.wait_for_selector("#map-view[data-map=whole]")
        area_is_drawn_and_one_that_cuts_off_home_is_warned_of(page)
        can_press(page, "#mission-start", "#mission-abort")
        page.click("#mission-start")
        choose_layout(page, 4, "Tablet")  # camera, map and pad
        stop_ends_the_motion_and_the_mission_goes_on_after_its_release(operator)
        operator_drives_and_gives_control_back(operator)
        broken_mapping_is_seen_and_started_again(operator, robot)
        operator.until_shown("#mission-results h2", "The mission is done", MISSION_LIMIT_S)
        report_comes_home(page)
        assert operator.confirmed == set(VICTIMS)
        assert run.poll() is None
    Ended.in_order(run, signal.SIGINT)
    arena = read_arena(robot.folder / "arena.yaml")
    outcome = RescueResult(seed=0, victims=len(arena.victims))
    judge(outcome, arena, robot.output)
    assert outcome.is_home, outcome.reason
    assert outcome.found == len(VICTIMS), outcome.placed_m
    assert outcome.invented == outcome.collisions == 0
    x_m, y_m = np.loadtxt(robot.output / "truth.txt")[:, 1:3].T
    left_m, bottom_m, right_m, top_m = BAY
    assert not np.any((x_m > left_m) & (x_m < right_m) & (y_m > bottom_m) & (y_m < top_m))
    assert max(map(math.hypot, x_m, y_m)) > 1.0, "the robot has hardly driven"


def area_is_drawn_and_one_that_cuts_off_home_is_warned_of(page: Page) -> None:
    draw_area(page, *AROUND_HOME)
    page.wait_for_selector("#map-draw-warning:has-text('cuts the robot off from home')")
    page.click("#map-card-close")
    draw_area(page, *BAY)
    page.click("#map-card-save")
    page.wait_for_selector("#map-text:has-text('1 no-go areas')")


def stop_ends_the_motion_and_the_mission_goes_on_after_its_release(operator: Operator) -> None:
    page = operator.page
    operator.until(DRIVES)
    page.keyboard.press("Escape")
    page.wait_for_selector("#emergency-stop-state:text-is('STOPPED')")
    operator.until(STANDS)
    operator.until_shown("#state-mission", "HALT")
    release(page)
    go_on(operator)


def operator_drives_and_gives_control_back(operator: Operator) -> None:
    page = operator.page
    page.keyboard.down("KeyS")
    operator.until_shown("#control-who", "you drive")
    page.keyboard.up("KeyS")
    operator.until(STANDS)
    go_on(operator)


def go_on(operator: Operator) -> None:
    """Order the robot to go on: without an order, it stands."""
    operator.until_shown("#control-mode", "HOLD")
    operator.page.keyboard.press("g")
    operator.until_shown("#control-mode", "AUTO")
    operator.until(DRIVES)


def broken_mapping_is_seen_and_started_again(operator: Operator, robot: Robot) -> None:
    """The module that makes the map is killed for good, until the operator starts it again."""
    page = operator.page
    kill(int(robot.top()["mapping"]["pid"]))
    operator.until_shown("#alarm-text", "Module mapping has FAILED")
    operator.until(MAP_IS_OLD)
    operator.until(STANDS)
    operator.until_shown("#state-mission", "HALT")
    page.click("#tab-system")
    page.click("#panel-system tr:has(td:text-is('mapping')) .q-checkbox")
    press_until(page, "#order-start", "#confirm-order")
    page.click("#confirm-order")
    page.wait_for_selector("#panel-system tr:has(td:text-is('mapping')) td:text-is('RUNNING')")
    choose_layout(page, 4, "Tablet")
    operator.until(f"!({MAP_IS_OLD})")
    operator.until(DRIVES)


def report_comes_home(page: Page) -> None:
    """The mission's table of victims, and the run's report."""
    with page.expect_download() as table:
        page.click("#mission-results a:text-is('rescue_victims.csv')")
    rows = csv.DictReader(io.StringIO(table.value.path().read_text()))
    assert {row["name"] for row in rows if row["confirmed"] == "yes"} == set(VICTIMS)
    page.click("#close-results")
    page.click("#tab-happened")
    with page.expect_download() as report:
        page.click("#report")
    text = report.value.path().read_text()
    assert "killed neither by the supervisor nor by the kernel" in text
    assert all(one in text for one in VICTIMS)
