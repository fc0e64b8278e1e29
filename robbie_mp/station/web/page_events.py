"""Events of pages: accepted only on the connection of the page that they name, and only if well formed.

NiceGUI finds the page of an event by the id in the event, on any connection. Here, each connection belongs to
one page of one session, and its events can name no other page.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from nicegui import core
from nicegui.client import Client
from socketio.exceptions import ConnectionRefusedError
from starlette.types import Message, Receive, Scope, Send

from robbie_mp.station.web.gate import SESSION, App
from robbie_mp.station.web.page_json import from_page

if TYPE_CHECKING:
    from collections.abc import Mapping
    from logging import Logger

    from robbie_mp.station.page.page import Page

NAMESPACE = "/"
LOAD_ANEW = "Implicit handshake failed"
"""The answer that makes a page reload, as after a restart of the station."""
MAX_CHARACTERS = {
    "event": 1 << 16,
    "javascript_response": 1 << 14,
    "handshake": 2048,
    "ack": 256,
    "log": 1 << 14,
}
"""Limits of an event's content. The longest events have texts that a visitor typed."""
MAX_LOG_CHARACTERS = 500
"""Limit of a line that a page logs; the rest is cut off."""
PACKETS = ("1", "3", "40", "40{}", "41")
"""Close, pong, connect and disconnect."""
EVENT_PACKET = re.compile(r"42\d{0,9}(?=\[)")
"""Beginning of a packet with an event. A number follows if the event requests an answer."""
LEVELS = ("debug", "info", "warning", "error")
FORMS: dict[str, dict[str, type | tuple[type, ...]]] = {
    "event": {"client_id": str, "id": int, "listener_id": str, "args": list},
    "javascript_response": {"client_id": str, "request_id": str},
    "handshake": {"client_id": str, "tab_id": str, "document_id": str},
    "ack": {"client_id": str, "next_message_id": int},
    "log": {"client_id": str, "level": str, "message": str},
}
"""The members that each event must have; others are ignored."""


class PageEvents:
    """Checks all events of pages before NiceGUI handles them.

    Args:
        pages: the open pages.
        refusals: logs refused events.
    """

    def __init__(self, pages: Mapping[str, Page], refusals: Logger):
        self._pages = pages
        self._refusals = refusals
        handlers = dict(core.sio.handlers[NAMESPACE])
        unknown = handlers.keys() - FORMS.keys() - {"connect", "disconnect"}
        if unknown:
            raise NotImplementedError(f"this version of NiceGUI has events that are not checked: {unknown}")
        self._handlers = handlers
        core.sio.on("connect", self._on_connect)
        for name in FORMS:
            core.sio.on(name, self._guarded(name))

    async def _on_connect(self, connection: str, _environ: object, _auth: object = None) -> bool:
        # The value passed as the environment may come from an event that calls itself "connect".
        environ = core.sio.get_environ(connection) or {}
        if not self._may_join(connection, named_in(environ)):
            raise ConnectionRefusedError(LOAD_ANEW)
        await self._handlers["connect"](connection, environ, None)
        return True

    def _guarded(self, name: str) -> Callable[..., object]:
        async def handle(connection: str, *sent: Any) -> object:
            content: Any = sent[0] if len(sent) == 1 else None
            problem = self._problem(connection, name, content)
            if problem:
                self._refusals.warning("refused %s from a page: %s", name, problem)
                return False
            if name == "log":
                content["message"] = repr(content["message"][:MAX_LOG_CHARACTERS])
            try:
                answer = self._handlers[name](connection, content)
                return await answer if inspect.isawaitable(answer) else answer
            except Exception as error:  # one line, without a traceback, for any event
                self._refusals.warning("cannot handle %s from a page: %r", name, error)
                return False

        return handle

    def _problem(self, connection: str, name: str, content: Any) -> str:
        """Return the error in an event; '' if there is none."""
        if not has_form(content, FORMS[name]):
            return "it is malformed"
        if len(json.dumps(content)) > MAX_CHARACTERS[name]:
            return f"it is longer than {MAX_CHARACTERS[name]} characters"
        key = content["client_id"]
        if name == "handshake":
            environ = core.sio.get_environ(connection) or {}
            is_own = key == named_in(environ) and self._may_join(connection, key)
        else:
            is_own = key in core.sio.rooms(connection)
        if not is_own:
            return "it names another page"
        if name == "event" and not has_listener(key, content):
            return "there is no such element, or it has no such handler"
        if name == "log" and content["level"] not in LEVELS:
            return "there is no such level"
        return ""

    def _may_join(self, connection: str, key: str) -> bool:
        """Return whether a connection and the page that it names belong to the same session."""
        page = self._pages.get(key)
        scope = (core.sio.get_environ(connection) or {}).get("asgi.scope", {})
        return page is not None and page.session == scope.get(SESSION)


def with_known_packets(app: App) -> App:
    """Return an application that receives only packets of kinds that pages send. Others end the connection.

    Socket.IO has many more kinds. For example, it stores the attachments of a packet until they are complete,
    which may never happen.
    """

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        async def take() -> Message:
            message = await receive()
            if message["type"] == "websocket.receive" and not is_known(message.get("text")):
                return {"type": "websocket.disconnect", "code": 1003}
            return message

        is_socket = scope["type"] == "websocket"
        await app(scope, take if is_socket else receive, send)

    return answer


def is_known(packet: str | None) -> bool:
    """Return whether a packet (Socket.IO 5 in Engine.IO 4) is of a kind that pages send."""
    if packet is None:
        return False
    if packet in PACKETS:
        return True
    event = EVENT_PACKET.match(packet)
    if event is None:
        return False
    try:
        content = from_page(packet[event.end() :])
    except ValueError:
        return False
    return isinstance(content, list) and len(content) == 2 and content[0] in FORMS


def has_form(content: Any, form: dict[str, type | tuple[type, ...]]) -> bool:
    """Return whether an object has all members of an event of its kind."""
    return isinstance(content, dict) and all(
        isinstance(content.get(name), kind) and not (kind is int and isinstance(content[name], bool))
        for name, kind in form.items()
    )


def has_listener(key: str, event: dict[str, Any]) -> bool:
    """Return whether an element of the page has a handler for an event."""
    client = Client.instances.get(key)
    element = client.elements.get(event["id"]) if client else None
    return element is not None and event["listener_id"] in element._event_listeners


def named_in(environ: dict[str, Any]) -> str:
    """Return the page that a connection named when it was opened; '' if it named none."""
    return parse_qs(str(environ.get("QUERY_STRING", ""))).get("client_id", [""])[0]
