"""Only authorized visitors steer the robot: tokens, sessions, origins, and one driver at a time."""

import asyncio
import sys
from contextlib import closing
from typing import Any

import pytest
from starlette.types import Message, Scope

from robbie_mp import ModuleHarness, Secret, SettingError
from robbie_mp.station import OperatorStation
from robbie_mp.station.driving.seat import DriversSeat
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS, panels_in_order
from robbie_mp.station.web.access import MAX_SESSIONS, Access, Role
from robbie_mp.station.web.connections import MAX_BEHIND_PROXIES, MAX_STRANGERS, Connections
from robbie_mp.station.web.gate import (
    MESSAGES_BURST,
    MESSAGES_PER_S,
    SESSION_COOKIE,
    Gate,
    paced,
    with_forwarded,
)
from robbie_mp.station.web.listening import AddressUnusable, listen
from robbie_mp.station.web.proxy import public_address

OPERATOR, OBSERVER = "correct-horse-battery", "only-looking-please"
OWN_PANEL = "tests.station._support.own_panel"


PEER = ("192.0.2.7", 1234)


class Transport:
    """The end of a connection that nobody is at."""

    def __init__(self, peer: tuple[str, int] = PEER):
        self._peer = peer

    def get_extra_info(self, _name: str) -> object:
        return self._peer

    def abort(self) -> None:
        """End it."""


class Visitor:
    """Sends requests through a gate, behind which an application answers 200."""

    def __init__(self, operator_token: str = OPERATOR, observer_token: str = "", public: str = ""):
        self.access = Access(operator_token, observer_token)
        self.connections = Connections()
        self.connections.enter(Transport())  # type: ignore[arg-type]
        self.gate = Gate(self._behind, self.access, self.connections, public_address(public))
        self.reached = 0
        self.headers: list[str] = []

    async def _behind(self, scope: Scope, receive: Any, send: Any) -> None:
        self.reached += 1
        self.headers = [name.decode() for name, _ in scope["headers"]]
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    def ask(
        self, path: str = "/", method: str = "GET", kind: str = "http", body: bytes = b"", **headers: str
    ) -> list[Message]:
        headers = {"host": "127.0.0.1:8080", **headers}
        scope: Scope = {
            "type": kind,
            "path": path,
            "method": method,
            "query_string": b"",
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
            "client": PEER,
        }
        sent: list[Message] = []

        async def receive() -> Message:
            return {"type": "http.request", "body": body, "more_body": False}

        async def send(message: Message) -> None:
            sent.append(message)

        asyncio.run(self.gate(scope, receive, send))
        return sent

    def status(self, *arguments: Any, **headers: Any) -> int:
        return int(self.ask(*arguments, **headers)[0]["status"])

    def log_in(self, token: str) -> str | None:
        answer = self.ask("/login", "POST", body=f"token={token}".encode())[0]
        cookies = [value.decode() for name, value in answer["headers"] if name == b"set-cookie"]
        assert all("HttpOnly" in cookie and "SameSite=strict" in cookie for cookie in cookies)
        return cookies[0].split(";")[0] if cookies else None


def test_nothing_is_served_and_no_connection_opened_without_a_token() -> None:
    visitor = Visitor(OPERATOR)
    assert visitor.status() == 303
    assert visitor.status("/_nicegui/secret") == 401
    assert visitor.ask("/socket.io/", kind="websocket") == [
        {"type": "websocket.close", "code": 1008, "reason": ""}
    ]
    assert visitor.status(cookie=f"{SESSION_COOKIE}=guessed") == 303
    assert visitor.status(cookie="\x00;;;=") == 303
    assert visitor.reached == 0


def test_wrong_token_is_refused_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    visitor = Visitor(OPERATOR, OBSERVER)
    assert visitor.log_in("wrong") is None
    assert visitor.log_in("") is None
    assert "wrong token from 192.0.2.7" in caplog.text


@pytest.mark.parametrize(("token", "role"), [(OPERATOR, Role.OPERATOR), (OBSERVER, Role.OBSERVER)])
def test_token_determines_the_role(token: str, role: Role) -> None:
    visitor = Visitor(OPERATOR, OBSERVER)
    cookie = visitor.log_in(token)
    assert cookie is not None
    assert visitor.status(cookie=cookie) == 200
    assert visitor.access.role_of(cookie.partition("=")[2]) is role


def test_requests_from_another_site_are_refused(caplog: pytest.LogCaptureFixture) -> None:
    visitor = Visitor()
    cookie = visitor.log_in(OPERATOR)
    assert cookie is not None
    assert visitor.status(origin="http://evil.example") == 403
    assert visitor.status(origin="http://127.0.0.1:9999") == 403
    assert visitor.ask("/socket.io/", kind="websocket", origin="null")[0]["type"] == "websocket.close"
    assert visitor.status(origin="http://127.0.0.1:8080", cookie=cookie) == 200
    assert "evil.example" in caplog.text


def test_refusal_says_what_to_set_and_is_told_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    visitor = Visitor()
    for _ in range(3):
        start, body = visitor.ask("/login", "POST", origin="https://lab.example", accept="text/html")
        assert start["status"] == 403
        assert b"\npublic_address: https://lab.example/\n" in body["body"]
    assert b"&lt;b&gt;" in visitor.ask(origin="http://<b>", accept="text/html")[1]["body"]
    assert visitor.gate.foreign == 4
    assert caplog.text.count("from a page of 'https://lab.example'; if that is your proxy, set") == 1


def test_page_behind_a_proxy_has_the_public_origin_and_every_other_is_refused() -> None:
    visitor = Visitor(public="https://lab.example:443/robot1")
    cookie = visitor.log_in(OPERATOR)
    assert cookie is not None
    assert visitor.status("/robot1/x", cookie=cookie, origin="https://lab.example") == 200
    assert visitor.status("/x", cookie=cookie, origin="https://LAB.example") == 200
    assert visitor.status(cookie=cookie, origin="http://127.0.0.1:8080") == 200
    for other in (
        "http://lab.example",
        "https://lab.example:8443",
        "https://lab.example.evil.example",
        "null",
    ):
        assert visitor.status("/robot1/x", cookie=cookie, origin=other) == 403


def test_cookie_is_only_sent_below_the_path_and_never_without_tls() -> None:
    visitor = Visitor(public="https://lab.example/robot1/")
    (answer, _) = visitor.ask("/login", "POST", body=f"token={OPERATOR}".encode())
    headers = dict(answer["headers"])
    assert b"Secure" in headers[b"set-cookie"]
    assert b"path" not in headers[b"set-cookie"].lower()
    assert headers[b"location"] == b"./"
    plain = visitor.ask("/login", "POST", body=f"token={OPERATOR}".encode(), origin="http://127.0.0.1:8080")
    assert b"Secure" not in dict(plain[0]["headers"])[b"set-cookie"]


def test_forwarded_headers_count_only_from_trusted_proxies(caplog: pytest.LogCaptureFixture) -> None:
    for proxies, expected in (([], PEER[0]), (["10.0.0.0/8"], PEER[0]), (["192.0.2.0/24"], "203.0.113.9")):
        visitor = Visitor()
        visitor.gate = with_forwarded(visitor.gate, proxies)  # type: ignore[assignment]
        headers = {"x-forwarded-for": "198.51.100.1, 203.0.113.9", "x-forwarded-prefix": "/evil"}
        visitor.ask("/login", "POST", body=b"token=wrong", **headers)
        assert caplog.messages[-1] == f"wrong token from {expected}"
        cookie = visitor.log_in(OPERATOR)
        assert visitor.status(cookie=cookie or "", **headers) == 200, (
            "its connection is not that of the proxy"
        )
        assert "x-forwarded-prefix" not in visitor.headers


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "/"),
        ("http://robot.local", "http://robot.local/"),
        ("HTTPS://Lab.Example:443/a/b", "https://lab.example/a/b/"),
        ("http://[::1]:8081/", "http://[::1]:8081/"),
    ],
)
def test_public_address_is_written_as_browsers_write_it(text: str, expected: str) -> None:
    assert str(public_address(text)) == expected


def test_sessions_are_bounded_and_the_least_recently_used_one_ends() -> None:
    access = Access(OPERATOR, OBSERVER)
    sessions = [access.log_in(OPERATOR) for _ in range(MAX_SESSIONS)]
    assert access.role_of(sessions[0]) is Role.OPERATOR
    for _ in range(MAX_SESSIONS):
        access.log_in(OBSERVER)
    assert access.role_of(sessions[0]) is Role.OPERATOR, "an observer has ended an operator's session"
    access.log_in(OPERATOR)
    assert access.role_of(sessions[0]) is Role.OPERATOR
    assert access.role_of(sessions[1]) is None


def test_one_page_drives_until_another_one_takes_over_explicitly() -> None:
    seat = DriversSeat()
    assert seat.take("first")
    assert not seat.take("second")
    assert seat.take("second", over=True)
    seat.leave("first")
    assert seat.holder == "second"
    seat.leave("second")
    assert seat.take("first")


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"host": "0.0.0.0"}, "set operator_token"),
        ({"operator_token": Secret("short")}, "at least 16 characters"),
        ({"public_address": "lab.example/robot1"}, "expected an address such as https://"),
        ({"public_address": "https://lab.example/?robot=1"}, "expected an address such as https://"),
        ({"public_address": "https://lab.example:port/"}, "is no address"),
        ({"public_address": "https://lab.example/a b/"}, "expected letters, digits"),
        ({"public_address": "https://lab.example/../"}, "expected letters, digits"),
        ({"public_address": "https://lab.example/live/"}, "the page has paths below /live itself"),
        ({"trusted_proxies": ["lab.example"]}, "expected addresses such as 10.0.0.2"),
        ({"tabs": {"sistem": ""}}, "there is no panel 'sistem'"),
        ({"panels": ["map"]}, "expected package.module:Class; got 'map'"),
        ({"panels": [f"{OWN_PANEL}s:FriendsPanel"]}, "no Python module .*did you mean .*own_panel'"),
        ({"panels": [f"{OWN_PANEL}:FriendPanel"]}, "no class 'FriendPanel'; did you mean 'FriendsPanel'"),
        ({"panels": ["pathlib:Path"]}, "pathlib:Path is not derived from robbie_mp.station.panel.Panel"),
        ({"panels": ["robbie_mp.station.panel:Panel"]}, "robbie_mp.station.panel:Panel has no name"),
        ({"panels": [f"{OWN_PANEL}:FriendsPanel"] * 2}, "FriendsPanel is called 'friends' already"),
        (
            {"panels": ["robbie_mp.station.panels.map:MapPanel"]},
            ":MapPanel is called 'map' already",
        ),
    ],
)
def test_unsafe_or_wrong_settings_are_errors_before_anything_starts(
    settings: dict[str, Any], expected: str
) -> None:
    with pytest.raises(SettingError, match=expected):
        ModuleHarness(OperatorStation, settings)


def test_occupied_port_is_a_clear_error() -> None:
    with closing(listen("127.0.0.1", 0)) as first:
        port = first.getsockname()[1]
        with pytest.raises(
            AddressUnusable, match=f"port {port}: .*set another host or port .*--set operator.port=0"
        ):
            listen("127.0.0.1", port)


def test_restarted_station_knows_earlier_sessions() -> None:
    access = Access(OPERATOR, OBSERVER)
    session = access.log_in(OBSERVER)
    assert session not in access.sessions, "what is kept on a disk lets nobody in"
    assert Access(OPERATOR, OBSERVER, access.sessions).role_of(session) is Role.OBSERVER
    assert Access(OPERATOR, OBSERVER).role_of(session) is None


def test_station_without_its_libraries_reports_that_in_one_line_and_ends(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "robbie_mp.station.web.website", None)
    with ModuleHarness(OperatorStation) as harness:
        assert harness.module.stop_requested
        assert "no operator station: the library " in harness.module.status
        assert harness.module.status.partition("is missing; install the extra `gui`: pip install ")[1]
        (record,) = caplog.records
        assert record.getMessage() == harness.module.status


def test_messages_of_a_page_beyond_the_rate_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    waited_s: list[float] = []

    async def receive() -> Message:
        return {"type": "websocket.receive"}

    async def sleep(time_s: float) -> None:
        waited_s.append(time_s)

    async def flood() -> None:
        take = paced(receive, lambda: 0.0)
        for _ in range(1000):
            await take()

    monkeypatch.setattr(asyncio, "sleep", sleep)
    asyncio.run(flood())
    assert len(waited_s) == 1000 - MESSAGES_BURST
    assert waited_s[-1] == pytest.approx((1000 - MESSAGES_BURST) / MESSAGES_PER_S)


def test_trusted_proxies_have_room_for_the_connections_of_all_their_browsers() -> None:
    connections = Connections(proxies=["10.0.0.0/24", "fd00::7"])

    def enter(address: str, count: int) -> int:
        """Return how many connections were closed until now."""
        for port in range(count):
            connections.enter(Transport((address, port)))  # type: ignore[arg-type]
        return connections.dropped

    assert enter("10.0.0.2", MAX_BEHIND_PROXIES // 2) == 0
    assert enter("::ffff:10.0.0.3", MAX_BEHIND_PROXIES // 2 - 1) == 0
    assert [enter(f"192.0.2.{number}", 1) for number in range(MAX_STRANGERS)] == [0] * MAX_STRANGERS
    assert enter("fd00::7", 1) == 0
    assert enter("fd00::7", 3) == 3 - 1  # the first one is known
    assert enter("fd00::8", 1) == 3


def test_every_panel_can_be_named_in_a_profile() -> None:
    panels = panels_in_order({})
    assert [panel.name for panel in panels.values()] == [*FRAMEWORK_PANELS]


def test_robots_own_panel_can_be_named_among_the_tabs() -> None:
    settings = {"panels": [f"{OWN_PANEL}:FriendsPanel"], "tabs": {"friends": "", "map": "Where am I"}}
    ModuleHarness(OperatorStation, settings)
