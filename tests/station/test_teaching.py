"""Operators teach objects from the camera: what modules see is drawn over it, and what is taught is kept."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

from robbie_mp.messages import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    Header,
    Image,
    Point2D,
    Pose2D,
    Time,
)
from robbie_mp.station.panels.teaching import checked_box, pixels_of_box
from robbie_mp.station.watch.cameras import CameraTopic
from robbie_robots.workers.taught import Box
from tests._support.robot import Robot
from tests.station._support.browser import HELD_MS, browser, needs_chromium, page_of
from tests.station.test_page import address_of
from tests.workers.objects._support.prints import HEIGHT_PX, TAUGHT_PX, WIDTH_PX, drawn_print, scene

HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, tabs: {camera: "", drive: ""}}
  camera: {class: "zoo.print_camera:PrintCamera"}
  objects:
    class: robbie_robots.modules.taught_recognition:TaughtObjects
    settings: {taught_file: state/objects.json}
"""


@needs_chromium
@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(300)
def test_object_is_taught_with_a_box_on_the_camera_and_forgotten(robot: Robot) -> None:
    (robot.folder / "zoo" / "print_camera.py").write_text((HERE / "_support" / "print_camera.py").read_text())
    pixels, box = scene(np.random.default_rng(1), drawn_print(1), TAUGHT_PX)
    np.save(robot.folder / "zoo" / "scene.npy", pixels)
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        wall_cannot_be_taught(page)
        teach(page, "tea", box)
        page.wait_for_selector(".q-notification:has-text('tea is learnt')")
        page.wait_for_selector(".detection-boxes > div:has-text('tea')")
        assert "tea" in (robot.folder / "state" / "objects.json").read_text()
        page.reload()
        page.wait_for_selector(".detection-boxes > div:has-text('tea')")
        page.click("#teach")
        page.wait_for_selector("[data-taught=objects]:has-text('tea')")
        page.click("[aria-label='Forget tea']")
        page.wait_for_selector(".q-notification:has-text('tea is forgotten')")
        page.wait_for_selector(".detection-boxes > div", state="detached")


def wall_cannot_be_taught(page: Page) -> None:
    """Teach a corner of the picture, in which there is nothing, then change one's mind about another box."""
    teach(page, "nothing", Box(2.0, 2.0, 60.0, 60.0))
    page.wait_for_selector(".q-notification:has-text('features are in the box, and 20 are needed')")
    page.wait_for_selector("#teaching", state="detached")
    page.click("#teach")
    page.click("#teach-begin")
    page.click("#teach-cancel")
    page.wait_for_selector("#teaching", state="detached")


def teach(page: Page, name: str, box: Box) -> None:
    page.click("#teach")
    page.click("#teach-begin")
    page.wait_for_selector("#teaching .camera-picture[data-loaded]")
    area = page.locator("#teaching .camera-picture").bounding_box()
    assert area
    scale = (area["width"] / WIDTH_PX, area["height"] / HEIGHT_PX)
    left, top = area["x"] + scale[0] * box.left, area["y"] + scale[1] * box.top
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move(left + scale[0] * box.width, top + scale[1] * box.height, steps=3)
    page.mouse.up()
    page.fill("#teach-name", name)
    page.keyboard.press("Enter", delay=HELD_MS)


def seen_at(seconds: float, *, name: str = "") -> Detection2DArray:
    header = Header(stamp=Time.from_nanoseconds(round(seconds * 1e9)))
    middle = Pose2D(position=Point2D(x=10.0, y=5.0))
    found = Detection2D(id=name, bbox=BoundingBox2D(center=middle, size_x=4.0, size_y=2.0))
    return Detection2DArray(header=header, detections=[found])


def test_detections_of_several_modules_are_drawn_together_and_old_ones_are_not() -> None:
    camera = CameraTopic()
    assert camera.boxes([seen_at(1.0)]) == []
    stamp = Time.from_nanoseconds(round(2.0e9))
    camera.latest.put(Image(header=Header(stamp=stamp), height=10, width=20))
    told = [seen_at(1.6, name="tea"), seen_at(2.1, name="Anna"), seen_at(1.4, name="old")]
    boxes = camera.boxes(told)
    assert [box.text for box in boxes] == ["tea", "Anna"]
    assert boxes[0][:4] == pytest.approx((0.4, 0.4, 0.2, 0.2))


def test_box_on_the_page_becomes_pixels_of_the_image() -> None:
    box = checked_box({"left": 0.25, "top": 0.5, "width": 0.5, "height": 0.25})
    assert box is not None
    found = pixels_of_box(box, Image(width=200, height=100))
    assert (found.center.position.x, found.center.position.y) == (100.0, 62.5)
    assert (found.size_x, found.size_y) == (100.0, 25.0)


@pytest.mark.parametrize(
    "sent",
    [
        None,
        {},
        {"left": 0.1, "top": 0.1, "width": 0.2},
        {"left": "x", "top": 0.1, "width": 0.2, "height": 0.2},
        {"left": 0.1, "top": 0.1, "width": float("nan"), "height": 0.2},
        {"left": 0.1, "top": 0.1, "width": 1.2, "height": 0.2},
        {"left": 0.1, "top": 0.1, "width": 0.001, "height": 0.2},
    ],
)
def test_malformed_boxes_are_ignored(sent: Any) -> None:
    assert checked_box(sent) is None
