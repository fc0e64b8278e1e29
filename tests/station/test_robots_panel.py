"""In a real browser, one page shows all robots of a team, stops them all, and says who has not stopped."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot, robot_in, wait_until
from tests.station._support.browser import IS_CONNECTED, browser, needs_chromium, open_panel, page_of, release
from tests.station.test_page import address_of
from tools.robot import free_port

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(400)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0, robot_name: %(name)s}}
  body: {class: "zoo.team_robot:TeamRobot"}
  link:
    class: robbie_mp.connect.link.module:Link
    settings:
      robot: %(name)s
      listen: [%(listen)s]
      connect: [%(connect)s]
      prefix_topics: true
      send:
        urgent: [EmergencyStop */emergency_stop, OperatorRequest */operator_request]
        state: [EmergencyStop emergency_stop_state, RobotSummary robot_summary, CompressedImage preview]
      accept:
        "*": [EmergencyStop, RobotSummary, CompressedImage, OperatorRequest]
"""
CARD = ".robot-card[data-robot='{}'] "
STOP_ALL = "#stop-all-state"
NO_PICTURES = """
const Plain = window.WebSocket;
window.WebSocket = class extends Plain {
  constructor(to) {
    super(to.replace("/live/video", "/live/nothing"));
  }
};
"""
"""Connects the page with a group of live parts that is always empty, where it wants pictures."""


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Robot]]:
    """Two robots with a link between them."""
    address = f"tcp/127.0.0.1:{free_port()}"
    for name in ("red", "blue"):
        (tmp_path / name).mkdir()
    with robot_in(tmp_path / "red") as red, robot_in(tmp_path / "blue") as blue:
        robots = {"red": red, "blue": blue}
        for name, robot in robots.items():
            monkeypatch.setenv("XDG_RUNTIME_DIR", str(robot.folder.parent / "runtime"))
            file = HERE / "_support" / "team_robot.py"
            (robot.folder / "zoo" / "team_robot.py").write_text(file.read_text())
            ends = {"listen": address, "connect": ""} if name == "red" else {"listen": "", "connect": address}
            robot.write_profile(PROFILE % {"name": name, **ends})
            robot.start()
        yield robots


def test_all_robots_are_on_one_page_and_stop_at_one_press(team: dict[str, Robot]) -> None:
    blue = team["blue"]
    with browser() as started, page_of(started, page_at(team["red"])) as page:
        page.wait_for_selector("#state-time")
        open_panel(page, "robots")
        each_robot_is_shown(page)
        a_press_stops_all_and_is_confirmed(page, team)
        robot_that_does_not_confirm_is_named(page, blue)
        one_is_taken_over(page, blue)
        robot_without_a_link_is_stale_and_gets_the_stop_when_it_is_back(page, team)


def test_card_says_that_there_is_no_picture_yet(robot: Robot) -> None:
    file = HERE / "_support" / "team_robot.py"
    (robot.folder / "zoo" / "team_robot.py").write_text(file.read_text())
    ends = {"listen": f"tcp/127.0.0.1:{free_port()}", "connect": ""}
    robot.write_profile(PROFILE % {"name": "red", **ends})
    robot.start()
    with browser() as started, page_of(started, address_of(robot), script=NO_PICTURES) as page:
        page.wait_for_selector("#state-time")
        open_panel(page, "robots")
        page.wait_for_selector(f"{CARD.format('')} .newest-image .no-picture:text-is('no picture yet')")
        assert page.locator(f"{CARD.format('')} .newest-image :is(img, canvas) >> visible=true").count() == 0


def each_robot_is_shown(page: Page) -> None:
    for robot, name in (("", "red (this robot)"), ("blue", "blue")):
        card = CARD.format(robot)
        page.wait_for_selector(f"{card} h3:has-text('{name}')")
        page.wait_for_selector(f"{card} .robot-stop:text-is('ready')")
        page.wait_for_selector(f"{card} .robot-mode:text-is('AUTO')")
        page.wait_for_selector(f"{card} .robot-battery:text-is('80%')")
        page.wait_for_function(f'document.querySelector("{card} img")?.naturalWidth === 64')
        assert not page.locator(f"{card} .robot-stale").count()
        age, picture = (
            page.locator(f"{card} {one}").bounding_box() for one in (".picture-age", ".robot-picture")
        )
        assert age
        assert picture
        assert age["y"] + age["height"] <= picture["y"] + picture["height"]  # and not cut off
    page.wait_for_selector(f"{STOP_ALL}:text-is('0 of 2 are STOPPED')")


def a_press_stops_all_and_is_confirmed(page: Page, team: dict[str, Robot]) -> None:
    page.wait_for_function(IS_CONNECTED)
    page.click("#stop-all")
    page.wait_for_selector(f"{STOP_ALL}.is-stopped:text-is('all 2 robots are STOPPED')")
    for robot in team.values():
        assert status(robot).startswith("STOPPED, AUTO")
    page.wait_for_selector("#emergency-stop-state:text-is('STOPPED')")
    release(page)
    page.wait_for_selector(f"{CARD.format('')} .robot-stop:text-is('ready')")
    # Only this robot was released, and the press does not stop it again.
    page.wait_for_timeout(1000)
    assert status(team["red"]).startswith("ready")
    assert status(team["blue"]).startswith("STOPPED")
    page.wait_for_selector(f"{STOP_ALL}:text-is('1 of 2 are STOPPED')")


def robot_that_does_not_confirm_is_named(page: Page, blue: Robot) -> None:
    free(blue)
    page.wait_for_selector(f"{CARD.format('blue')} .robot-stop:text-is('ready')")
    order(blue, "param", "set", "body.is_deaf", "true")
    page.click("#stop-all")
    page.wait_for_selector(f"{STOP_ALL}.is-pending:text-matches('^blue: NOT CONFIRMED for [0-9]+ s$')")
    page.wait_for_selector(f"{CARD.format('')} .robot-stop:text-is('STOPPED')")
    before = stops(blue)
    wait_until(lambda: stops(blue) > before + 3)  # it is repeated
    order(blue, "param", "set", "body.is_deaf", "false")
    page.wait_for_selector(f"{STOP_ALL}:text-is('all 2 robots are STOPPED')")


def one_is_taken_over(page: Page, blue: Robot) -> None:
    with page.expect_popup() as opened:
        page.click(f"{CARD.format('blue')} .robot-take-over")
    assert opened.value.url.startswith(page_at(blue).partition("/login")[0])
    opened.value.close()
    page.wait_for_selector(f"{CARD.format('blue')} .robot-mode:text-is('HOLD')")
    assert ", HOLD, " in status(blue)


def robot_without_a_link_is_stale_and_gets_the_stop_when_it_is_back(
    page: Page, team: dict[str, Robot]
) -> None:
    blue = team["blue"]
    free(blue)
    free(team["red"])
    page.wait_for_selector(f"{STOP_ALL}:text-is('0 of 2 are STOPPED')")
    link, supervisor = pid_of(blue, "link"), pid_of(blue, "supervisor")
    os.kill(supervisor, signal.SIGSTOP)  # which would replace a link that stands still
    os.kill(link, signal.SIGSTOP)
    try:
        stale = f"{CARD.format('blue')} .robot-stale:text-matches('STALE: no link; .* [3-9] s old')"
        page.wait_for_selector(stale)
        assert page.locator(f"{CARD.format('blue')} .robot-stop:text-matches('base silent for')").count()
        assert not page.locator(f"{CARD.format('blue')} .robot-take-over").count()
        page.click("#stop-all")
        page.wait_for_selector(f"{STOP_ALL}:text-matches('^blue: NOT CONFIRMED for [0-9]+ s: no link$')")
        page.reload()  # the press outlives it
        page.wait_for_selector(f"{STOP_ALL}:text-matches('^blue: NOT CONFIRMED for [0-9]+ s: no link$')")
        assert status(blue).startswith("ready")
    finally:
        os.kill(link, signal.SIGCONT)
        os.kill(supervisor, signal.SIGCONT)
    page.wait_for_selector(f"{STOP_ALL}:text-is('all 2 robots are STOPPED')")
    assert status(blue).startswith("STOPPED")


@contextmanager
def at(robot: Robot) -> Iterator[Robot]:
    """See only the runs of one robot, as if each had a machine of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(robot.folder.parent / "runtime"))
        yield robot


def page_at(robot: Robot) -> str:
    with at(robot):
        return address_of(robot)


def pid_of(robot: Robot, module: str) -> int:
    with at(robot):
        return int(robot.top()[module]["pid"])


def status(robot: Robot) -> str:
    with at(robot):
        return str(robot.top()["body"]["status"])


def stops(robot: Robot) -> int:
    """Return how many requests to stop its base has got."""
    return int(status(robot).split()[-2])


def order(robot: Robot, *words: str) -> None:
    with at(robot):
        done = robot.command(*words)
    assert done.returncode == 0, done.stderr


def free(robot: Robot) -> None:
    """Release a robot at its own machine."""
    order(robot, "pub", "EmergencyStop", "{engaged: false}", "--topic", "emergency_stop")
    wait_until(lambda: status(robot).startswith("ready"))
