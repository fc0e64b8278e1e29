"""In a real browser, all pictures are shown of a module that sends those of several cameras at once."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot, wait_until
from tests.station._support.browser import browser, needs_chromium, open_panel, page_of
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  eyes: {class: "zoo.three_eyes:ThreeEyes"}
"""
COUNT = re.compile(r"64 x 64 mono8, image (\d+)")
EYES = ("left", "middle", "right")


def test_no_camera_is_lost_among_others_of_its_module(robot: Robot) -> None:
    (robot.folder / "zoo" / "three_eyes.py").write_text((HERE / "_support" / "three_eyes.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector("#state-time")
        open_panel(page, "cameras")
        for name in EYES:
            page.wait_for_selector(f"#panel-cameras .detection-boxes > div:has-text('{name}')")
        before = counts(page)
        wait_until(lambda: max(counts(page)) > max(before) + 50)
        more = [now - one for now, one in zip(counts(page), before, strict=True)]
        assert min(more) > 0.7 * max(more), more


def counts(page: Page) -> list[int]:
    """Return how many pictures of each camera have come."""
    found = [int(one) for one in COUNT.findall(page.inner_text("#panel-cameras"))]
    assert len(found) == len(EYES), found
    return found
