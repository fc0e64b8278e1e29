"""Limits on what visitors can make the station do, store and write; other sites cannot show its page."""

import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from robbie_mp.station.web.access import MAX_SESSIONS
from robbie_mp.station.web.page_limit import MAX_PAGES_OF_ONE
from robbie_mp.station.web.rate_limits import LOGIN_BURST
from tests.security.station._support.attacker import SOCKET_PATH, Document, PageSocket, listener_of
from tests.security.station.conftest import OPERATOR, Station

pytestmark = pytest.mark.timeout(300)
PACKETS = (
    '451-["event",{"_placeholder":true,"num":0}]',  # an attachment, promised
    b"x",  # and sent
    "42[]",
    '42["event"]',
    '42["event",1,2,3]',
    '42["connect",{}]',
    '42["disconnect","why"]',
    "42" + "[" * 50_000,
    "40/other,",
    "44",
    "9",
    "",
)
TRICKS = (
    "/..%2f..%2f..%2f..%2fetc/passwd",
    "/_nicegui/../../../../etc/passwd",
    "/_nicegui/3.18.0/static/..%2f..%2fclient.py",
    "//etc/passwd",
    "/login/../_nicegui/x",
    "/login%00",
    "/LOGIN/",
    "/pictures/camera/..%2f..%2fx",
)


def log_of(station: Station) -> str:
    return station.robot.log("operator")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("path", ["/", "/login", "/nothing", "/pictures/camera/x"])
@pytest.mark.parametrize("is_logged_in", [False, True])
def test_no_other_site_can_show_the_page_in_a_frame(station: Station, path: str, is_logged_in: bool) -> None:
    visitor = station.operator() if is_logged_in else station.stranger()
    headers = visitor.ask(path).headers
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["x-frame-options"] == "DENY"
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "same-origin"


def test_wrong_tokens_and_their_log_lines_are_limited_per_address(station: Station) -> None:
    guesser = station.stranger("127.0.2.1")
    forging = {"X-Forwarded-For": "192.0.2.9"}
    found = [guesser.ask("/login", "POST", f"token=wrong{number}", **forging).status for number in range(300)]
    assert set(found[:LOGIN_BURST]) == {403}
    assert found[LOGIN_BURST:].count(403) <= 10
    assert found[-1] == 429
    assert guesser.try_token(OPERATOR).status == 429, "the right one among many wrong ones"
    assert station.stranger("127.0.2.2").try_token(OPERATOR).status == 303
    traced = [line for line in log_of(station).splitlines() if "wrong token" in line]
    assert 0 < len(traced) < 60
    assert not any("192.0.2.9" in line for line in traced)


def test_link_on_another_site_cannot_change_a_browsers_session(station: Station) -> None:
    answer = station.stranger().ask(f"/login?token={OPERATOR}", Sec_Fetch_Site="cross-site")
    assert answer.status == 200
    assert not answer.cookie


def test_flood_of_pages_at_once_is_refused_as_well(station: Station) -> None:
    observer = station.observer()
    with ThreadPoolExecutor(40) as pool:
        found = [*pool.map(lambda _: observer.ask("/").status, range(40))]
    assert found.count(200) <= MAX_PAGES_OF_ONE


def test_logins_of_observers_do_not_log_an_operator_out(station: Station) -> None:
    operator = station.operator()
    for _ in range(2 * MAX_SESSIONS):
        station.observer()
    assert operator.ask("/").status == 200


def test_flood_of_pages_is_refused_and_does_not_lock_out_operators(station: Station) -> None:
    observer = station.observer()
    found = [observer.ask("/").status for _ in range(5 * MAX_PAGES_OF_ONE)]
    assert found[0] == 200
    assert found.count(503) > 0
    assert found.count(200) <= 2 * MAX_PAGES_OF_ONE
    assert station.operator().ask("/").status == 200


def test_unknown_paths_create_no_page(station: Station) -> None:
    answer = station.observer().ask(f"/{uuid.uuid4()}")
    assert answer.status == 404
    assert "<" not in answer.body


@pytest.mark.parametrize("path", TRICKS)
def test_paths_reach_no_file_and_bypass_no_login(station: Station, path: str) -> None:
    for visitor in (station.stranger(), station.observer()):
        answer = visitor.ask(path)
        assert answer.status in (204, 303, 400, 401, 404)
        assert "root:" not in answer.body
        assert "class Client" not in answer.body


def test_only_login_and_logout_accept_data(station: Station) -> None:
    operator = station.operator()
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert operator.ask("/", method, "x=1").status == 405
    assert operator.ask("/logout").status == 405


def test_there_is_no_long_polling(station: Station) -> None:
    """Its connections would not be counted, and its sessions not be closed."""
    answer = station.observer().ask(f"{SOCKET_PATH}?EIO=4&transport=polling")
    assert answer.status == 400


def test_session_ends_with_its_pages_when_its_visitor_logs_out(station: Station) -> None:
    operator = station.operator()
    document = operator.open()
    with operator.connect(document.query) as page:
        element, listener = listener_of(document.elements, "click", id="confirm-release")
        assert operator.ask("/logout", "POST", "").status == 303
        assert page.is_closed_within(10.0)
    assert operator.ask("/").status == 303, "the cookie still opens the page"
    with pytest.raises(InvalidStatus):
        page = operator.connect(document.query).__enter__()
        page.fire(document.client_id, element, listener)
    assert station.heard == []


def speak(page: PageSocket, document: Document, level: str, message: str) -> None:
    page.emit("log", {"client_id": document.client_id, "level": level, "message": message})


def test_reports_of_a_page_are_cut_to_one_short_line(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    mark = uuid.uuid4().hex
    with observer.connect(document.query) as page:
        speak(page, document, "warning", f"{mark}\nforged line\x1b[2J" + "y" * 10_000)
        station.robot.until(lambda _: mark in log_of(station))
    (line,) = [line for line in log_of(station).splitlines() if mark in line]
    assert len(line) < 1000
    assert "\x1b" not in log_of(station)


def test_huge_messages_end_their_connection(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    mark = uuid.uuid4().hex
    with pytest.raises(ConnectionClosed), observer.connect(document.query) as page:
        speak(page, document, "error", mark + "z" * 900_000)
        page.listen(10.0)
        pytest.fail("the connection is still open")
    assert mark not in log_of(station)


def test_invalid_packets_end_their_connection_without_tracebacks(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    before = log_of(station).count("Traceback")
    for packet in PACKETS:
        with observer.connect(document.query) as page:
            page.send(packet)
            assert page.is_closed_within(10.0), packet
    assert log_of(station).count("Traceback") == before


def test_malformed_events_cause_no_tracebacks(station: Station) -> None:
    observer = station.observer()
    document = observer.open()
    client = document.client_id
    before = log_of(station).count("Traceback")
    contents: list[Any] = [None, 1, [], {}, {"client_id": client}, {"client_id": [client]}, "x" * 1000]
    with observer.connect(document.query) as page:
        for event in ("event", "ack", "log", "javascript_response", "handshake"):
            for content in contents:
                page.emit(event, content)
        for element, listener in ((1, "none"), (10**6, "none"), (-1, "")):
            page.fire(client, str(element), listener, 1)
        key, listener = listener_of(document.elements, "click", id="confirm-release")
        broken = {"id": int(key), "client_id": client, "listener_id": listener, "args": ["{", 1, None]}
        page.emit("event", broken)
        page.emit("ack", {"client_id": client, "next_message_id": "9" * 5000})
        page.listen(0.5)
    assert log_of(station).count("Traceback") == before


def test_flood_of_events_is_throttled_at_the_sender(station: Station) -> None:
    """Ten thousand at once are taken one after the other; the button of another page is not behind them."""
    observer, operator = station.observer(), station.operator()
    document, other = observer.open(), operator.open()
    with observer.connect(document.query) as page, operator.connect(other.query) as quiet:
        for _ in range(10_000):
            page.emit("ack", {"client_id": document.client_id, "next_message_id": 0})
        element, listener = listener_of(other.elements, "click", id="mark")
        quiet.fire(other.client_id, element, listener)
        station.robot.until(lambda _: ("Mark", None) in station.heard)
