"""The gate before every request: it checks origin, session and role."""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import Message, Receive, Scope, Send

from robbie_mp.station.web.access import Access, is_own_origin
from robbie_mp.station.web.connections import Connections, source_of
from robbie_mp.station.web.rate_limits import LoginLimit

SESSION_COOKIE = "robbie_session"
SESSION = "robbie.session"
"""Key of the session in the scope of an admitted request."""
LOGIN_PATH = "/login"
LOGOUT_PATH = "/logout"
MESSAGES_BURST = 200.0
MESSAGES_PER_S = 100.0
"""Maximum rate from one page on one socket. A page that drives sends 10 a second; faster messages wait."""
HEADERS = [
    (
        b"content-security-policy",
        b"frame-ancestors 'none'; base-uri 'self'; form-action 'self'; object-src 'none'",
    ),
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
]
"""Headers that keep other sites from showing the page in a frame (clickjacking) or using its pictures."""
MAX_FORM_BYTES = 4096

LOGIN_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Robbie: log in</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>body{{font:1.1rem sans-serif;display:grid;place-items:center;min-height:90vh}}
body{{background:#10151b;color:#eee}}
input,button{{font:inherit;padding:.6rem;width:100%;box-sizing:border-box;margin-top:.6rem}}
.error{{color:#ff8a80}}</style>
<form method="post" action="/login">
<input name="username" value="robbie" autocomplete="username" hidden>
<label for="token">Token of this robot</label>
<input id="token" name="token" type="password" autocomplete="current-password" autofocus required>
<p class="error" role="alert">{error}</p><button>Log in</button></form></html>"""

App = Callable[[Scope, Receive, Send], Awaitable[None]]


class Gate:
    """Lets requests through to the page server, or answers them itself.

    Args:
        app: the page server.
        access: checks sessions and tokens, and logs refusals.
        connections: the connections on which the requests arrive.
    """

    def __init__(self, app: App, access: Access, connections: Connections):
        self._app = app
        self._access = access
        self._connections = connections
        self._tries = LoginLimit()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        if not is_socket:
            send = with_headers(send)
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if not is_own_origin(headers.get("origin"), headers.get("host")):
            refusal = f"it comes from a page of {headers.get('origin')!r:.200}"
            self._access.refusals.warning("refused a request of %s: %s", peer(scope), refusal)
            await self._deny(scope, receive, send, PlainTextResponse(f"{refusal}\n", 403))
            return
        session = session_of(headers)
        if not is_socket and scope["path"] in (LOGIN_PATH, LOGOUT_PATH):
            log = self._log_in if scope["path"] == LOGIN_PATH else self._log_out
            await (await log(scope, receive, session))(scope, receive, send)
            return
        role = self._access.role_of(session)
        if session is None or role is None:
            await self._ask(scope, receive, send)
            return
        if not is_socket and scope["method"] not in ("GET", "HEAD"):
            await PlainTextResponse("only GET and HEAD are answered\n", 405)(scope, receive, send)
            return
        if not self._connections.admit(scope.get("client"), session, role):
            text = "too many connections; close some pages\n"
            await self._deny(scope, receive, send, PlainTextResponse(text, 503, {"Connection": "close"}))
            return
        scope[SESSION] = session
        await self._app(scope, paced(receive) if is_socket else receive, send)

    async def _ask(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == "/":
            await RedirectResponse(LOGIN_PATH, 303)(scope, receive, send)
        else:
            await self._deny(scope, receive, send, PlainTextResponse("log in first\n", 401))

    async def _deny(self, scope: Scope, receive: Receive, send: Send, response: Response) -> None:
        if scope["type"] == "websocket":
            await receive()  # the connect message, which must be answered first
            await send({"type": "websocket.close", "code": 1008})
        else:
            await response(scope, receive, send)

    async def _log_in(self, scope: Scope, receive: Receive, _session: str | None) -> Response:
        if scope["method"] == "POST":
            form = await read_body(receive)
            tokens = parse_qs(form.decode("utf-8", "replace")).get("token", [""])
        elif dict(scope["headers"]).get(b"sec-fetch-site") == b"cross-site":
            return login_page("a page of another site has sent you here: enter the token yourself")
        else:  # a link with the token in it, such as the one that `robbie run` prints
            tokens = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        if not tokens:
            return login_page("")
        source = source_of(peer(scope))
        wait_s = math.ceil(self._tries.wait_s(source))
        if wait_s:
            self._access.refusals.warning("too many wrong tokens from %s", source)
            text = f"too many wrong tokens from your address; try again in {wait_s} s"
            return login_page(text, 429, {"Retry-After": str(wait_s)})
        session = self._access.log_in(tokens[0])
        if session is None:
            self._tries.note_wrong(source)
            self._access.refusals.warning("wrong token from %s", source)
            return login_page("that is not the token", 403)
        response = RedirectResponse("/", 303)
        response.set_cookie(SESSION_COOKIE, session, httponly=True, samesite="strict")
        return response

    async def _log_out(self, scope: Scope, _receive: Receive, session: str | None) -> Response:
        """End a session with all its pages. It requires a POST, so that no link or picture can do it."""
        if scope["method"] != "POST":
            return PlainTextResponse("log out by POST\n", 405)
        if session is not None:
            self._access.log_out(session)
            self._connections.end(session)
        response = RedirectResponse(LOGIN_PATH, 303)
        response.delete_cookie(SESSION_COOKIE)
        return response


def with_headers(send: Send) -> Send:
    """Return a `send` that adds headers to every answer, so that no other site can show or read it."""

    async def answer(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
        await send(message)

    return answer


def paced(receive: Receive) -> Receive:
    """Return a `receive` that takes messages at a limited rate. Further messages wait at the sender."""
    allowed, since_s = MESSAGES_BURST, time.monotonic()

    async def take() -> Message:
        nonlocal allowed, since_s
        message = await receive()
        if message["type"] == "websocket.receive":
            now_s = time.monotonic()
            allowed = min(MESSAGES_BURST, allowed + (now_s - since_s) * MESSAGES_PER_S) - 1.0
            since_s = now_s
            if allowed < 0.0:
                await asyncio.sleep(-allowed / MESSAGES_PER_S)
        return message

    return take


def login_page(error: str, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    """Return the page with the form for the token."""
    return HTMLResponse(LOGIN_PAGE.format(error=escape(error)), status, headers)


async def read_body(receive: Receive) -> bytes:
    """Read at most MAX_FORM_BYTES of a request's body."""
    body = b""
    while len(body) < MAX_FORM_BYTES:
        message = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body[:MAX_FORM_BYTES]


def session_of(headers: MutableMapping[str, str]) -> str | None:
    """Return the session that a request names."""
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(SESSION_COOKIE)
    except CookieError:
        return None
    return cookie.value if cookie else None


def peer(scope: MutableMapping[str, Any]) -> str:
    """Return the address that a request comes from."""
    client = scope.get("client")
    return f"{client[0]}" if client else "an unknown address"
