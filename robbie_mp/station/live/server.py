"""Connections for live parts: the station sends packets, and pages report when they have drawn each."""

import asyncio

from starlette.types import Receive, Scope, Send

from robbie_mp.station.live.parts import Follower, LiveParts
from robbie_mp.station.web.gate import App

PATH = "/live/"
"""Beginning of the connections' paths. The followed groups are next, such as `/live/map+marks`."""


def with_live(app: App, live: LiveParts) -> App:
    """Return an application that serves live parts, and passes all other requests to another one."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket" and scope["path"].startswith(PATH):
            await serve(live, frozenset(scope["path"][len(PATH) :].split("+")), receive, send)
        else:
            await app(scope, receive, send)

    return answer


async def serve(live: LiveParts, groups: frozenset[str], receive: Receive, send: Send) -> None:
    """Serve one page until it closes or stops drawing."""
    await receive()  # the connect message, which must be answered first
    await send({"type": "websocket.accept"})
    follower = Follower(live, groups)
    live.join(follower)
    listener = asyncio.create_task(_listen(follower, receive))
    try:
        while (packet := await follower.next()) is not None:
            await send({"type": "websocket.send", "bytes": packet})
    finally:
        live.leave(follower)
        listener.cancel()


async def _listen(follower: Follower, receive: Receive) -> None:
    while (await receive())["type"] == "websocket.receive":
        follower.has_drawn()
    follower.go()
