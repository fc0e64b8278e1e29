"""The gate before every request: it checks origin, session and role."""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping
from html import escape
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from robbie_mp.base.token_bucket import TokenBucket
from robbie_mp.station.web.access import Access, is_own_origin
from robbie_mp.station.web.connections import Connections, source_of
from robbie_mp.station.web.rate_limits import LoginLimit

SESSION_COOKIE = "robbie_session"
SESSION = "robbie.session"
"""Key of the session in the scope of an admitted request."""
LOGIN_PATH = "/login"
LOGOUT_PATH = "/logout"
MESSAGES_BURST = 200
MESSAGES_PER_S = 100.0
"""Maximum rate from one page on one socket. A page that drives sends 10 a second; faster messages wait."""
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
        visit = HTTPConnection(scope)
        answer = await self._answer(visit, receive)
        if answer is not None:
            await answer(scope, receive, send)
            return
        scope[SESSION] = visit.cookies[SESSION_COOKIE]
        await self._app(scope, paced(receive) if is_socket(visit) else receive, send)

    async def _answer(self, visit: HTTPConnection, receive: Receive) -> App | None:
        """Return the answer to a request that the page server does not get; None lets it through."""
        if not is_own_origin(visit.headers.get("origin"), visit.headers.get("host")):
            refusal = f"it comes from a page of {visit.headers.get('origin')!r:.200}"
            self._access.refusals.warning("refused a request of %s: %s", peer(visit), refusal)
            return refused(visit, refusal, 403)
        session, path = visit.cookies.get(SESSION_COOKIE), visit.scope["path"]
        if path in (LOGIN_PATH, LOGOUT_PATH) and not is_socket(visit):
            log = self._log_in if path == LOGIN_PATH else self._log_out
            return await log(visit, receive, session)
        role = self._access.role_of(session)
        if session is None or role is None:
            return ask_to_log_in(visit)
        if not is_socket(visit) and visit.scope["method"] not in ("GET", "HEAD"):
            return refused(visit, "only GET and HEAD are answered", 405)
        if not self._connections.admit(visit.scope.get("client"), session, role):
            text = "too many connections; close some pages"
            return refused(visit, text, 503, {"Connection": "close"})
        return None

    async def _log_in(self, visit: HTTPConnection, receive: Receive, _session: str | None) -> Response:
        if visit.scope["method"] == "POST":
            form = await read_body(receive)
            token = parse_qs(form.decode("utf-8", "replace")).get("token", [""])[0]
        elif visit.headers.get("sec-fetch-site") == "cross-site":
            return login_page("a page of another site has sent you here: enter the token yourself")
        else:  # a link with the token in it, such as the one that `robbie run` prints
            token = visit.query_params.get("token", "")
            if not token:
                return login_page("")
        source = source_of(peer(visit))
        wait_s = math.ceil(self._tries.wait_s(source))
        if wait_s:
            self._access.refusals.warning("too many wrong tokens from %s", source)
            text = f"too many wrong tokens from your address; try again in {wait_s} s"
            return login_page(text, 429, {"Retry-After": str(wait_s)})
        session = self._access.log_in(token)
        if session is None:
            self._tries.note_wrong(source)
            self._access.refusals.warning("wrong token from %s", source)
            return login_page("that is not the token", 403)
        response = RedirectResponse("/", 303)
        response.set_cookie(SESSION_COOKIE, session, httponly=True, samesite="strict")
        return response

    async def _log_out(self, visit: HTTPConnection, _receive: Receive, session: str | None) -> Response:
        """End a session with all its pages. It requires a POST, so that no link or picture can do it."""
        if visit.scope["method"] != "POST":
            return PlainTextResponse("log out by POST\n", 405)
        if session is not None:
            self._access.log_out(session)
            self._connections.end(session)
        response = RedirectResponse(LOGIN_PATH, 303)
        response.delete_cookie(SESSION_COOKIE)
        return response


def is_socket(visit: HTTPConnection) -> bool:
    """Return whether a WebSocket is to be opened."""
    return bool(visit.scope["type"] == "websocket")


def refused(visit: HTTPConnection, text: str, status: int, headers: Mapping[str, str] | None = None) -> App:
    """Return the answer that refuses a request or a WebSocket."""
    if is_socket(visit):
        return WebSocketClose(1008)
    return PlainTextResponse(f"{text}\n", status, headers)


def ask_to_log_in(visit: HTTPConnection) -> App:
    """Return the answer to a request without a session."""
    if not is_socket(visit) and (visit.scope["method"], visit.scope["path"]) == ("GET", "/"):
        return RedirectResponse(LOGIN_PATH, 303)
    return refused(visit, "log in first", 401)


def paced(receive: Receive, clock: Callable[[], float] = time.monotonic) -> Receive:
    """Return a `receive` that takes messages at a limited rate. Further messages wait at the sender."""
    bucket = TokenBucket(MESSAGES_PER_S, MESSAGES_BURST, clock)

    async def take() -> Message:
        message = await receive()
        if message["type"] == "websocket.receive":
            wait_s = bucket.wait_s
            bucket.spend()
            if wait_s:
                await asyncio.sleep(wait_s)
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


def peer(visit: HTTPConnection) -> str:
    """Return the address that a request comes from."""
    return visit.client.host if visit.client else "an unknown address"
