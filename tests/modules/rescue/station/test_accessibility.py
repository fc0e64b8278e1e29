"""In a real browser, axe-core finds no serious fault on any layout of the operator's page, dark or light."""

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from robbie_mp.station.page.layouts import default_layouts
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests._support.robot import Robot
from tests.station._support.browser import browser, choose_layout, needs_chromium, page_of
from tests.station.test_page import address_of
from tests.station.test_panels import log_in

axe = pytest.importorskip(
    "axe_playwright_python.sync_playwright",
    reason="THE ACCESSIBILITY OF THE OPERATOR'S PAGE IS NOT TESTED: pip install axe-playwright-python",
)
pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(300)]
MODULES = {
    "known_robot": Path("tests/station/_support/known_robot.py"),
    "rescuer": Path("tests/modules/rescue/station/_support/rescuer.py"),
}
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      panels: ["robbie_robots.modules.rescue.station.mission_panel:MissionPanel"]
  known: {class: "zoo.known_robot:KnownRobot"}
  rescuer: {class: "zoo.rescuer:Rescuer"}
"""
SERIOUS = ("serious", "critical")
CHECK = "options => axe.run(options).then((found) => found.violations)"
CONTRAST = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}
"""The rule that depends on the look."""
AS_TEXT = """() => {
  const range = document.createRange();
  return [...document.querySelectorAll(".material-icons, .q-icon")].filter((one) => {
    range.selectNodeContents(one);
    return range.getBoundingClientRect().width > 1.2 * parseFloat(getComputedStyle(one).fontSize);
  }).map((one) => one.textContent);
}"""
FILES = "() => performance.getEntriesByType('resource').map((one) => one.name)"
LARGE = re.compile(r"tailwindcss|\.woff2")
"""What our own panels do not need: all icons, and the compiler of styles."""


def test_no_layout_has_a_serious_fault_of_accessibility_in_either_look(robot: Robot) -> None:
    root = Path(__file__).parents[4]
    for name, file in MODULES.items():
        (robot.folder / "zoo" / f"{name}.py").write_text((root / file).read_text())
    robot.write_secret("operator.token", "opens-everything")
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.add_init_script(axe.Axe().axe_script)  # also after the page has reconnected
        log_in(page, "opens-everything")
        page.wait_for_selector("#state-time")
        found = [f"dark, {fault}" for fault in faults_of_all_layouts(page, {})]
        page.click("#look")
        page.wait_for_selector("body.body--light")
        found += [f"light, {fault}" for fault in faults_of_all_layouts(page, CONTRAST)]
        assert not found, "\n".join(found)
        assert not [file for file in page.evaluate(FILES) if LARGE.search(file)]
        page.reload()
        page.wait_for_selector("body.body--light")  # the browser has kept it


def drawn_as_text(page: Page) -> list[str]:
    """Return each icon that is wider than one sign, because no font has it."""
    found: list[str] = page.evaluate(AS_TEXT)
    return found


def faults_of_all_layouts(page: Page, options: dict[str, Any]) -> list[str]:
    layouts = [*default_layouts([*FRAMEWORK_PANELS, "mission"], ["mission"])]
    assert layouts == ["Drive", "Mission", "Engineer", "Tablet", "Playback"]
    found: list[str] = []
    for number, layout in enumerate(layouts, 1):
        choose_layout(page, number, layout)
        found += [f"{layout}: {fault}" for fault in serious_faults(page, options)]
        found += [
            f"{layout}: the icon {icon} is not in the page's first file" for icon in drawn_as_text(page)
        ]
    return found


def serious_faults(page: Page, options: dict[str, Any]) -> list[str]:
    """Return each serious fault with its rule and its elements."""
    violations = page.evaluate(CHECK, {"resultTypes": ["violations"], **options})
    return [
        f"{one['id']}, {one['help']}: "
        + "; ".join(
            f"{node['html'][:160]} {node['any'][:1] and node['any'][0]['message'][:160]}"
            for node in one["nodes"][:6]
        )
        for one in violations
        if one["impact"] in SERIOUS
    ]
