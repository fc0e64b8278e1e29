"""Data waiting for a page is bounded: a slow browser gets the newest state, or is disconnected."""

import asyncio
import errno
import json
import socket
import struct
from contextlib import closing
from functools import partial
from typing import Any

import pytest
import socketio
from engineio.async_socket import AsyncSocket

from robbie_mp.station.live import LiveParts
from robbie_mp.station.live.network import NetworkCost, PageNetwork
from robbie_mp.station.live.parts import (
    PACKET_BYTES,
    PACKETS_AHEAD,
    SENT,
    SMALL_BYTES,
    USED_SHARE,
    Follower,
    way_of,
)
from robbie_mp.station.live.server import serve
from robbie_mp.station.page.build import MAX_WAITING_PACKETS, NAMESPACE, BrowserLink
from robbie_mp.station.web.listening import listen

LARGE = bytes(SMALL_BYTES + 1)
LIMIT_S = 60.0


def unpacked(packet: bytes | None) -> dict[str, bytes]:
    """As the page's script does it."""
    assert packet is not None
    at = 4 + struct.unpack_from("<I", packet)[0]
    parts = {}
    for name, size in json.loads(packet[4:at]):
        parts[name] = packet[at : at + size]
        at += size
    assert at == len(packet)
    float(parts.pop(SENT))
    return parts


AT_ONCE = NetworkCost()
AT_ONCE.add(PACKET_BYTES, 0.0)


def following(live: LiveParts, *groups: str) -> Follower:
    network = PageNetwork()
    network.costs.add(AT_ONCE)
    return Follower(live, frozenset(groups), network)


def test_packet_contains_the_changes_of_the_followed_groups() -> None:
    async def run() -> None:
        live = LiveParts()
        follower = following(live, "view", "map")
        live.put("view", {"poses": b"1", "path": b"2"})
        live.put("viewer", {"poses": b"3"})
        live.put("map", {"place": b""})
        first = unpacked(await follower.next())
        assert first == {"view/poses": b"1", "view/path": b"2", "map/place": b""}
        live.put("view", {"poses": b"1", "path": b"4"})
        assert unpacked(await follower.next()) == {"view/path": b"4"}

    asyncio.run(run())


def test_page_that_does_not_draw_has_two_packets_in_flight_then_the_newest() -> None:
    async def run() -> None:
        live = LiveParts()
        follower = following(live, "view")
        sent = []
        for number in range(1000):
            live.put("view", {"poses": str(number).encode()})
            waiting = asyncio.ensure_future(follower.next())
            await asyncio.sleep(0)
            if not waiting.done():
                break
            sent.append(unpacked(await waiting)["view/poses"])
        assert sent == [b"0", b"1"]
        assert len(sent) == PACKETS_AHEAD
        for number in range(1000):
            live.put("view", {"poses": f"later {number}".encode()})
        follower.hear("drawn")
        assert unpacked(await waiting) == {"view/poses": b"later 999"}
        assert len(live.parts) == 1

    asyncio.run(run())


def test_packets_are_bounded_with_small_parts_first_and_large_ones_in_turn() -> None:
    async def run() -> None:
        live = LiveParts()
        follower = following(live, "view")
        tiles = {f"tile/{number}": LARGE for number in range(50)}
        seen: set[str] = set()
        for number in range(10):
            live.put("view", tiles | {"poses": str(number).encode()})
            packet = follower.packet()
            assert packet is not None
            assert len(packet) < PACKET_BYTES + SMALL_BYTES
            parts = unpacked(packet)
            assert parts["view/poses"] == str(number).encode()
            seen |= parts.keys()
        assert len(seen) == 51
        assert follower.packet() is None

    asyncio.run(run())


def test_packet_is_small_while_pictures_find_the_network_slow() -> None:
    async def run() -> None:
        live, network = LiveParts(), PageNetwork()
        network.costs.add(slow := NetworkCost())
        slow.add(PACKET_BYTES, 60.0)
        live.put("view", {f"tile/{number}": LARGE for number in range(50)})
        follower = Follower(live, frozenset({"view"}), network)
        follower._cost.add(PACKET_BYTES, 0.0)
        assert len(unpacked(follower.packet())) == 1

    asyncio.run(run())


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_packets_leave_most_of_the_network_to_others(share: float) -> None:
    async def run() -> None:
        live, network, cost_s = LiveParts(), PageNetwork(), 0.01
        network.costs.add(known := NetworkCost())
        known.add(len(LARGE), cost_s)
        network.share = share
        follower = Follower(live, frozenset({"view"}), network)
        begin_s = asyncio.get_running_loop().time()
        for number in range(2):
            live.put("view", {"tile": LARGE + bytes([number])})
            await follower.next()
            follower.hear("{}")
        assert asyncio.get_running_loop().time() - begin_s > cost_s / (USED_SHARE * share)

    asyncio.run(run())


def test_new_page_gets_the_latest_changes_first() -> None:
    async def run() -> None:
        live = LiveParts()
        live.put("map", {f"tile/{number}": LARGE for number in range(50)})
        live.put("view", {"points": LARGE})
        first = unpacked(following(live, "map", "view").packet())
        assert next(iter(first)) == "view/points"

    asyncio.run(run())


def test_removed_part_is_forgotten_and_sent_again_when_it_returns() -> None:
    async def run() -> None:
        live = LiveParts()
        follower = following(live, "map")
        for data in (b"1", b"1"):
            live.put("map", {"tile": data})
            assert unpacked(follower.packet()) == {"map/tile": b"1"}
            live.put("map", {})
            assert follower.packet() is None
        assert not live.parts

    asyncio.run(run())


@pytest.mark.parametrize(
    ("way_s", "parts", "wait_s"),
    [(0.025, 6, 0.0), (0.08, 1, 0.25), (5.0, 1, 1.0), (1e300, 1, 1.0), (0.003, 30, 0.0), (-1.0, 30, 0.0)],
    ids=["1 Mbit/s", "0.3 Mbit/s", "a jam", "nonsense", "8 Mbit/s", "a clock that is wrong"],
)
def test_packets_leave_room_on_a_slow_network(way_s: float, parts: int, wait_s: float) -> None:
    async def run() -> None:
        live, size = LiveParts(), 1000
        follower = following(live, "map")
        live.put("map", {f"tile/{number}": bytes(size) for number in range(3)})
        assert len(unpacked(await follower.next())) == 3
        follower.hear(json.dumps({"way_s": way_s}))
        follower.hear("nothing was sent")
        live.put("map", {f"tile/{number}": bytes([7]) * size for number in range(30)})
        begin_s = asyncio.get_running_loop().time()
        assert len(unpacked(await follower.next())) == parts
        waited_s = asyncio.get_running_loop().time() - begin_s
        assert wait_s * 0.9 <= waited_s < wait_s + 0.2

    asyncio.run(run())


@pytest.mark.parametrize("said", ["", "drawn", "{", "[]", '{"way_s": null}', '{"way_s": "x"}', "9" * 1000])
def test_page_that_knows_no_clock_costs_nothing(said: str) -> None:
    assert way_of(said) is None


def test_closed_page_requests_nothing() -> None:
    async def run() -> None:
        live = LiveParts()
        told: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        sent: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        told.put_nowait({"type": "websocket.connect"})
        follow = partial(Follower, live, frozenset({"map"}), PageNetwork())
        serving = asyncio.ensure_future(serve(follow, told.get, sent.put))  # type: ignore[arg-type]
        assert (await sent.get())["type"] == "websocket.accept"
        live.put("map", {"place": b"here"})
        assert unpacked((await sent.get())["bytes"]) == {"map/place": b"here"}
        assert live.is_wanted("map")
        assert not live.is_wanted("view")
        told.put_nowait({"type": "websocket.receive", "text": "drawn"})
        told.put_nowait({"type": "websocket.disconnect", "code": 1001})
        await serving
        assert not live.is_wanted("map")

    asyncio.run(run())


def test_data_waiting_for_a_browser_that_does_not_read_is_bounded() -> None:
    async def run() -> None:
        server = socketio.AsyncServer(async_mode="asgi")
        engine = server.eio
        engine.sockets["connection"] = connection = AsyncSocket(engine, "connection")
        link = BrowserLink(server, "page")
        is_free_at_first = link.is_free
        assert not is_free_at_first, "there is no connection yet"
        visitor = await server.manager.connect("connection", NAMESPACE)
        await server.enter_room(visitor, "page")
        for number in range(1000):
            if link.is_free:
                await server.emit("update", {"number": number}, room="page")
        assert connection.queue.qsize() == MAX_WAITING_PACKETS
        await connection.queue.get()
        assert link.is_free

    asyncio.run(run())


def test_client_that_does_not_read_is_disconnected_by_the_kernel() -> None:
    with (
        closing(listen("127.0.0.1", 0, unread_limit_s=0.1)) as listener,
        closing(socket.create_connection(listener.getsockname())),
        closing(listener.accept()[0]) as connection,
    ):
        connection.settimeout(LIMIT_S)
        with pytest.raises(TimeoutError) as ended:
            while True:
                connection.sendall(bytes(1 << 16))
        assert ended.value.errno == errno.ETIMEDOUT
