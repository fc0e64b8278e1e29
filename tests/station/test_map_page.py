"""In a real browser, the map keeps what it shows, and what is on it can be pressed."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot
from tests.station._support.browser import (
    LAPTOP,
    begin_drawing,
    browser,
    needs_chromium,
    page_of,
    press_until,
)
from tests.station.test_page import address_of
from tests.station.test_panels import Told

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(240)]
HERE = Path(__file__).parent
READS_BACK = ("Canvas2D: Multiple readback operations",)
"""Begins what a browser says of a test that looks at colours."""
PROFILE = """
modules:
  operator:
    class: "robbie_mp.station:OperatorStation"
    settings: {port: 0, tabs: {map: ""}, robot_name: Scout, robot_colour: "#ff6f00"}
  known: {class: "zoo.known_robot:KnownRobot"}
"""
MAP = "Object.values(mounted_app.$refs).flat().find((one) => one?.on_screen)"
VIEW = f"(() => {{ const {{ centre, scale }} = {MAP}; return [centre.x, centre.y, scale]; }})()"
AROUND = f"""((x, y) => {{
  const map = {MAP}, pen = map.$el.getContext("2d");
  const [u, v] = map.on_screen(x, y), size = Math.max(0.2 * map.scale, 11);
  const directions = [...Array(8).keys()].map((at) => 0.3 + (Math.PI / 4) * at);
  const places = directions.map((at) => [u + size * Math.cos(at), v + size * Math.sin(at)]);
  const colours = places.map(([left, top]) => pen.getImageData(left, top, 1, 1).data);
  return colours.every(([red, green, blue]) => green > red + 20 && green > blue + 20);
}})"""
"""Returns whether a ring in the goal's colour is round a place of the map."""
ROBOT_AT = [1.5, 3.25]


def view(page: Page) -> list[float]:
    found: list[float] = page.evaluate(VIEW)
    return found


def place_on_page(page: Page, x_m: float, y_m: float) -> tuple[float, float]:
    box = page.locator("#map-view").bounding_box()
    assert box
    u, v = page.evaluate(f"{MAP}.on_screen({x_m}, {y_m})")
    return box["x"] + u, box["y"] + v


def press(page: Page, x_m: float, y_m: float) -> None:
    page.mouse.click(*place_on_page(page, x_m, y_m))


def test_map_keeps_its_view_and_what_is_on_it_can_be_pressed(robot: Robot) -> None:
    (robot.folder / "zoo" / "known_robot.py").write_text((HERE / "_support" / "known_robot.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    told = Told(robot)
    with browser() as started, page_of(started, address_of(robot), may_say=READS_BACK) as page:
        robot_says_who_it_is(page, address_of(robot))
        page.click("#tab-map")
        page.wait_for_selector("#map-view[data-map=whole]")
        it_follows_until_it_is_dragged(page)
        view_survives_another_size(page)
        place_is_named_without_a_dialog(page)
        mark_goes_shows_is_renamed_and_comes_back(page, told)
        goal_disappears_when_it_ends(page, told)


def robot_says_who_it_is(page: Page, address: str) -> None:
    page.wait_for_selector("#robot-name:text-is('Scout')")
    assert page.title().endswith("Scout")
    assert (
        page.evaluate("getComputedStyle(document.getElementById('robot-name')).borderLeftColor")
        == "rgb(255, 111, 0)"
    )
    other = page.request.get(address.partition("?")[0], headers={"cookie": ""}).text()
    assert "<title>Scout: log in</title>" in other
    assert "#ff6f00" in other


def it_follows_until_it_is_dragged(page: Page) -> None:
    page.wait_for_function(f"{VIEW}.slice(0, 2).join() === '{ROBOT_AT[0]},{ROBOT_AT[1]}'")
    x, y = place_on_page(page, *ROBOT_AT)
    page.mouse.move(x + 60, y + 60)
    page.mouse.down()
    page.mouse.move(x, y, steps=3)
    page.mouse.up()
    page.wait_for_selector("#map-follow [aria-pressed=true]:has-text('Stay')")
    page.wait_for_timeout(500)  # in which a map that follows would have gone back
    assert view(page)[0] > ROBOT_AT[0] + 0.1


def view_survives_another_size(page: Page) -> None:
    page.click("#map-in")
    page.wait_for_timeout(200)
    before = view(page)
    page.set_viewport_size({"width": 700, "height": 500})
    page.wait_for_function(f"{VIEW}[2] < {0.9 * before[2]}")  # so that the same is in sight
    assert view(page)[:2] == before[:2]
    page.set_viewport_size(LAPTOP["viewport"])
    page.wait_for_function(f"Math.abs({VIEW}[2] - {before[2]}) < 0.01")
    page.click("#map-fit")


def place_is_named_without_a_dialog(page: Page) -> None:
    press_until(page, "#map-draw", "#map-draw-place")
    page.click("#map-draw-place")
    page.wait_for_selector("#map-mode-shown:has-text('Name a place')")
    page.click("#map-mode-end")
    page.wait_for_selector("#map-mode-shown", state="hidden")
    begin_drawing(page, "place")
    press(page, 2.5, 4.0)
    page.wait_for_selector("#map-card #map-card-name")
    assert not page.query_selector(".q-dialog")
    assert page.input_value("#map-card-name") == "place 1"
    page.fill("#map-card-name", "kitchen")
    page.keyboard.press("Enter")
    page.wait_for_selector("#map-text:has-text('kitchen')")
    page.wait_for_selector("#map-card", state="hidden")
    begin_drawing(page, "place")
    press(page, 1.0, 4.0)
    page.wait_for_selector("#map-card #map-card-name")
    page.fill("#map-card-name", "kitchen")  # another operator's may have this name
    page.keyboard.press("Enter")
    page.wait_for_selector("#map-draw-warning:has-text('there is a kitchen already')")
    page.click("#map-card-close")
    page.wait_for_selector("#map-card", state="hidden")


def mark_goes_shows_is_renamed_and_comes_back(page: Page, told: Told) -> None:
    press(page, 2.5, 4.0)
    page.wait_for_selector("#map-card:has-text('kitchen')")
    told.hears(page, "#map-card-go", "place", "kitchen")
    page.click("#map-card-show")
    page.wait_for_function(f"{VIEW}.slice(0, 2).map((one) => one.toFixed(1)).join() === '2.5,4.0'")
    page.fill("#map-card-name", "stove")
    page.keyboard.press("Enter")
    page.wait_for_selector("#map-text:has-text('stove')")
    assert "kitchen" not in page.inner_text("#map-text")
    press(page, 2.5, 4.0)
    page.wait_for_selector("#map-card:has-text('stove')")
    page.click("#map-card-delete")
    page.wait_for_selector("#map-text:not(:has-text('stove'))")
    page.click("#map-card-undo")
    page.wait_for_selector("#map-text:has-text('stove')")
    page.wait_for_selector("#map-card", state="hidden")
    page.click("#map-fit")
    press(page, 0.5, 2.5)  # a module's, which an operator cannot change
    page.wait_for_selector("#map-card:has-text('home')")
    assert page.is_visible("#map-card-go")
    assert not page.is_visible("#map-card-delete")
    page.click("#map-card-close")


def goal_disappears_when_it_ends(page: Page, told: Told) -> None:
    page.click("#map-mode >> text=Set goal")
    page.wait_for_selector("#map-view[data-placing=goal]")
    press(page, 2.0, 3.0)
    told.waits_for("goal", "map")
    page.wait_for_selector("#map-text:has-text('goal at 2.0')")
    page.wait_for_function(f"{AROUND}(2.0, 3.0)")  # a ring, and no arrow as the robot is
    assert not page.evaluate(f"{AROUND}({ROBOT_AT[0]}, {ROBOT_AT[1]})")
    page.click("#map-cancel")
    told.waits_for("cancel")
    page.wait_for_selector("#map-text:not(:has-text('goal at'))")
