"""Pages without a browser: `python -m tools.load.operator.light_pages ADDRESS ROLE/TAB …`.

They load, connect, receive and answer as the real page does, but draw nothing. They take only the processor
time that the robot leaves, as if they ran on another machine. Their output has the same form as that of
`browser_pages`.
"""

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
from tools.load.operator import NICE, token_of

GROUPS = {"view": "view+map", "map": "marks+map"}
FRAME_S = 1 / 60
ACKNOWLEDGE_S = 3.0
ELEMENTS = re.compile(r"parseElements\(String\.raw`(.*?)`\)", re.DOTALL)
QUERY = re.compile(r"query: (\{.*?\}),\n")


class LightPage:
    """One page.

    Args:
        http: session that makes the page's requests and keeps its cookies.
        address: address of the server.
        role: role of the user.
        tab: tab that the page shows.
    """

    def __init__(self, http: aiohttp.ClientSession, address: str, role: str, tab: str):
        self._http = http
        self._address = address
        self._role = role
        self._tab = tab
        self._socket = socketio.AsyncClient(http_session=http, reconnection=False)
        self._socket.on("*", self._on_message)
        self._next_message = 0
        self._images: dict[str, int] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self.counts = {"view": 0, "map": 0, "cameras": 0, "frames": 0}

    async def open(self) -> None:
        """Log in, load the page, connect, and turn to the tab."""
        form = {"token": token_of(self._role)}
        async with self._http.post(f"{self._address}login", data=form) as answer:
            text = await answer.text()
        found, query = ELEMENTS.search(text), QUERY.search(text)
        if found is None or query is None:
            raise RuntimeError(f"the page at {self._address} has a form that this program does not know")
        self._elements = json.loads(unescape(found[1]))
        self._query = ast.literal_eval(query[1]) | {
            "tab_id": str(uuid.uuid4()),
            "document_id": str(uuid.uuid4()),
        }
        self._query = {name: _as_text(value) for name, value in self._query.items()}
        await self._socket.connect(
            f"{self._address}?{urlencode(self._query)}",
            transports=["websocket"],
            socketio_path="/_nicegui_ws/socket.io",
        )
        await self._tell("nicegui-scene", "init", {})
        await self._tell("q-tabs", "update:modelValue", self._tab)
        self._start(self._acknowledge())
        if self._tab in GROUPS:
            self._start(self._follow(GROUPS[self._tab]))

    async def _tell(self, tag: str, event: str, argument: object) -> None:
        """Send an event of the element with a tag, of which there must be only one."""
        for key, element in self._elements.items():
            for listener in element.get("events", []):
                if element["tag"] == tag and listener["type"] == event:
                    await self._socket.emit(
                        "event",
                        {
                            "id": int(key),
                            "client_id": self._query["client_id"],
                            "listener_id": listener["listener_id"],
                            "args": [json.dumps(argument)],
                        },
                    )

    async def _follow(self, groups: str) -> None:
        async with self._http.ws_connect(
            f"{self._address}live/{groups}", max_msg_size=0, compress=15
        ) as live:
            async for _ in live:
                await asyncio.sleep(FRAME_S)
                await live.send_str("drawn")
                self.counts[self._tab] += 1

    async def _acknowledge(self) -> None:
        while True:
            await asyncio.sleep(ACKNOWLEDGE_S)
            if not self._socket.connected:
                print(f"the {self._role}'s page with {self._tab} has lost its connection", file=sys.stderr)
                return
            seen = {"client_id": self._query["client_id"], "next_message_id": self._next_message}
            await self._socket.emit("ack", seen)

    async def _on_message(self, event: str, data: dict[str, Any]) -> None:
        self._next_message = max(self._next_message, data.pop("_id", -1) + 1)
        if event == "run_javascript" and "request_id" in data:
            answer = {"request_id": data["request_id"], "client_id": self._query["client_id"], "result": None}
            await self._socket.emit("javascript_response", answer)
        if event == "update":
            for element in data.values():
                properties = (element or {}).get("props", {})
                if properties.get("count") and "address" in properties:
                    self._show(properties["address"], properties["count"])

    def _show(self, address: str, count: int) -> None:
        """Fetch a picture, unless the previous one is still in transit."""
        is_fetching = address in self._images
        self._images[address] = count
        if not is_fetching:
            self._start(self._fetch(address))

    async def _fetch(self, address: str) -> None:
        shown = 0
        while (count := self._images[address]) != shown:
            shown = count
            async with self._http.get(f"{self._address.rstrip('/')}{address}?count={count}") as answer:
                await answer.read()
            self.counts["cameras"] += 1
        del self._images[address]

    def _start(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def close(self) -> None:
        """Close the connection."""
        working = tuple(self._tasks)
        for task in working:
            task.cancel()
        await asyncio.gather(*working, return_exceptions=True)
        await self._socket.disconnect()
        await self._http.close()


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


async def main(address: str, visits: list[str]) -> None:
    """Open the pages, and answer requests until the input ends."""
    loop = asyncio.get_running_loop()
    pages = []
    for visit in visits:
        http = aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True))
        pages.append(LightPage(http, address, *visit.split("/")))
        await pages[-1].open()
    print("ready", flush=True)
    while await loop.run_in_executor(None, sys.stdin.readline):
        print(json.dumps([page.counts for page in pages]), flush=True)
    for page in pages:
        await page.close()


if __name__ == "__main__":
    lower_priority(NICE, logging.getLogger())
    asyncio.run(main(sys.argv[1], sys.argv[2:]))
