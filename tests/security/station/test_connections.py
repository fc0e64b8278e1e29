"""Clients that only open connections, or send slowly, lock nobody out and exhaust no resources."""

import itertools
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from robbie_mp.station.web.connections import MAX_VISITORS_OF_ONE, REQUEST_LIMIT_S
from tests._support.robot import wait_until
from tests.security.station._support.attacker import SOCKET_PATH, Attacker
from tests.security.station.conftest import DESCRIPTORS, Station

pytestmark = pytest.mark.timeout(300)
HALF_A_REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "
GRACE_S = 5.0


def is_closed(connection: socket.socket) -> bool:
    """Whether the other end has closed a connection, whatever it said before."""
    connection.setblocking(False)
    try:
        while connection.recv(1 << 16):
            pass
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@contextmanager
def many(visitors: list[Attacker]) -> Iterator[list[socket.socket]]:
    """Connect often, sending nothing and half a request in turn."""
    with ExitStack() as stack:
        made = []
        for visitor, sent in zip(visitors, itertools.cycle([b"", HALF_A_REQUEST]), strict=False):
            try:
                made.append(stack.enter_context(visitor.half_open(sent)))
            except OSError:
                continue  # reset at once, which is as well
        yield made


def descriptors(station: Station) -> int:
    return len(os.listdir(f"/proc/{station.pid}/fd"))


@pytest.mark.parametrize("addresses", [1, 100])
def test_half_open_connections_do_not_lock_out_others_and_are_closed(
    station: Station, addresses: int
) -> None:
    """Every second one sends nothing, the others half a request."""
    strangers = [station.stranger(f"127.0.1.{1 + number % addresses}") for number in range(700)]
    with many(strangers) as made:
        station.operator().open()
        assert descriptors(station) < DESCRIPTORS // 2
        wait_until(lambda: all(map(is_closed, made)), REQUEST_LIMIT_S + GRACE_S)
    assert station.starts == station.starts_before


def test_request_sent_byte_by_byte_is_cut_off(station: Station) -> None:
    with station.stranger().half_open(HALF_A_REQUEST) as connection:
        until_s = time.monotonic() + REQUEST_LIMIT_S + GRACE_S
        with pytest.raises(OSError):
            while time.monotonic() < until_s:
                connection.sendall(b"x")
                time.sleep(0.05)  # the attack itself


def test_body_that_never_ends_is_cut_off(station: Station) -> None:
    head = b"POST /login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4000\r\n\r\ntoken="
    with station.stranger().half_open(head) as connection:
        wait_until(lambda: is_closed(connection), REQUEST_LIMIT_S + GRACE_S)


def test_headers_are_bounded(station: Station) -> None:
    huge = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: " + b"x" * (1 << 20) + b"\r\n\r\n"
    answer = b""
    try:
        with station.stranger().half_open(huge) as connection:
            answer = connection.recv(100)
    except OSError:
        pass  # reset while the cookie was still on its way
    assert answer in (b"", *[answer] * answer.startswith(b"HTTP/1.1 400"))


def follow(visitor: Attacker, path: str = "/live/map", more: str = "") -> bytes:
    """Return a request to follow the map, or for something else on a connection that then stays."""
    return (
        f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n{more}"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {'A' * 22}==\r\nCookie: {visitor.cookie}\r\n\r\n"
    ).encode()


@pytest.mark.parametrize("wish", ["", "; server_max_window_bits=abc"])
def test_nothing_that_a_visitor_sends_is_decompressed(station: Station, wish: str) -> None:
    """A block of deflate that does not end may keep the station busy, and fill its memory."""
    observer = station.observer()
    asked = f"Sec-WebSocket-Extensions: permessage-deflate{wish}\r\n"
    for path in ("/live/map", "/emergency-stop", f"{SOCKET_PATH}?EIO=4&transport=websocket"):
        with observer.half_open(follow(observer, path, asked)) as connection:
            answer = connection.recv(1 << 12).lower()
        assert answer.startswith(b"http/1.1 101")
        assert b"extensions" not in answer


def test_many_connections_of_observers_do_not_lock_out_operators(station: Station) -> None:
    with ExitStack() as stack:
        served = 0
        for observer in [station.observer() for _ in range(12)]:
            for _ in range(MAX_VISITORS_OF_ONE + 2):
                try:
                    connection = stack.enter_context(observer.half_open(follow(observer)))
                    served += b"101" in connection.recv(20)
                except OSError:
                    continue
        assert served >= MAX_VISITORS_OF_ONE, "refused at once: nothing is tested"
        station.operator().open()
        assert descriptors(station) < DESCRIPTORS - 64
    assert station.starts == station.starts_before


def test_client_that_does_not_read_its_answers_is_disconnected(station: Station) -> None:
    observer = station.observer()
    ping = bytes([0x89, 0x80 + 125]) + bytes(4) + b"p" * 125
    with observer.half_open(follow(observer)) as connection:
        assert b"101" in connection.recv(20)
        connection.settimeout(GRACE_S)
        until_s = time.monotonic() + GRACE_S
        with pytest.raises(ConnectionError):
            while time.monotonic() < until_s:
                connection.sendall(ping * 100)
