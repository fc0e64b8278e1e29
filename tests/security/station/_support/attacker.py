"""Visits an operator station as an attacker's program, which can send anything."""

import ast
import http.client
import json
import re
import socket
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from html import unescape
from typing import Any
from urllib.parse import urlencode

from websockets.exceptions import ConnectionClosed
from websockets.sync import client as websockets_client

ELEMENTS = re.compile(r"parseElements\(String\.raw`(.*?)`\)", re.DOTALL)
QUERY = re.compile(r"query: (\{.*?\}),\n")
SOCKET_PATH = "/_nicegui_ws/socket.io/"
LIMIT_S = 30.0
DELAY_PING = re.compile(r"runMethod\(\d+, ['\"]answer['\"], \[(\d+)\]\)")
"""A station measures the delay of a driver's page with it."""
PING, PONG, CONNECT, EVENT = "2", "3", "40", "42"
"""How packets of Socket.IO 5 over Engine.IO 4 begin."""


@dataclass(frozen=True)
class Answer:
    """What a station has answered to a request."""

    status: int
    headers: Mapping[str, str]
    body: str

    @property
    def cookie(self) -> str:
        """The cookie that it sets."""
        return self.headers.get("set-cookie", "").partition(";")[0]


@dataclass
class Document:
    """A page as it was served."""

    elements: dict[str, dict[str, Any]]
    query: dict[str, str]

    @property
    def client_id(self) -> str:
        return self.query["client_id"]


@dataclass
class Attacker:
    """One visitor, who may have logged in.

    Args:
        port: of the station, on this machine.
        cookie: of its session.
        source: address that it comes from.
    """

    port: int
    cookie: str = ""
    source: str = "127.0.0.1"
    headers: dict[str, str] = field(default_factory=dict)

    def ask(self, path: str, method: str = "GET", body: str | None = None, **headers: str) -> Answer:
        """Make one request, on a connection of its own."""
        made = http.client.HTTPConnection(
            "127.0.0.1", self.port, timeout=LIMIT_S, source_address=(self.source, 0)
        )
        sent = {name.replace("_", "-"): value for name, value in headers.items()} | self.headers
        if self.cookie:
            sent["Cookie"] = self.cookie
        if body is not None:
            sent["Content-Type"] = "application/x-www-form-urlencoded"
        try:
            made.request(method, path, body, sent)
            answer = made.getresponse()
            text = answer.read().decode()
        finally:
            made.close()
        return Answer(answer.status, {name.lower(): value for name, value in answer.getheaders()}, text)

    def try_token(self, token: str) -> Answer:
        return self.ask("/login", "POST", urlencode({"token": token}))

    def log_in(self, token: str) -> "Attacker":
        """Begin a session; one who has it comes from the same address."""
        answer = self.try_token(token)
        assert answer.status == 303, answer
        return Attacker(self.port, answer.cookie, self.source)

    def open(self, path: str = "/") -> Document:
        """Load the page, as soon as other tests' pages have made room for it."""
        until_s = time.monotonic() + LIMIT_S
        while (answer := self.ask(path)).status == 503 and time.monotonic() < until_s:
            time.sleep(0.2)
        assert answer.status == 200, answer
        found, query = ELEMENTS.search(answer.body), QUERY.search(answer.body)
        assert found and query
        texts = {name: _as_text(value) for name, value in ast.literal_eval(query[1]).items()}
        ids = {"tab_id": str(uuid.uuid4()), "document_id": str(uuid.uuid4())}
        return Document(json.loads(unescape(found[1])), texts | ids)

    @contextmanager
    def connect(self, query: Mapping[str, str]) -> Iterator["PageSocket"]:
        """Connect as a page does."""
        address = f"ws://127.0.0.1:{self.port}{SOCKET_PATH}?" + urlencode(
            {"EIO": "4", "transport": "websocket", **query}
        )
        headers = {"Cookie": self.cookie} if self.cookie else {}
        with websockets_client.connect(
            address, additional_headers=headers, open_timeout=LIMIT_S, max_size=None, ping_interval=None
        ) as made:
            made.recv(LIMIT_S)
            made.send(CONNECT)
            yield PageSocket(made)

    def stop_robot(self) -> None:
        """Press the emergency stop as a page does, until the base has confirmed it."""
        press, fate = str(uuid.uuid4()), ""
        headers = {"Cookie": self.cookie} if self.cookie else {}
        with websockets_client.connect(
            f"ws://127.0.0.1:{self.port}/emergency-stop", additional_headers=headers, open_timeout=LIMIT_S
        ) as made:
            while fate != "confirmed":
                made.send(json.dumps({"asked_ms": 1.0, "press": press}))
                fate = json.loads(made.recv(LIMIT_S))["fate"]

    @contextmanager
    def half_open(self, sent: bytes = b"") -> Iterator[socket.socket]:
        """Connect, and send the beginning of something."""
        with socket.create_connection(
            ("127.0.0.1", self.port), LIMIT_S, source_address=(self.source, 0)
        ) as made:
            made.sendall(sent)
            yield made


class PageSocket:
    """A page's connection to its server.

    Attributes:
        greeting: what the server has answered to the connection.
        elements: what the server has said of the page's elements since.
        delay_pings: when each delay ping came that waits for an answer, by its number.
    """

    def __init__(self, made: websockets_client.ClientConnection):
        self._made = made
        self.greeting = str(made.recv(LIMIT_S))
        self.elements: dict[str, dict[str, Any]] = {}
        self.delay_pings: dict[int, float] = {}

    def emit(self, event: str, content: object) -> None:
        self._made.send(EVENT + json.dumps([event, content]))

    def send(self, packet: str | bytes) -> None:
        self._made.send(packet)

    def fire(self, client_id: str, element: str, listener: str, *arguments: object) -> None:
        """Send an event of an element, whether or not a page could."""
        self.emit(
            "event",
            {
                "id": int(element),
                "client_id": client_id,
                "listener_id": listener,
                "args": [json.dumps(argument) for argument in arguments],
            },
        )

    def listen(self, limit_s: float) -> None:
        """Take what comes for some time, and answer to pings."""
        until_s = time.monotonic() + limit_s
        while (left_s := until_s - time.monotonic()) > 0:
            try:
                packet = self._made.recv(left_s)
            except TimeoutError:
                return
            if packet == PING:
                self._made.send(PONG)
            if isinstance(packet, str) and packet.startswith(EVENT):
                event, content = json.loads(packet[len(EVENT) :])
                if event == "run_javascript" and (asked := DELAY_PING.search(content["code"])):
                    self.delay_pings[int(asked[1])] = time.monotonic()
                if event == "update":
                    self.elements |= {key: one for key, one in content.items() if isinstance(one, dict)}

    def answer_delay_pings(self, document: Document) -> None:
        """Answer as a driver's page does whose monotonic clock is that of this machine."""
        element, listener = listener_of(document.elements, "pong", id="driver")
        for number, page_s in self.delay_pings.items():
            self.fire(document.client_id, element, listener, {"number": number, "page_s": page_s})
        self.delay_pings.clear()

    def is_closed_within(self, limit_s: float) -> bool:
        """Whether the server closes the connection before long."""
        try:
            self.listen(limit_s)
        except ConnectionClosed:
            return True
        return False


def listeners(elements: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """Return element, event and listener of all that a page could tell its server."""
    return [
        (key, one["type"], one["listener_id"])
        for key, element in elements.items()
        for one in element.get("events", [])
    ]


def listener_of(elements: Mapping[str, Mapping[str, Any]], event: str, **properties: str) -> tuple[str, str]:
    """Return the element with certain properties, and its listener for an event."""
    (found,) = [
        (key, one["listener_id"])
        for key, element in elements.items()
        if properties.items() <= element.get("props", {}).items()
        for one in element.get("events", [])
        if one["type"] == event
    ]
    return found


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
