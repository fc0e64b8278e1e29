"""The gate before every request: who asks, from where, and whether that is allowed."""

import logging
from collections.abc import Awaitable, Callable, MutableMapping
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import Receive, Scope, Send

from robbie_mp.services.operator_station.access import Access, is_local_name, is_own_origin

SESSION_COOKIE = "robbie_session"
SESSION = "robbie.session"
"""Where the session stands in the scope of a request that was let through."""
LOGIN_PATH = "/login"
LONGEST_FORM_BYTES = 4096

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
        access: who may enter.
        log: hears of who was refused.
    """

    def __init__(self, app: App, access: Access, log: logging.Logger):
        self._app = app
        self._access = access
        self._log = log

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(headers)
        if refusal is None and scope["path"] == LOGIN_PATH and scope["type"] == "http":
            await (await self._log_in(scope, receive))(scope, receive, send)
            return
        session = session_of(headers)
        if refusal is None and self._access.role_of(session) is None:
            await self._ask(scope, receive, send)
            return
        if refusal is not None:
            self._log.warning("refused a request of %s: %s", peer(scope), refusal)
            await self._deny(scope, receive, send, PlainTextResponse(f"{refusal}\n", 403))
            return
        scope[SESSION] = session or ""
        await self._app(scope, receive, send)

    def _refusal(self, headers: MutableMapping[str, str]) -> str | None:
        if not is_own_origin(headers.get("origin"), headers.get("host")):
            return f"it comes from a page of {headers.get('origin')}"
        if self._access.is_open and not is_local_name(headers.get("host")):
            return f"it asks for {headers.get('host')}, which is no name of this machine for itself"
        return None

    async def _ask(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == "/":
            await RedirectResponse(LOGIN_PATH, 303)(scope, receive, send)
        else:
            await self._deny(scope, receive, send, PlainTextResponse("log in first\n", 401))

    async def _deny(self, scope: Scope, receive: Receive, send: Send, response: Response) -> None:
        if scope["type"] == "websocket":
            await receive()  # the connect, which is to be answered
            await send({"type": "websocket.close", "code": 1008})
        else:
            await response(scope, receive, send)

    async def _log_in(self, scope: Scope, receive: Receive) -> Response:
        if self._access.is_open:
            return RedirectResponse("/", 303)
        if scope["method"] != "POST":
            return login_page("")
        form = await read_body(receive)
        token = parse_qs(form.decode("utf-8", "replace")).get("token", [""])[0]
        session = self._access.log_in(token)
        if session is None:
            self._log.warning("wrong token from %s", peer(scope))
            return login_page("that is not the token", 403)
        response = RedirectResponse("/", 303)
        response.set_cookie(SESSION_COOKIE, session, httponly=True, samesite="strict")
        return response


def login_page(error: str, status: int = 200) -> Response:
    """Return the form that asks for the token."""
    return HTMLResponse(LOGIN_PAGE.format(error=escape(error)), status)


async def read_body(receive: Receive) -> bytes:
    """Read a request's body; what is longer than any form of ours is cut off."""
    body = b""
    while len(body) < LONGEST_FORM_BYTES:
        message = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body[:LONGEST_FORM_BYTES]


def session_of(headers: MutableMapping[str, str]) -> str | None:
    """Return the session that a request names."""
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(SESSION_COOKIE)
    except CookieError:
        return None
    return cookie.value if cookie else None


def peer(scope: MutableMapping[str, Any]) -> str:
    """Return the address of who asks."""
    client = scope.get("client")
    return f"{client[0]}" if client else "an unknown address"
