"""Connections on which pages follow live parts: packets one way; the other way, that each has been drawn."""

import asyncio

from starlette.types import Receive, Scope, Send

from robbie_mp.station.gate import App
from robbie_mp.station.live.parts import Follower, LiveParts

PATH = "/live/"
"""Of the connections; then come the groups that are followed: `/live/map+marks`."""


def with_live(app: App, live: LiveParts) -> App:
    """Return an application that serves live parts, and for all else another one."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket" and scope["path"].startswith(PATH):
            await serve(live, frozenset(scope["path"][len(PATH) :].split("+")), receive, send)
        else:
            await app(scope, receive, send)

    return answer


async def serve(live: LiveParts, groups: frozenset[str], receive: Receive, send: Send) -> None:
    """Serve one page until it goes, or draws nothing any more."""
    await receive()  # the connect, which is to be answered
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
