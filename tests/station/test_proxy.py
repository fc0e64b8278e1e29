"""The page behind a real nginx, in a real browser: under a path, with TLS."""

import json
import re
import select
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from playwright.sync_api import Page

from robbie_mp.run.operator_link import read_link
from tests._support.robot import Robot, wait_until
from tests.station._support.browser import LAPTOP, browser, needs_chromium, page_of, release
from tests.station._support.proxy import (
    DOCUMENTED_STATION,
    documented_location,
    free_port,
    needs_nginx,
    nginx,
)
from tests.station.test_page import LOST

pytestmark = [needs_chromium, needs_nginx, pytest.mark.slow, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
TOKEN = "opens-everything"
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {{port: 0, operator_token: file:operator.token, tabs: {tabs}, {more}}}
  base: {{class: "zoo.modules:StandingBase"}}
  known: {{class: "zoo.known_robot:KnownRobot"}}
"""
TABS = '{cameras: "", map: "", drive: ""}'
SOCKETS = """proxy_http_version 1.1;
        proxy_set_header Upgrade $http_upgrade;
        proxy_set_header Connection "upgrade";"""
PICTURE = "document.querySelector('.newest-image .picture-age')"
MAP = "document.querySelector('#map-text').innerText.length > 0"
REFUSED = (
    "WebSocket connection to",
    "Failed to load resource: the server responded with a status of 403",
    *LOST,
)
"""Begins what the browser says of a page whose requests are refused."""
HALF_A_LOGIN = b"POST /login HTTP/1.1\r\nHost: %s\r\nOrigin: http://%s\r\nContent-Length: 8\r\n\r\n"
"""All but its body."""
BROWSERS = 40
INSECURE: dict[str, Any] = {**LAPTOP, "ignore_https_errors": True}


def start(robot: Robot, **settings: object) -> str:
    """Start a robot with an operator station, and return where it listens."""
    (robot.folder / "zoo" / "known_robot.py").write_text((HERE / "_support" / "known_robot.py").read_text())
    robot.write_secret("operator.token", TOKEN)
    more = ", ".join(f"{name}: {json.dumps(value)}" for name, value in settings.items())
    robot.write_profile(PROFILE.format(tabs=TABS, more=more))
    robot.start()
    figures = robot.until(lambda modules: "http://127.0.0.1:" in modules["operator"]["status"])
    return str(re.findall(r"http://(127\.0\.0\.1:\d+)/", figures["operator"]["status"])[-1])


def location(path: str, to: str, *more: str) -> str:
    return f"location {path} {{ proxy_pass http://{to}; {' '.join(more)} }}"


@contextmanager
def open_page(address: str, **more: Any) -> Iterator[Page]:
    with browser() as started, page_of(started, address, INSECURE, **more) as page:
        yield page


def log_in(page: Page) -> None:
    page.fill("#token", TOKEN)
    page.keyboard.press("Enter")


def everything_works(page: Page, address: str) -> None:
    """Log in, stop the robot and release it, and look at pictures, a second window and the map."""
    log_in(page)
    page.wait_for_selector("#emergency-stop-state:has-text('ready')")
    page.wait_for_url(lambda url: url.startswith(f"{address}?layout="))
    page.click("#tab-cameras")
    page.wait_for_function(PICTURE)
    page.click("#tab-map")
    page.wait_for_function(MAP)
    page.click("#emergency-stop")
    page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
    release(page)
    second_window_has_the_same_session(page, address)
    page.click("#look")
    page.wait_for_function("document.cookie.includes('robbie-look=light')")
    page.reload()
    page.wait_for_selector("body.body--light")


def log_out_works(address: str) -> None:
    # Before the browser leaves the page, its sockets may ask once more, and are refused; what it is still
    # loading is cut off.
    with open_page(address, may_say=("WebSocket connection to", "Failed to load resource")) as page:
        log_in(page)
        page.wait_for_selector("#emergency-stop-state:has-text('ready')")
        page.click("#log-out")
        page.wait_for_selector("#token")
        assert page.url == f"{address}login"
        page.goto(address)
        page.wait_for_selector("#token")


def second_window_has_the_same_session(page: Page, address: str) -> None:
    page.click("#tab-drive")
    with page.expect_popup() as opened:
        page.click("#pop-out-drive")
    opened.value.wait_for_selector("#drive-pad")
    assert opened.value.url == f"{address}tile/drive"
    opened.value.close()


def session_cookie(page: Page) -> Any:
    (found,) = (one for one in page.context.cookies() if one.get("name") == "robbie_session")
    return found


def test_page_works_below_a_path_with_tls_as_documented(robot: Robot, tmp_path: Path) -> None:
    port = free_port()
    address = f"https://127.0.0.1:{port}/robot1/"
    station = start(robot, public_address=address)
    assert read_link(robot.known_run().folder) == address
    documented = documented_location()
    assert DOCUMENTED_STATION in documented
    served = documented.replace(DOCUMENTED_STATION, station)
    with nginx(tmp_path / "nginx", port, served, tls=True):
        with open_page(address) as page:
            page.wait_for_selector("#token")
            assert page.url == f"{address}login"
            assert not page.locator("#address").is_visible()
            everything_works(page, address)
            cookie = session_cookie(page)
            assert (cookie["path"], cookie["secure"], cookie["sameSite"]) == ("/robot1", True, "Strict")
        log_out_works(address)


def test_page_works_below_a_path_that_the_proxy_leaves(robot: Robot, tmp_path: Path) -> None:
    port = free_port()
    address = f"http://127.0.0.1:{port}/lab/robot1/"
    station = start(robot, public_address=address)
    served = location("/lab/robot1", station, SOCKETS)
    with nginx(tmp_path / "nginx", port, served):
        with open_page(address[:-1]) as page:
            everything_works(page, address)
        log_out_works(address)


def test_refused_address_is_shown_with_what_to_set(robot: Robot, tmp_path: Path) -> None:
    port = free_port()
    address = f"http://127.0.0.1:{port}"
    station = start(robot)
    served = [location("/", station, SOCKETS), location("/robot1/", f"{station}/", SOCKETS)]
    with nginx(tmp_path / "nginx", port, "\n".join(served)), open_page(address, may_say=REFUSED) as page:
        page.wait_for_selector(f"#address:has-text('public_address: {address}/')")
        log_in(page)
        page.wait_for_selector(f"main:has-text('from a page of {address}, but it was sent to {station}')")
        assert f"\npublic_address: {address}/\n" in page.inner_text("main")
        page.goto(f"{address}/login?token={TOKEN}")  # the page comes, but not its scripts
        page.wait_for_selector(f"#link-refused:has-text('public_address: {address}/')")
        page.goto(f"{address}/robot1/")
        page.wait_for_selector(f"#address:has-text('public_address: {address}/robot1/')")
        assert page.url == f"{address}/robot1/login"
    assert robot.log("operator").count(f"to '{station}' from a page of '{address}'") == 1
    robot.until(lambda modules: "requests from pages of other sites refused" in modules["operator"]["status"])


def test_many_browsers_behind_a_trusted_proxy_log_in_at_once(robot: Robot, tmp_path: Path) -> None:
    port = free_port()
    host = f"127.0.0.1:{port}"
    station = start(robot, public_address=f"http://{host}/", trusted_proxies=["127.0.0.1"])
    server = psutil.Process(robot.top()["operator"]["pid"])
    served = location("/", station, "proxy_request_buffering off;")
    with nginx(tmp_path / "nginx", port, served), ExitStack() as stack:
        made = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(BROWSERS)]
        for one in made:
            one.sendall(HALF_A_LOGIN.replace(b"%s", host.encode()))
        # All are there, or the first one was closed for the others.
        wait_until(lambda: connected(server) >= BROWSERS or bool(select.select(made, [], [], 0)[0]))
        for one in made:
            one.sendall(b"token=no")
        answers = {one.recv(100).split()[1] for one in made}
    assert answers == {b"403", b"429"}  # wrong tokens, and then too many of them


def connected(server: psutil.Process) -> int:
    """Return how many connections a process has now."""
    return sum(one.status == psutil.CONN_ESTABLISHED for one in server.net_connections("tcp4"))


def test_page_says_that_a_proxy_does_not_pass_its_sockets(robot: Robot, tmp_path: Path) -> None:
    port = free_port()
    address = f"http://127.0.0.1:{port}/"
    station = start(robot, public_address=address)
    with (
        nginx(tmp_path / "nginx", port, location("/", station)),
        open_page(address, may_say=("WebSocket connection to",)) as page,
    ):
        log_in(page)
        page.wait_for_selector("#link-refused:has-text('A proxy must pass them on')")
