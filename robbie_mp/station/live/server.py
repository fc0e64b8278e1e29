"""Connections for live parts and video: the station sends packets, and pages report what they have drawn."""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

from starlette.types import Receive, Scope, Send

from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.parts import Follower, LiveParts
from robbie_mp.station.live.video import VIDEO, NetworkCost, VideoFollower
from robbie_mp.station.watch.pictures import NewestPicture
from robbie_mp.station.web.gate import App

PATH = "/live/"
"""Beginning of the connections' paths. The followed groups are next, such as `/live/map+marks`."""


class Follows(Protocol):
    """Chooses what one page gets next."""

    def hear(self, said: str) -> None:
        """Handle what the page says."""

    async def next(self) -> bytes | None:
        """Wait for the next packet; None if there will be none."""

    def go(self) -> None:
        """Stop sending."""


def with_live(
    app: App, live: LiveParts, cameras: Callable[[], Mapping[str, NewestPicture]], streams: VideoStreams
) -> App:
    """Return an application that serves live parts and video, and passes other requests to another one."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket" and scope["path"].startswith(PATH):
            groups = frozenset(scope["path"][len(PATH) :].split("+"))
            parts = partial(Follower, live, groups, NetworkCost())
            video = partial(VideoFollower, cameras, streams)
            await serve(video if groups == {VIDEO} else parts, receive, send)
        else:
            await app(scope, receive, send)

    return answer


async def serve(follow: Callable[[], Follows], receive: Receive, send: Send) -> None:
    """Serve one page until it closes or stops drawing."""
    await receive()  # the connect message, which must be answered first
    await send({"type": "websocket.accept"})
    follower = follow()
    listener = asyncio.create_task(_listen(follower, receive))
    try:
        while (packet := await follower.next()) is not None:
            await send({"type": "websocket.send", "bytes": packet})
    finally:
        follower.go()
        listener.cancel()


async def _listen(follower: Follows, receive: Receive) -> None:
    while (message := await receive())["type"] == "websocket.receive":
        follower.hear(message.get("text") or "")
    follower.go()
