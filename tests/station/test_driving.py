"""The robot moves while a control is held on the page, and stops when the page or server fails."""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.messages import EmergencyStop
from tests._support.robot import COMMAND, Ended, Robot, kill, wait_until
from tests.station._support.browser import RECONNECTING, browser, needs_chromium, page_of, release
from tests.station._support.cut_link import HERE as HERE_ADDRESS
from tests.station._support.cut_link import cut_link, why_no_link
from tests.station.test_page import address_of
from tools.operator.chromium import CHROMIUM

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
NO_LINK = why_no_link()
# A hall in which one can drive ahead for long.
ARENA = "cell_m: 1.0\ndrawing: |\n  {wall}\n  #R{floor}#\n  {wall}\n".format(wall="#" * 60, floor="." * 57)
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, max_linear_m_per_s: 0.4, tabs: {drive: "", system: ""}}
  base: {class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {arena: arena.yaml}}
  witness: {class: "zoo.witness:Witness"}
"""
EXPIRY_S = 0.17
DEAD_MAN_BUTTON, SLOW_BUTTON = 5, 4
ATTEMPTS, BEGIN_LIMIT_S = 10, 5.0
"""To drive: a key has no effect while the page is not in front, or its delay not known; as it should be."""
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


def stops(
    journal: Journal, page: Page, happens: Callable[[], None], begin: Callable[[], None] | None = None
) -> None:
    """Drive ahead until something happens; then the robot stands soon, by what the base says."""
    page.bring_to_front()
    for left in reversed(range(ATTEMPTS)):
        if begin is None:
            page.keyboard.up("KeyW")  # a key that is still held from before does not count
            page.keyboard.down("KeyW")
        else:
            begin()
        try:
            wait_until(lambda: journal.speed() > 0.19, BEGIN_LIMIT_S)
            break
        except TimeoutError:  # a page that comes to the front on a busy machine may lose its focus once more
            if not left:
                raise
            page.keyboard.up("KeyW")
    happens()
    wait_until(lambda: journal.speed() == 0)
    # Needs no clock: from the last command on it went on until that expired, and then it braked.
    braking_m = 0.2**2 / BRAKING_M_PER_S2 / 2
    assert journal.way_since_last_command_m() <= 0.2 * EXPIRY_S + braking_m + 0.02


def hold(page: Page, buttons: list[int], stick: float = 1.0) -> None:
    """Hold these buttons of a gamepad, whose left stick is pushed ahead all the time."""
    page.evaluate(
        """([held, stick]) => navigator.getGamepads = () => [null, {
          axes: [0, -stick, 0, 0],
          buttons: [...Array(17).keys()].map((at) => ({ pressed: held.includes(at) })),
        }]""",
        [buttons, stick],
    )


def test_robot_stops_when_key_page_or_server_fails_and_the_page_reconnects(
    robot: Robot,
) -> None:
    process = start_in_hall(robot, PROFILE)
    address = address_of(robot)
    journal = Journal(robot)
    with browser() as started:
        with page_of(started, address, may_say=RECONNECTING) as page:
            page.wait_for_selector("#drive-pad")
            for key in ("ArrowDown", "ArrowUp"):  # which move the slider, and not the robot
                page.press("#linear-limit [tabindex]", key)
            page.wait_for_selector("text=fastest ahead 0.20 m/s")  # no key is lost before the server's answer
            stops(journal, page, lambda: let_go_elsewhere(page))
            assert all(row[1] >= 0 for row in journal.rows("command"))
            page.wait_for_selector("#control-who:has-text('you drive')")
            stops(journal, page, lambda: hold(page, []), lambda: hold(page, [DEAD_MAN_BUTTON]))
            gamepad_has_a_dead_zone_and_a_slow_button(page)
            what_is_held_since_before_does_not_drive(journal, page)
            with page_of(started, address) as other:
                other.wait_for_selector("#take-over:enabled")
                commands = len(journal.rows("command"))
                other.keyboard.press("KeyW")
                other.click("#take-over")
                assert len(journal.rows("command")) == commands
                stops(journal, other, other.close)
            page.bring_to_front()
            page.keyboard.press("t")  # takes over, in case the other page has not been given up yet
            stopped_server_delivers_nothing_late(robot, journal, page)
            killed_server_is_found_again(robot, journal, page)
        module_run_as_tool_drives_and_stops(robot, journal, started)
    ended = Ended.in_order(process, signal.SIGTERM)
    for module in (ended.modules[name] for name in ("base", "witness")):
        overflowed = module["dropped"] - module["left"]  # what waited when it was stopped is no fault
        assert [module["lost"], overflowed, module["refused"]] == [0, 0, 0]


def start_in_hall(robot: Robot, profile: str) -> "subprocess.Popen[str]":
    """Start a robot that can drive ahead for long, with a witness."""
    (robot.folder / "zoo" / "witness.py").write_text((HERE / "_support" / "witness.py").read_text())
    (robot.folder / "arena.yaml").write_text(ARENA)
    robot.write_profile(profile)
    return robot.start()


def let_go_elsewhere(page: Page) -> None:
    """Let the key go while the focus is where keys are typed."""
    page.evaluate("document.body.append(document.createElement('input'))")
    page.focus("body > input")
    page.keyboard.up("KeyW")
    page.evaluate("document.querySelector('body > input').remove()")


def gamepad_has_a_dead_zone_and_a_slow_button(page: Page) -> None:
    """A worn stick drives nothing; the left shoulder button leaves a third of the speed."""
    wish = "window.wished"
    page.evaluate("addEventListener('robbie-driven', (event) => (window.wished = event.detail.linear))")
    hold(page, [DEAD_MAN_BUTTON], stick=0.1)
    page.wait_for_function(f"{wish} === 0")
    hold(page, [DEAD_MAN_BUTTON, SLOW_BUTTON])
    page.wait_for_function(f"Math.abs({wish} - 1 / 3) < 0.001")
    hold(page, [])


def what_is_held_since_before_does_not_drive(journal: Journal, page: Page) -> None:
    """Key and button are held while the window loses the focus, and when it is back."""
    stops(journal, page, lambda: page.evaluate("dispatchEvent(new Event('blur'))"))
    page.keyboard.down("KeyW")  # it was not released: a repeat
    stops(
        journal,
        page,
        lambda: page.evaluate("dispatchEvent(new Event('blur'))"),
        lambda: hold(page, [DEAD_MAN_BUTTON]),
    )
    page.wait_for_timeout(300)
    assert (journal.speed(), journal.rows("command")[-1][1]) == (0, 0)
    hold(page, [])
    page.keyboard.up("KeyW")


def server(robot: Robot) -> int:
    return int(robot.top()["operator"]["pid"])


def stopped_server_delivers_nothing_late(robot: Robot, journal: Journal, page: Page) -> None:
    stops(journal, page, lambda: os.kill(server(robot), signal.SIGSTOP))
    page.keyboard.up("KeyW")
    # So that all that was sent is stale.
    page.evaluate("window.let_go_ms = performance.now()")
    page.wait_for_function("performance.now() > window.let_go_ms + 500")
    commands = len(journal.rows("command"))
    os.kill(server(robot), signal.SIGCONT)
    robot.until(lambda modules: modules["operator"]["state"] == "RUNNING")
    page.wait_for_selector("#velocity:has-text('0.00 m/s')")
    moving = [row for row in journal.rows("command")[commands:] if row[1] > 0]
    assert not moving, "commands from before the stop were followed after it"


def killed_server_is_found_again(robot: Robot, journal: Journal, page: Page) -> None:
    """Nobody loads the page again but the page itself, and it shows what has happened meanwhile."""
    page.click("#tab-system")
    page.click("#tab-drive")
    page.evaluate("window.is_the_old_page = true")
    killed = server(robot)
    stops(journal, page, lambda: kill(killed))
    page.keyboard.up("KeyW")
    with closing(Tool(robot.known_run(), "what happens meanwhile")) as tool:
        tool.ready()
        tool.publish(EmergencyStop(engaged=True, reason="meanwhile"), "emergency_stop")
    page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
    page.wait_for_function("window.is_the_old_page === undefined")
    figures = robot.until(lambda modules: modules["operator"]["state"] == "RUNNING")
    assert (figures["operator"]["restarts"], figures["operator"]["pid"] != killed) == (1, True)
    release(page)
    stops(journal, page, lambda: page.keyboard.up("KeyW"))


def module_run_as_tool_drives_and_stops(robot: Robot, journal: Journal, started: Browser) -> None:
    """Do the same by the page of a process that the robot does not know."""
    refused = robot.command("gui", "--run", robot.known_run().run_id)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert "this run has an operator station already: http://127.0.0.1:" in refused.stderr
    refused = robot.command("gui", "--run", robot.known_run().run_id, "--host", "0.0.0.0")
    assert refused.returncode == 2
    assert refused.stderr.startswith("0.0.0.0 can be reached from other machines: set operator_token")
    robot.command("module", "stop", "operator", "--run", robot.known_run().run_id)
    with attached_of(robot) as (program, address), page_of(started, address, may_say=RECONNECTING) as page:
        page.wait_for_selector("#drive-pad")
        page.wait_for_selector("#friends-greeting")  # of a panel in the run's workspace
        stops(journal, page, program.kill)
    with attached_of(robot) as (program, _):
        program.send_signal(signal.SIGINT)
        assert program.wait(30) == 0


@contextmanager
def attached_of(robot: Robot) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Start a page for a run that has none; it is given with its address."""
    (robot.folder / "zoo" / "own_panel.py").write_text((HERE / "_support" / "own_panel.py").read_text())
    options = ["--run", robot.known_run().run_id, "--port", "0", "--set", "max_linear_m_per_s=0.4"]
    panels = ["--set", "panels=['zoo.own_panel:FriendsPanel']", "--set", "tabs={drive: ''}"]
    command = [*COMMAND, "gui", *options, *panels]
    with subprocess.Popen(command, cwd=robot.folder.parent, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout
            yield program, program.stdout.readline().split()[2]
        finally:
            program.kill()


@pytest.mark.skipif(bool(NO_LINK), reason=f"WHAT A CUT LINK DOES IS NOT TESTED: {NO_LINK}")
def test_robot_stops_when_the_link_is_cut_and_drives_when_it_is_back(robot: Robot) -> None:
    robot.write_secret("operator.token", "drives-from-far-away")
    start_in_hall(
        robot, PROFILE.replace("{port: 0", "{port: 0, host: 0.0.0.0, operator_token: file:operator.token")
    )
    address = address_of(robot).replace("0.0.0.0", HERE_ADDRESS)
    journal = Journal(robot)
    with cut_link() as link:
        program = link.write_starter(str(CHROMIUM), robot.folder / "chromium")
        with browser(program) as started, page_of(started, address, may_say=RECONNECTING) as page:
            page.fill("#token", "drives-from-far-away")
            page.keyboard.press("Enter")
            page.wait_for_selector("#drive-pad")
            stops(journal, page, link.cut)
            page.keyboard.up("KeyW")
            link.restore()
            page.wait_for_function("document.getElementById('popup').ariaHidden !== 'false'")
            stops(journal, page, lambda: page.keyboard.up("KeyW"))
