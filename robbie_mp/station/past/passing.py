"""Passes requests and connections on to the page that plays a clip."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import aiohttp
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocketClose

from robbie_mp.station.past.player import PLAYER_PATH
from robbie_mp.station.web.access import Role
from robbie_mp.station.web.gate import SESSION, App

if TYPE_CHECKING:
    from robbie_mp.station.past.player import ClipPlayer
    from robbie_mp.station.web.access import Access

KEPT_OF_REQUEST = frozenset(
    (b"accept", b"accept-encoding", b"host", b"origin", b"if-none-match", b"nicegui-check")
)
NOT_PASSED_BACK = frozenset(("set-cookie", "connection", "transfer-encoding", "keep-alive", "date", "server"))
"""Headers that belong to one of the two connections, or that this station adds itself."""
CONNECT_S, READ_S = 5.0, 30.0
MAX_MESSAGE_BYTES = 1 << 24
NOTHING_PLAYS = "no clip plays; go back to the live page\n"


def with_clip_player(app: App, player: ClipPlayer, access: Access) -> App:
    """Return an application that passes the paths of the player on, and all others to another one."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        path = scope.get("path", "")
        if scope["type"] in ("http", "websocket") and f"{path}/".startswith(f"{PLAYER_PATH}/"):
            await _pass(player, access, scope, receive, send)
        else:
            await app(scope, receive, send)

    return answer


async def _pass(player: ClipPlayer, access: Access, scope: Scope, receive: Receive, send: Send) -> None:
    is_socket = scope["type"] == "websocket"
    address = player.address
    if address is None or access.role_of(scope[SESSION]) is not Role.OPERATOR:
        refusal = WebSocketClose(1008) if is_socket else PlainTextResponse(NOTHING_PLAYS, 404)
        await refusal(scope, receive, send)
        return
    player.used_s = time.monotonic()
    port, session = address
    path, query = f"{player.path}{scope['path'][len(PLAYER_PATH) :]}", str(scope["query_string"], "latin-1")
    url = f"http://127.0.0.1:{port}{path}{'?' if query else ''}{query}"
    headers = {
        str(name, "latin-1"): str(value, "latin-1")
        for name, value in scope["headers"]
        if name in KEPT_OF_REQUEST
    }
    headers["Cookie"] = session
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_S, sock_read=READ_S)
    async with aiohttp.ClientSession(timeout=timeout, auto_decompress=False) as client:
        try:
            if is_socket:
                await _pass_socket(player, client, url, headers, receive, send)
            else:
                await _pass_request(client, scope["method"], url, headers, send)
        except (aiohttp.ClientError, OSError, asyncio.TimeoutError):
            if not is_socket:
                await PlainTextResponse(NOTHING_PLAYS, 502)(scope, receive, send)


async def _pass_request(
    client: aiohttp.ClientSession, method: str, url: str, headers: dict[str, str], send: Send
) -> None:
    # The whole answer first: once its begin is sent, no error can be told any more.
    async with client.request(method, url, headers=headers, allow_redirects=False) as answer:
        body = await answer.read()
        passed = [
            (name.lower().encode("latin-1"), value.encode("latin-1"))
            for name, value in answer.headers.items()
            if name.lower() not in NOT_PASSED_BACK
        ]
    await send({"type": "http.response.start", "status": answer.status, "headers": passed})
    await send({"type": "http.response.body", "body": body})


async def _pass_socket(
    player: ClipPlayer,
    client: aiohttp.ClientSession,
    url: str,
    headers: dict[str, str],
    receive: Receive,
    send: Send,
) -> None:
    await receive()  # the connect message, which must be answered first
    try:
        there = await client.ws_connect(url, headers=headers, max_msg_size=MAX_MESSAGE_BYTES, autoping=True)
    except (aiohttp.ClientError, OSError, asyncio.TimeoutError):
        await send({"type": "websocket.close", "code": 1013})
        return
    await send({"type": "websocket.accept"})
    player.pages += 1
    back = asyncio.create_task(_pass_back(there, send))
    try:
        while (message := await receive())["type"] == "websocket.receive":
            if (text := message.get("text")) is not None:
                await there.send_str(text)
            elif (data := message.get("bytes")) is not None:
                await there.send_bytes(data)
    except (aiohttp.ClientError, OSError):
        pass  # the playback has just ended; `_pass_back` closes this connection, too
    finally:
        player.pages -= 1
        player.used_s = time.monotonic()
        back.cancel()
        await there.close()


async def _pass_back(there: aiohttp.ClientWebSocketResponse, send: Send) -> None:
    async for message in there:
        if message.type is aiohttp.WSMsgType.TEXT:
            await send({"type": "websocket.send", "text": message.data})
        elif message.type is aiohttp.WSMsgType.BINARY:
            await send({"type": "websocket.send", "bytes": message.data})
    await send({"type": "websocket.close", "code": 1001})
