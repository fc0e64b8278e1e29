"""Connections for live parts and video: the station sends packets, and pages report what they have drawn."""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol
from urllib.parse import parse_qs

from starlette.types import Receive, Scope, Send

from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.network import PageNetwork
from robbie_mp.station.live.parts import Follower, LiveParts
from robbie_mp.station.live.video import VIDEO, VideoFollower
from robbie_mp.station.watch.pictures import NewestPicture
from robbie_mp.station.web.gate import SESSION, App

PATH = "/live/"
"""Beginning of the connections' paths. The followed groups are next, such as `/live/map+marks?page=…`."""
MAX_GROUPS = 16
"""Maximum number of groups of one connection; each is looked for in each part."""


class LivePage(Protocol):
    """A page that is open.

    Attributes:
        session: the visitor's session.
        network: that of the page, which its pictures and packets share.
    """

    session: str
    network: PageNetwork


class Follows(Protocol):
    """Chooses what one page gets next."""

    def hear(self, said: str) -> None:
        """Handle what the page says."""

    async def next(self) -> bytes | None:
        """Wait for the next packet; None if there will be none."""

    def go(self) -> None:
        """Stop sending."""


def with_live(
    app: App,
    live: LiveParts,
    cameras: Callable[[], Mapping[str, NewestPicture]],
    streams: VideoStreams,
    pages: Mapping[str, LivePage],
) -> App:
    """Return an application that serves live parts and video, and passes other requests to another one."""

    def network_of(scope: Scope) -> PageNetwork:
        page = pages.get(parse_qs(scope["query_string"].decode("latin-1")).get("page", [""])[0])
        return page.network if page is not None and page.session == scope[SESSION] else PageNetwork()

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        is_live = scope["type"] == "websocket" and scope["path"].startswith(PATH)
        groups = frozenset(scope["path"][len(PATH) :].split("+", MAX_GROUPS)) if is_live else frozenset()
        if 0 < len(groups) <= MAX_GROUPS:
            network = network_of(scope)
            parts = partial(Follower, live, groups, network)
            video = partial(VideoFollower, cameras, streams, network)
            await serve(video if groups == {VIDEO} else parts, receive, send)
        else:
            await app(scope, receive, send)

    return answer


async def serve(follow: Callable[[], Follows], receive: Receive, send: Send) -> None:
    """Serve one page until it closes or stops drawing."""
    await receive()  # the connect message, which must be answered first
    await send({"type": "websocket.accept"})
    follower = follow()
    sending = asyncio.create_task(_send(follower, send))
    listening = asyncio.create_task(_listen(follower, receive))
    try:
        await asyncio.wait({sending, listening}, return_when=asyncio.FIRST_COMPLETED)
        if sending.done():
            sending.result()
    finally:
        follower.go()
        sending.cancel()
        listening.cancel()


async def _send(follower: Follows, send: Send) -> None:
    while (packet := await follower.next()) is not None:
        await send({"type": "websocket.send", "bytes": packet})


async def _listen(follower: Follows, receive: Receive) -> None:
    while (message := await receive())["type"] == "websocket.receive":
        follower.hear(message.get("text") or "")
