"""The question about a victim does not change while the operator presses a button."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.messages import String
from robbie_robots.modules.rescue.messages import AnswerVictim
from robbie_robots.modules.rescue.station.victim_question import checked
from tests._support.robot import Robot, wait_until
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of

HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      panels: ["robbie_robots.modules.rescue.station.mission_panel:MissionPanel"]
      tabs: {drive: "", camera: "", map: ""}  # the question is on every tab, even if the panel has none
  victims: {class: "zoo.two_victims:TwoVictims"}
"""
QUESTION = "#victim-question"
COVERS_NO_TILE = """() => {
  const question = document.querySelector("#victim-question").getBoundingClientRect();
  const tiles = [...document.querySelectorAll(".tile")].map((one) => one.getBoundingClientRect());
  return tiles.length && question.bottom <= innerHeight && tiles.every((one) => one.bottom <= question.top);
}"""
"""Once the grid has made room for the question."""
WITHIN_REACH = {
    "#emergency-stop": 48,
    "#hold": 48,
    "#tile-camera": 100,
    "#drive-pad": 100,
    "#victim-yes": 48,
    "#victim-undo": 48,
}
"""What a telephone shows, and how many pixels wide and high it is at least."""
IS_WITHIN_REACH = """([part, least]) => {
  const { left, right, top, bottom, width, height } = document.querySelector(part).getBoundingClientRect();
  const is_inside = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight;
  return is_inside && Math.min(width, height) >= least;
}"""
COUNT_QUESTIONS = """(milliseconds) => new Promise((done) => {
  const found = new Set();
  const until = performance.now() + milliseconds;
  const look = () => {
    found.add(document.querySelector("#victim-question")?.innerText.match(/tag \\d+/)?.[0]);
    performance.now() < until ? requestAnimationFrame(look) : done([...found]);
  };
  look();
})"""


@contextmanager
def told_to(robot: Robot) -> Iterator[Tool]:
    with closing(Tool(robot.known_run(), "a test")) as tool:
        tool.ready()
        yield tool


def answers(robot: Robot) -> list[str]:
    return (robot.output / "told.txt").read_text().splitlines()


@needs_chromium
@pytest.mark.timeout(300)
@pytest.mark.slow
def test_answer_is_about_the_victim_shown_when_the_button_was_pressed(robot: Robot) -> None:
    (robot.folder / "zoo" / "two_victims.py").write_text((HERE / "_support" / "two_victims.py").read_text())
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page, told_to(robot) as tool:
        page.wait_for_selector(f"{QUESTION}:has-text('tag')")
        page.wait_for_selector(f"{QUESTION}:has-text('(1 of 2)')")
        page.wait_for_function(COVERS_NO_TILE)
        assert len(page.evaluate(COUNT_QUESTIONS, 2000)) == 1, "the question changes by itself"
        answer_is_taken_back(page)
        telephone_has_all_within_reach(page)
        question_under_the_finger_stays(page, robot, tool)
        press_for_the_question_before_does_not_answer_the_next(page, robot, tool)
        question_of_a_silent_robot_shows_its_age(page, tool)


def telephone_has_all_within_reach(page: Page) -> None:
    """Upright and across, without scrolling."""
    before = page.viewport_size
    for width, height in ((390, 844), (844, 390)):
        page.set_viewport_size({"width": width, "height": height})
        for part, least_px in WITHIN_REACH.items():
            page.wait_for_function(IS_WITHIN_REACH, arg=[part, least_px])
    assert before
    page.set_viewport_size(before)
    page.wait_for_function(COVERS_NO_TILE)


def shown(page: Page) -> int:
    return 3 if "tag 3" in page.inner_text(QUESTION) else 8


def answer_is_taken_back(page: Page) -> None:
    """Press the wrong key, and take it back: the robot never hears of it, as what it was told later says."""
    page.wait_for_selector("#victim-no:enabled")
    page.keyboard.press("n")
    page.wait_for_selector("#victim-waiting:has-text('“No” is sent in')")
    page.keyboard.press("u")
    page.wait_for_selector("#victim-waiting", state="detached")
    page.click("#victim-yes")
    page.click("#victim-undo")
    page.wait_for_selector("#victim-undo:disabled")


def question_under_the_finger_stays(page: Page, robot: Robot, tool: Tool) -> None:
    """Hold the button down while the robot takes the question back and another page asks the next one."""
    first = shown(page)
    other = 11 - first
    with page.context.expect_page() as opened:
        page.evaluate("window.open(location.href)")
    second_page = opened.value
    second_page.wait_for_selector(f"{QUESTION}:has-text('tag')")
    page.bring_to_front()
    page.hover("#victim-yes")
    page.mouse.down()
    tool.publish(String(data=str(other)), "orders")
    second_page.wait_for_selector(f"{QUESTION}:has-text('tag {other}')")
    page.evaluate(COUNT_QUESTIONS, 1000)
    page.mouse.up()
    wait_until(lambda: answers(robot) != [])
    assert answers(robot) == [f"answer {first} {AnswerVictim.YES}"]
    page.wait_for_selector(f"{QUESTION}:has-text('tag {other}')")
    second_page.close()


def press_for_the_question_before_does_not_answer_the_next(page: Page, robot: Robot, tool: Tool) -> None:
    """Press at the moment at which the next question replaces the intended one."""
    before = shown(page)
    page.wait_for_selector("#victim-no:enabled")
    page.evaluate(
        """(name) => new MutationObserver((_, observer) => {
          if (!document.querySelector("#victim-question")?.innerText.includes(name)) return;
          observer.disconnect();
          document.querySelector("#victim-no").click();
          window.pressed = true;
        }).observe(document.body, { childList: true, subtree: true, characterData: true })""",
        f"tag {11 - before}",
    )
    tool.publish(String(data=str(11 - before)), "orders")
    page.wait_for_function("window.pressed")
    page.click("#victim-later")  # as soon as it can be pressed
    wait_until(lambda: len(answers(robot)) > 1)
    assert answers(robot)[1:] == [f"answer {11 - before} {AnswerVictim.LATER}"]


def question_of_a_silent_robot_shows_its_age(page: Page, tool: Tool) -> None:
    assert page.locator("#victim-silent").count() == 0
    tool.publish(String(data=""), "orders")
    page.wait_for_selector("#victim-silent:has-text('no news of it for 1')")


@pytest.mark.parametrize(
    "sent",
    [None, 3, [], {}, {"id": 3}, {"id": "3", "answer": 1}, {"id": 3, "answer": 9}, {"id": True, "answer": 1}],
)
def test_malformed_answers_are_ignored(sent: object) -> None:
    assert checked(sent) is None


def test_answer_names_its_victim() -> None:
    assert checked({"id": 3, "answer": AnswerVictim.LATER}) == (3, AnswerVictim.LATER)
