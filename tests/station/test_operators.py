"""Two laptops are connected to one robot; the pages of both show who drives, and both stop the robot."""

import subprocess
import time
from types import SimpleNamespace
from typing import Any

import pytest
from playwright.sync_api import Page

from robbie_mp.cli.runs import live_runs
from robbie_mp.messages import LinkState, Message, OperatorRequest, OperatorState
from robbie_mp.run.operator_link import read_link
from robbie_mp.station.driving.command import RobotCommand
from robbie_mp.station.watch.latest import Latest
from tests._support.robot import Robot, wait_until
from tests.connect.link._support.pair import free_port
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_driving import Journal, start_in_hall

PROFILE = """
modules:
  base: {{class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {{arena: arena.yaml}}}}
  witness: {{class: "zoo.witness:Witness"}}
  link:
    class: robbie_mp.connect.link.module:Link
    settings:
      robot: red
      listen: [{address}]
      send:
        urgent: ["EmergencyStop emergency_stop_state"]
        state: ["Odometry odom"]
        reliable: ["ControlState control"]
      accept: {{"*": ["DriveCommand manual", "EmergencyStop emergency_stop"]}}
"""


class Station:
    """What `RobotCommand` sees of the station of `own`.

    Args:
        own: the name of that side of the link.
    """

    def __init__(self, own: str):
        self.asked: list[int] = []
        self.state, self.link = Latest[OperatorState](), Latest[LinkState]()
        self.link.put(LinkState(robot=own))

    def newest(self, message_type: type[Message]) -> Latest[Any]:
        return self.state if message_type is OperatorState else self.link

    def publish(self, message: OperatorRequest, topic: str) -> bool:
        self.asked.append(message.wish)
        return topic == "operator_request"


def seen_by(own: str, operator: str, refused: str = "") -> tuple[RobotCommand, Station]:
    station = Station(own)
    command = RobotCommand(station, station.publish)  # type: ignore[arg-type]
    station.state.put(OperatorState(robot="red", operator=operator, refused_operator=refused))
    return command, station


def test_station_of_a_robot_without_a_link_asks_nobody() -> None:
    station = Station("red")
    command = RobotCommand(station, station.publish)  # type: ignore[arg-type]
    command.take()
    command.take(over=True)
    command.give_up()
    assert (command.other, command.is_here, station.asked) == ("", False, [])


@pytest.mark.parametrize(
    ("own", "operator", "expected"),
    [
        ("anna", "", SimpleNamespace(other="", is_here=False, asked=[0, 1])),
        ("anna", "anna", SimpleNamespace(other="", is_here=False, asked=[2])),
        ("anna", "ben", SimpleNamespace(other="ben", is_here=False, asked=[1])),
        ("red", "ben", SimpleNamespace(other="ben", is_here=True, asked=[1])),
        ("red", "red", SimpleNamespace(other="", is_here=True, asked=[2])),
    ],
)
def test_station_asks_only_for_what_it_does_not_have(own: str, operator: str, expected: Any) -> None:
    command, station = seen_by(own, operator)
    command.take()
    command.take(over=True)
    command.give_up()
    found = SimpleNamespace(other=command.other, is_here=command.is_here, asked=station.asked)
    assert found == expected


def test_only_the_operator_who_drives_is_told_whose_commands_are_refused() -> None:
    assert seen_by("anna", "anna", "ben")[0].rival == "ben"
    assert seen_by("ben", "anna", "ben")[0].rival == ""


@needs_chromium
@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(300)
def test_pages_of_two_laptops_show_who_drives_and_both_stop_the_robot(robot: Robot) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    start_in_hall(robot, PROFILE.format(address=address))
    laptops = {name: connected(robot, address, name) for name in ("anna", "ben")}
    journal = Journal(robot)
    with browser() as started, page_of(started, page_address(laptops["anna"])) as anna:
        anna.wait_for_selector("#control-who:has-text('modules drive')")
        held(anna, "KeyW", lambda: journal.speed() > 0.1)
        anna.wait_for_selector("#control-who:has-text('you drive')")
        anna.keyboard.up("KeyW")
        wait_until(lambda: journal.speed() == 0)
        anna.wait_for_selector("#control-mode:has-text('HOLD')")
        anna.click("#go-on")
        anna.wait_for_selector("#control-mode:has-text('AUTO')")
        anna.click("#hold")
        anna.wait_for_selector("#control-mode:has-text('HOLD')")
        with page_of(started, page_address(laptops["ben"])) as ben:
            # On a busy machine, a page loads for longer than a seat is kept without driving.
            held(anna, "KeyW", lambda: journal.speed() > 0.1)
            anna.keyboard.up("KeyW")
            wait_until(lambda: journal.speed() == 0)
            ben.wait_for_selector("#control-who:has-text('anna drives')")
            commands = len(journal.rows("command"))
            ben.bring_to_front()
            ben.keyboard.down("KeyW")
            ben.wait_for_selector("text=anna drives: your commands are refused. Take over to drive")
            anna.wait_for_selector("#control-why:has-text('commands of ben are refused')")
            assert (len(journal.rows("command")), journal.speed()) == (commands, 0)
            ben.keyboard.up("KeyW")
            ben.click("#take-over")
            anna.wait_for_selector("#control-who:has-text('ben drives')")
            held(ben, "KeyW", lambda: journal.speed() > 0.1)
            ben.wait_for_selector("#control-who:has-text('you drive')")
            anna.bring_to_front()
            anna.keyboard.press("Escape")
            ben.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
            wait_until(lambda: journal.speed() == 0)


def connected(robot: Robot, address: str, name: str) -> "subprocess.Popen[str]":
    """Start `robbie connect` on a laptop."""
    options = ("--at", address, "--as", name, "--set", "operator.port=0")
    return robot.start(*options, profile="red", output=robot.folder / f"out-{name}", command=("connect",))


def page_address(laptop: "subprocess.Popen[str]") -> str:
    """The link to the page of a laptop."""
    links: list[str] = []

    def has_come() -> bool:
        for run in live_runs():
            if run.record is not None and run.record.supervisor_pid == laptop.pid:
                links.extend(filter(None, [read_link(run.folder)]))
        return bool(links)

    wait_until(has_come)
    return links[0]


def held(page: Page, key: str, happens: Any) -> None:
    """Hold a key until something happens; it stays held.

    A page that has lost control once, as on a busy machine, has the operator take hold again.
    """
    page.bring_to_front()
    page.keyboard.down(key)
    again_s = time.monotonic() + 5.0

    def has_happened() -> bool:
        nonlocal again_s
        if not happens() and time.monotonic() > again_s:
            page.keyboard.up(key)
            page.keyboard.down(key)
            again_s = time.monotonic() + 5.0
        return bool(happens())

    wait_until(has_happened)
