"""The robot moves while a control is held on the page, and stands whatever becomes of page or server."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests.operator_station.browser import browser, needs_chromium, page_of
from tests.operator_station.test_page import address_of
from tests.run.robot import Robot, wait_until

pytestmark = [needs_chromium, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
# A hall in which one can drive ahead for long.
ARENA = "cell_m: 1.0\ndrawing: |\n  {wall}\n  #R{floor}#\n  {wall}\n".format(wall="#" * 60, floor="." * 57)
PROFILE = """
modules:
  operator:
    class: robbie_mp.services.operator_station:OperatorStation
    settings: {port: 0, max_linear_m_per_s: 0.4}
  base: {class: "modules.base:SimulatedBase", settings: {arena: arena.yaml}}
  witness: {class: "zoo.witness:Witness"}
"""
EXPIRY_S = 0.22
BRAKING_M_PER_S2 = 6.0


class Journal:
    """What the witness has written."""

    def __init__(self, robot: Robot):
        self._file = robot.output / "witness.txt"

    def rows(self, what: str) -> list[tuple[float, ...]]:
        if not self._file.exists():
            return []
        whole = self._file.read_text().rpartition("\n")[0]
        lines = [line.split() for line in whole.splitlines()]
        return [tuple(map(float, line[1:])) for line in lines if line[0] == what]

    def speed(self) -> float:
        rows = self.rows("odometry")
        return rows[-1][2] if rows else 0.0

    def way_since_last_command_m(self) -> float:
        """How far the robot went after the last command that moved it."""
        last_s = [row[0] for row in self.rows("command") if row[1] > 0][-1]
        before = [row for row in self.rows("odometry") if row[0] <= last_s][-1]
        speed = before[2]
        return self.rows("odometry")[-1][1] - before[1] - speed * (last_s - before[0])


def stops(journal: Journal, page: Page, happens: Callable[[], None]) -> None:
    """Drive ahead until something happens; then the robot stands soon, by what the base says."""
    page.bring_to_front()
    page.keyboard.down("KeyW")
    wait_until(lambda: journal.speed() > 0.19)
    happens()
    wait_until(lambda: journal.speed() == 0)
    # Needs no clock: from the last command on it went on until that expired, and then it braked.
    braking_m = 0.2**2 / BRAKING_M_PER_S2 / 2
    assert journal.way_since_last_command_m() <= 0.2 * EXPIRY_S + braking_m + 0.02


def test_robot_stands_when_the_key_is_let_go_the_page_is_closed_or_the_server_is_stopped_or_killed(
    robot: Robot,
) -> None:
    (robot.folder / "zoo" / "witness.py").write_text((HERE / "witness.py").read_text())
    (robot.folder / "arena.yaml").write_text(ARENA)
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    journal = Journal(robot)

    def server() -> int:
        return int(robot.top()["operator"]["pid"])

    with browser() as started:
        with page_of(started, address) as page:
            page.wait_for_selector("#drive-pad")
            stops(journal, page, lambda: page.keyboard.up("KeyW"))
            page.wait_for_selector("#drivers-seat:has-text('this page drives')")
            with page_of(started, address) as other:
                other.wait_for_selector("#take-over:visible")
                commands = len(journal.rows("command"))
                other.keyboard.press("KeyW")
                other.click("#take-over")
                assert len(journal.rows("command")) == commands
                stops(journal, other, other.close)
        with page_of(started, address) as page:
            page.wait_for_selector("#drive-pad")
            stops(journal, page, lambda: os.kill(server(), signal.SIGSTOP))
            page.keyboard.up("KeyW")
            # So that all that was sent is stale.
            page.evaluate("window.let_go_ms = performance.now()")
            page.wait_for_function("performance.now() > window.let_go_ms + 500")
            commands = len(journal.rows("command"))
            os.kill(server(), signal.SIGCONT)
            robot.until(lambda modules: modules["operator"]["state"] == "RUNNING")
            page.wait_for_selector("#velocity:has-text('0.00 m/s')")
            moving = [row for row in journal.rows("command")[commands:] if row[1] > 0]
            assert not moving, "commands from before the stop were followed after it"
