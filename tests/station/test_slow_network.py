"""Through a slow network no old command drives the robot, and the picture is small rather than old."""

import re
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests._support.delaying_proxy import delaying_proxy
from tests._support.robot import Robot, wait_until
from tests.security.station._support.attacker import Attacker, Document, PageSocket, listener_of
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_driving import PROFILE, Journal, start_in_hall
from tests.station.test_page import address_of
from tools.operator.video import NO_DECODER, SHOWN

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(300)]
TOKEN = "drives-from-far-away"
BEAT_S = 0.05
STANDS_WITHIN_S = 0.4
LIMIT_S = 0.2
CAMERA = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  camera: {class: "tools.operator.moving_camera:MovingCamera"}
"""
FRESH_AND_SMOOTH = """([least, oldest_s, least_px]) => {
  const note = (at) => (window.shown = [...(window.shown ?? []), at].slice(-100));
  const born_s = window.picture_to_drive_by?.born_s, now = performance.now();
  if (born_s && born_s !== window.last_s) {
    window.last_s = born_s;
    const text = document.querySelector(".camera-picture .picture-age")?.textContent ?? "99";
    note([now, parseFloat(text), SHOWN?.naturalWidth ?? SHOWN?.width ?? 0]);
  }
  const last = (window.shown ?? []).filter(([at, , width]) => at > now - 2000 && width >= least_px);
  const ages = last.map(([, age]) => age).sort();
  return last.length >= 2 * least && ages[Math.floor(ages.length / 2)] <= oldest_s;
}""".replace("SHOWN", SHOWN)
"""Whether the last 2 s had `least` pictures a second as wide, half of them at most `oldest_s` old."""


@pytest.fixture
def journal(robot: Robot) -> Iterator[Journal]:
    """What happens on a robot in a long hall."""
    robot.write_secret("operator.token", TOKEN)
    start_in_hall(robot, PROFILE.replace("{port: 0", "{port: 0, operator_token: file:operator.token"))
    address_of(robot)
    yield Journal(robot)


def port_of(robot: Robot) -> int:
    found = re.search(r":(\d+)/", robot.top()["operator"]["status"])
    assert found
    return int(found[1])


class Page:
    """A page without a browser that is far away; its monotonic clock is that of this machine."""

    def __init__(self, socket: PageSocket, document: Document):
        self._socket = socket
        self._document = document
        self._element, self._listener = listener_of(document.elements, "drive", id="driver")
        self.let_go_s = 0.0

    def drive(self, for_s: float) -> None:
        """Hold the control for some time, and let go."""
        until_s, begins = time.monotonic() + for_s, True
        while time.monotonic() < until_s:
            self._send(held=True, begins=begins)
            begins = False
            self.wait(BEAT_S)
        self.let_go_s = time.monotonic()
        self._send(held=False, begins=False)

    def wait(self, for_s: float) -> None:
        """Do what a page does while nothing is pressed."""
        self._socket.listen(for_s)
        self._socket.answer_delay_pings(self._document)

    def _send(self, **more: bool) -> None:
        wish = {"linear": 1.0 if more["held"] else 0.0, "angular": 0.0, "sent_s": time.monotonic(), **more}
        self._socket.fire(self._document.client_id, self._element, self._listener, wish)


def driven(journal: Journal) -> list[float]:
    """Return when the robot moved."""
    return [row[0] for row in journal.rows("odometry") if row[2] > 0.0]


@pytest.mark.parametrize("delay_s", [0.3, 2.5])
def test_page_that_is_too_far_away_never_drives_the_robot(
    robot: Robot, journal: Journal, delay_s: float
) -> None:
    operator = Attacker(port_of(robot)).log_in(TOKEN)
    document = operator.open()
    with delaying_proxy(operator.port, delay_s) as proxy:
        far = Attacker(proxy.port, operator.cookie)
        with far.connect(document.query) as socket:
            page = Page(socket, document)
            page.wait(2 * delay_s + 1.0)
            page.drive(3.0)
            page.wait(2 * delay_s + 1.0)
    assert driven(journal) == []
    assert not [row for row in journal.rows("command") if row[1] > 0]


@pytest.mark.parametrize("delay_s", [0.3, 2.5])
def test_robot_stands_soon_when_the_network_becomes_slow_while_it_drives(
    robot: Robot, journal: Journal, delay_s: float
) -> None:
    operator = Attacker(port_of(robot)).log_in(TOKEN)
    document = operator.open()
    with delaying_proxy(operator.port) as proxy:
        far = Attacker(proxy.port, operator.cookie)
        with far.connect(document.query) as socket:
            page = Page(socket, document)
            page.wait(1.0)
            page.drive(2.0)
            wait_until(lambda: journal.speed() == 0)
            moved = driven(journal)
            assert moved
            assert moved[-1] - page.let_go_s <= STANDS_WITHIN_S
            proxy.delay_s = delay_s
            slow_s = time.monotonic()
            page.drive(3.0)
            page.wait(2 * delay_s + 1.0)
    assert [at for at in driven(journal) if at > slow_s] == []


def test_robot_of_a_page_that_is_not_too_far_away_stands_soon_after_letting_go(
    robot: Robot, journal: Journal
) -> None:
    operator = Attacker(port_of(robot)).log_in(TOKEN)
    document = operator.open()
    with delaying_proxy(operator.port, 0.04) as proxy:
        far = Attacker(proxy.port, operator.cookie)
        with far.connect(document.query) as socket:
            page = Page(socket, document)
            page.wait(1.0)
            page.drive(2.0)
            page.wait(0.5)
    wait_until(lambda: journal.speed() == 0)
    moved = driven(journal)
    assert moved
    assert moved[-1] - page.let_go_s <= STANDS_WITHIN_S


@needs_chromium
def test_page_says_that_the_delay_is_too_long_to_drive(robot: Robot, journal: Journal) -> None:
    with (
        delaying_proxy(port_of(robot), 0.3) as proxy,
        browser() as started,
        page_of(started, f"http://127.0.0.1:{proxy.port}/login", may_say=("",)) as page,
    ):
        page.fill("#token", TOKEN)
        page.keyboard.press("Enter")
        page.wait_for_selector("#control-why:has-text('s: too long to drive')")
        page.keyboard.down("KeyW")
        page.wait_for_selector("#control-why:has-text('too long to drive')")
        page.wait_for_timeout(1500)
        page.keyboard.up("KeyW")
        assert driven(journal) == []
        proxy.delay_s = 0.0
        page.wait_for_selector("#control-who:has-text('nobody drives')")
        page.keyboard.down("KeyW")
        wait_until(lambda: journal.speed() > 0.1)
        page.keyboard.up("KeyW")
        wait_until(lambda: journal.speed() == 0)


@needs_chromium
@pytest.mark.parametrize(
    ("script", "mbit_per_s", "least_per_s", "oldest_s", "least_px"),
    [
        ("", 1.0, 7, 0.4, 480),
        ("", 0.3, 3, 0.7, 320),
        (NO_DECODER, 1.0, 7, 0.4, 240),
        (NO_DECODER, 0.3, 3, 0.7, 240),
    ],
)
def test_picture_over_a_slow_network_is_fresh_and_smooth(
    robot: Robot, script: str, mbit_per_s: float, least_per_s: int, oldest_s: float, least_px: int
) -> None:
    robot.write_profile(CAMERA)
    robot.start()
    address = urlsplit(address_of(robot))
    with (
        delaying_proxy(address.port or 0, 0.04, mbit_per_s * 1e6 / 8) as proxy,
        browser() as started,
        page_of(
            started,
            address._replace(netloc=f"127.0.0.1:{proxy.port}").geturl(),
            may_say=("",),
            script=script,
        ) as page,
    ):
        page.wait_for_function(FRESH_AND_SMOOTH, arg=[least_per_s, oldest_s, least_px], polling="raf")
