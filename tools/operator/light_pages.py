"""A page without a browser: `python -m tools.operator.light_pages ADDRESS`.

It loads, connects, receives and answers as the real page does, but draws nothing. It takes only the processor
time that the robot leaves, as if it ran on another machine.
"""

import argparse
import ast
import asyncio
import json
import logging
import re
import sys
import uuid
from html import unescape
from typing import Any
from urllib.parse import urlencode

import aiohttp
import socketio

from robbie_mp.base.linux.priority import lower_priority

NICE = 19
FRAME_S = 1 / 60
ACKNOWLEDGE_S = 3.0
WIDTH_PX, SMALL_PX = 700, 150
FOLLOWED = ("marks+map", "view+map", "video")
QUERY = re.compile(r"query: (\{.*?\}),\n")
ELEMENTS = re.compile(r"parseElements\(String\.raw`(.*?)`\)", re.DOTALL)


class LightPage:
    """One page.

    Args:
        http: makes the page's requests, and keeps its cookies.
        address: of the server.
        layout: that the page shows.

    Attributes:
        counts: how many packets have come on each connection.
    """

    def __init__(self, http: aiohttp.ClientSession, address: str, layout: str):
        self._http, self._address, self._layout = http, address, layout
        self._socket = socketio.AsyncClient(http_session=http, reconnection=False)
        self._socket.on("*", self._on_message)
        self._next_message = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self.counts = dict.fromkeys((*FOLLOWED, "states"), 0)

    async def open(self, token: str, cameras: list[str]) -> None:
        """Log in, load the page, and connect."""
        async with self._http.post(f"{self._address}login", data={"token": token}) as answer:
            await answer.read()
        async with self._http.get(f"{self._address}?layout={self._layout}") as answer:
            text = await answer.text()
        query = QUERY.search(text)
        if query is None or ELEMENTS.search(text) is None:
            raise RuntimeError(f"the page at {self._address} has a form that this program does not know")
        found = ast.literal_eval(unescape(query[1]))
        found |= {"tab_id": str(uuid.uuid4()), "document_id": str(uuid.uuid4())}
        self._client = str(found["client_id"])
        asked = urlencode({name: _as_text(value) for name, value in found.items()})
        await self._socket.connect(
            f"{self._address}?{asked}", transports=["websocket"], socketio_path="/_nicegui_ws/socket.io"
        )
        self._start(self._acknowledge())
        want = {name: WIDTH_PX if number == 0 else SMALL_PX for number, name in enumerate(cameras)}
        for groups in FOLLOWED:
            self._start(self._follow(groups, json.dumps({"want": want}) if groups == "video" else ""))

    async def _follow(self, groups: str, first: str) -> None:
        url = f"{self._address}live/{groups}?page={self._client}"
        async with self._http.ws_connect(url, max_msg_size=0) as live:
            if first:
                await live.send_str(first)
            async for _ in live:
                await asyncio.sleep(FRAME_S)
                await live.send_str('{"way_s": 0.0}')
                self.counts[groups] += 1

    async def _acknowledge(self) -> None:
        while self._socket.connected:
            await asyncio.sleep(ACKNOWLEDGE_S)
            await self._socket.emit("ack", {"client_id": self._client, "next_message_id": self._next_message})

    async def _on_message(self, event: str, data: Any) -> None:
        self.counts["states"] += 1
        if not isinstance(data, dict):
            return
        self._next_message = max(self._next_message, data.pop("_id", -1) + 1)
        if event == "run_javascript" and "request_id" in data:
            answer = {"request_id": data["request_id"], "client_id": self._client, "result": None}
            await self._socket.emit("javascript_response", answer)

    def _start(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Close the connections."""
        working = tuple(self._tasks)
        for task in working:
            task.cancel()
        await asyncio.gather(*working, return_exceptions=True)
        await self._socket.disconnect()
        await self._http.close()


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


async def show(address: str, token: str, layout: str, cameras: list[str]) -> None:
    """Open a page, and print its counts for each line of the input, until that ends."""
    page = LightPage(aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)), address, layout)
    await page.open(token, cameras)
    print("ready", flush=True)
    while await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline):
        print(json.dumps(page.counts), flush=True)
    await page.close()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("address")
    parser.add_argument("token")
    parser.add_argument("layout")
    parser.add_argument("cameras", nargs="*")
    chosen = parser.parse_args(arguments)
    lower_priority(NICE, logging.getLogger())
    asyncio.run(show(chosen.address, chosen.token, chosen.layout, chosen.cameras))


if __name__ == "__main__":
    main()
