"""The gate before every request: it checks origin, session and role."""

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from html import escape
from typing import Any, cast
from urllib.parse import parse_qs, urlsplit

from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from robbie_mp.base.token_bucket import TokenBucket
from robbie_mp.station.page.identity import ANY_ROBOT, Identity
from robbie_mp.station.web.access import Access, is_own_origin
from robbie_mp.station.web.connections import Connections, source_of
from robbie_mp.station.web.proxy import PublicAddress
from robbie_mp.station.web.rate_limits import LoginLimit

SESSION_COOKIE = "robbie_session"
SESSION = "robbie.session"
"""Key of the session in the scope of an admitted request."""
CONNECTION = "robbie.connection"
"""Key of the other end of a request's connection, which may be a proxy; the scope's client is the browser."""
LOGIN_PATH = "/login"
LOGOUT_PATH = "/logout"
STOP_PATH = "/emergency-stop"
MESSAGES_BURST = 200
MESSAGES_PER_S = 100.0
"""Maximum rate from one page on one socket. A page that drives sends 10 a second; faster messages wait."""
MAX_FORM_BYTES = 4096

MAX_FOREIGN = 32
"""Maximum number of origins and hosts of refused requests that are remembered, so that each is told once."""
MAX_SHOWN = 200
"""Maximum number of characters of an origin or host in a text."""

HEAD = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{robot}: {title}</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>body{{font:1.1rem sans-serif;display:grid;place-items:center;min-height:90vh}}
body{{background:#10151b;color:#eee}}main{{max-width:40rem;white-space:pre-line}}
input,button{{font:inherit;padding:.6rem;width:100%;box-sizing:border-box;margin-top:.6rem}}
.error{{color:#ff8a80}}h1{{font-size:1.4rem;border-left:.6rem solid {colour};padding-left:.6rem}}</style>"""
LOGIN_FORM = """<form method="post" action="login"><h1>{robot}</h1>
<input name="username" value="robbie" autocomplete="username" hidden>
<label for="token">Token of this robot</label>
<input id="token" name="token" type="password" autocomplete="current-password" autofocus required>
<p class="error" role="alert">{error}</p><button>Log in</button></form>
<main id="address" class="error" role="alert" hidden>{unknown}</main><script>
const here = location.origin + location.pathname.replace(/login$/, "");
const note = document.getElementById("address");
note.textContent = note.textContent.replaceAll("HERE", here);
note.hidden = {known}.includes(here);
</script></html>"""
UNKNOWN = """Your browser shows this page at HERE, but the robot {knows}, so you cannot log in.
If a proxy serves the page there, set for the operator station
public_address: HERE"""
"""Tells what is wrong before anybody has typed a token. The page's script fills in the address."""
REFUSED = """Refused: the request comes from a page of {origin}, but it was sent to {host}.
If a page of another site has sent you here, close this one.
If a proxy serves the robot's page, set for the operator station the address that your browser shows, such as
public_address: {example}/
or let the proxy pass on the Host that your browser names (nginx: proxy_set_header Host $http_host).
"""

App = Callable[[Scope, Receive, Send], Awaitable[None]]


class Gate:
    """Lets requests through to the page server, or answers them itself.

    Args:
        app: the page server.
        access: checks sessions and tokens, and logs refusals.
        connections: the connections on which the requests arrive.
        public: the address at which a proxy serves the page.
        identity: the robot's name and colour.
        cookie: name of the cookie with the session.

    Attributes:
        foreign: number of requests that were refused because they came from pages of other sites.
    """

    def __init__(
        self,
        app: App,
        access: Access,
        connections: Connections,
        public: PublicAddress | None = None,
        identity: Identity = ANY_ROBOT,
        cookie: str = SESSION_COOKIE,
    ):
        self.foreign = 0
        self._identity = identity
        self._cookie = cookie
        self._app = app
        self._access = access
        self._connections = connections
        self._public = public or PublicAddress()
        self._tries = LoginLimit()
        self._told: set[tuple[str, str]] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        scope["path"] = self._public.own_path(scope["path"])
        visit = HTTPConnection(scope)
        answer = await self._answer(visit, receive)
        if answer is not None:
            await answer(scope, receive, send)
            return
        scope[SESSION] = visit.cookies[self._cookie]
        await self._app(scope, paced(receive) if is_socket(visit) else receive, send)

    async def _answer(self, visit: HTTPConnection, receive: Receive) -> App | None:
        """Return the answer to a request that the page server does not get; None lets it through."""
        origin, host = visit.headers.get("origin"), visit.headers.get("host")
        if not is_own_origin(origin, host, self._public.origin):
            return self._refuse_foreign(visit, shown(origin), shown(host))
        if not visit.scope["path"] and not is_socket(visit):
            return RedirectResponse(f"{self._public.path}/", 303)
        session, path = visit.cookies.get(self._cookie), visit.scope["path"]
        if path in (LOGIN_PATH, LOGOUT_PATH) and not is_socket(visit):
            log = self._log_in if path == LOGIN_PATH else self._log_out
            return await log(visit, receive, session)
        return self._admit(visit, session, path)

    def _admit(self, visit: HTTPConnection, session: str | None, path: str) -> App | None:
        role = self._access.role_of(session)
        if session is None or role is None:
            return ask_to_log_in(visit)
        if not is_socket(visit) and visit.scope["method"] not in ("GET", "HEAD"):
            if path == STOP_PATH:  # a page asks why it gets no connection: not because of the checks here
                return Response(status_code=204)
            return refused(visit, "only GET and HEAD are answered", 405)
        connection = visit.scope.get(CONNECTION, visit.scope.get("client"))
        if not self._connections.admit(connection, session, role):
            text = "too many connections; close some pages"
            return refused(visit, text, 503, {"Connection": "close"})
        return None

    def _refuse_foreign(self, visit: HTTPConnection, origin: str, host: str) -> App:
        """Refuse a request of another site's page. The trace names it once; the status counts all."""
        self.foreign += 1
        if (origin, host) not in self._told and len(self._told) < MAX_FOREIGN:
            self._told.add((origin, host))
            text = (
                "refused a request of %s to %s from a page of %s; if that is your proxy, set public_address"
            )
            self._access.refusals.warning(text, peer(visit), repr(host), repr(origin))
        text = REFUSED.format(origin=origin, host=host, example=origin)
        if is_socket(visit) or "text/html" not in visit.headers.get("accept", ""):
            return refused(visit, text.rstrip(), 403)
        return HTMLResponse(f"{self._head('refused')}<main>{escape(text)}</main></html>", 403)

    def _is_secure(self, visit: HTTPConnection) -> bool:
        """Return whether the browser has reached the page, or at least the proxy, by https."""
        address = visit.headers.get("origin") or self._public.origin or f"{visit.url.scheme}://"
        return urlsplit(address).scheme == "https"

    def _head(self, title: str) -> str:
        robot, colour = self._identity
        return HEAD.format(title=title, robot=escape(robot), colour=colour)

    def _login_page(self, visit: HTTPConnection, error: str, *more: Any) -> Response:
        """Return the page with the form for the token."""
        host = shown(visit.headers.get("host"))
        known = [f"{scheme}://{host}{self._public.path}/" for scheme in ("http", "https")]
        addresses = json.dumps([*known, str(self._public)]).replace("<", "\\u003c")
        knows = f"serves it at {self._public}" if self._public.origin else "does not know this address"
        unknown = UNKNOWN.format(knows=knows)
        form = LOGIN_FORM.format(
            robot=escape(self._identity.name), error=escape(error), unknown=unknown, known=addresses
        )
        return HTMLResponse(self._head("log in") + form, *more)

    async def _log_in(self, visit: HTTPConnection, receive: Receive, _session: str | None) -> Response:
        if visit.scope["method"] == "POST":
            form = await read_body(receive)
            token = parse_qs(form.decode("utf-8", "replace")).get("token", [""])[0]
        elif visit.headers.get("sec-fetch-site") == "cross-site":
            return self._login_page(
                visit, "a page of another site has sent you here: enter the token yourself"
            )
        else:  # a link with the token in it, such as the one that `robbie run` prints
            token = visit.query_params.get("token", "")
            if not token:
                return self._login_page(visit, "")
        source = source_of(peer(visit))
        wait_s = math.ceil(self._tries.wait_s(source))
        if wait_s:
            self._access.refusals.warning("too many wrong tokens from %s", source)
            text = f"too many wrong tokens from your address; try again in {wait_s} s"
            return self._login_page(visit, text, 429, {"Retry-After": str(wait_s)})
        session = self._access.log_in(token)
        if session is None:
            self._tries.note_wrong(source)
            self._access.refusals.warning("wrong token from %s", source)
            return self._login_page(visit, "that is not the token", 403)
        # Where to go, and for which paths the cookie is, starts from the address that the browser knows.
        response = RedirectResponse("./", 303)
        is_secure = self._is_secure(visit)
        response.set_cookie(
            self._cookie, session, path=None, secure=is_secure, httponly=True, samesite="strict"
        )
        return response

    async def _log_out(self, visit: HTTPConnection, _receive: Receive, session: str | None) -> Response:
        """End a session with all its pages. It requires a POST, so that no link or picture can do it."""
        if visit.scope["method"] != "POST":
            return PlainTextResponse("log out by POST\n", 405)
        if session is not None:
            self._access.log_out(session)
            self._connections.end(session)
        response = RedirectResponse("login", 303)
        # Starlette's `delete_cookie` names a path.
        response.set_cookie(self._cookie, max_age=0, path=None, httponly=True, samesite="strict")
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
        return RedirectResponse("login", 303)
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


def with_forwarded(app: App, proxies: Sequence[str]) -> App:
    """Return an application that gets the browser's address and scheme, as trusted proxies say them.

    Args:
        app: the application.
        proxies: addresses and networks of the proxies; what others say is ignored.
    """
    behind = cast(App, ProxyHeadersMiddleware(cast(Any, app), [*proxies]))

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if "client" in scope:
            scope[CONNECTION] = scope["client"]
            # NiceGUI would take it from anybody.
            scope["headers"] = [one for one in scope["headers"] if one[0].lower() != b"x-forwarded-prefix"]
        await behind(scope, receive, send)

    return answer


def below(path: str, app: App) -> App:
    """Return an application that writes a path before the addresses in its pages.

    Args:
        path: the path, such as `/robot1`; '': none.
        app: the application, which follows ASGI in that.
    """

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if "path" in scope:
            scope = {**scope, "path": f"{path}{scope['path']}", "root_path": path}
        await app(scope, receive, send)

    return answer


def shown(name: str | None) -> str:
    """Return the origin or host that a request names, in a length that fits into a text."""
    return (name or "no host")[:MAX_SHOWN]


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
