"""In a real browser, the time line shows what happened, and a moment of it beside the present."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from robbie_mp.logs.black_box.clip_folder import CLIPS
from robbie_mp.station.past.moments import read_moment
from tests._support.robot import Robot
from tests.station._support.browser import IS_CONNECTED, browser, needs_chromium, open_panel, page_of, release
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(400)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  body: {class: "zoo.changing:Changing"}
black_box: {before_s: 4, after_s: 0}
"""
POINT = ".time-lane[data-lane={}] button"
GREY = """(where) => {
  const image = document.querySelector(where), canvas = document.createElement("canvas");
  if (!image?.naturalWidth) return null;
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0);
  return pen.getImageData(5, 5, 1, 1).data[0];
}"""
COLOURS = """() => {
  const { color, backgroundColor } = getComputedStyle(document.querySelector("#moment-close"));
  return [color, backgroundColor];
}"""
THEN, NOW = ".moment .is-then img", ".moment figure:not(.is-then) img"


def test_moment_of_the_run_is_shown_beside_the_present(robot: Robot) -> None:
    (robot.folder / "zoo" / "changing.py").write_text((HERE / "_support" / "changing.py").read_text())
    robot.write_profile(PROFILE, has_black_box=True)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector("#state-time")
        page.wait_for_function(IS_CONNECTED)
        page.wait_for_timeout(1500)  # which the clip shows, too
        assert robot.command("mark", "victim 7 in the corner").returncode == 0
        open_panel(page, "timeline")
        page.wait_for_selector(POINT.format("Victims"))
        assert robot.command("param", "set", "body.grey", "220").returncode == 0
        moment_is_shown_beside_the_present(page)
        place_of_then_is_on_the_map(page)
        stop_and_restart_are_points_too(page, robot)


def moment_is_shown_beside_the_present(page: Page) -> None:
    page.click(POINT.format("Victims"))
    page.wait_for_selector("#moment-title:has-text('victim 7 in the corner')")
    page.wait_for_selector("#moment-title:has-text('the robot was at 0.4 m, 2.0 m')")
    page.wait_for_function(f"Math.abs(({GREY})('{THEN}') - 40) < 6")
    page.wait_for_function(f"Math.abs(({GREY})('{NOW}') - 220) < 6")
    assert "is-chosen" in str(page.get_attribute(POINT.format("Victims"), "class"))
    text, ground = page.evaluate(COLOURS)
    assert text != ground


def place_of_then_is_on_the_map(page: Page) -> None:
    open_panel(page, "view")
    page.wait_for_selector("#view-figures:has-text('1 moments')")
    open_panel(page, "timeline")
    page.click("#moment-close")
    page.wait_for_selector(".moment figure", state="detached")
    open_panel(page, "view")
    page.wait_for_selector("#view-figures:not(:has-text('1 moments'))")
    open_panel(page, "timeline")


def stop_and_restart_are_points_too(page: Page, robot: Robot) -> None:
    page.keyboard.press("Escape")
    page.wait_for_selector("#emergency-stop-state:text-is('STOPPED')")
    page.wait_for_selector(POINT.format("Stops"))
    release(page)
    assert robot.command("module", "restart", "body").returncode == 0
    page.wait_for_selector(POINT.format("Restarts"))
    page.click(".time-line-tools [data-span='60']")
    page.click(POINT.format("Restarts"))
    page.wait_for_selector(".moment:has-text('no clip shows it')")


def test_clip_that_is_gone_is_an_error_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="gone"):
        read_moment(tmp_path / CLIPS / "gone", 5.0, "nothing")
