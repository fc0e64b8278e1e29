"""All that is sent to a page shares its network, so that commands and their answers do not wait behind it."""

import asyncio
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from robbie_mp.station.live import network
from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.network import LEAST_SHARE, STUCK_S, UNDER_WAY_S, NetworkCost, PageNetwork
from robbie_mp.station.live.parts import LiveParts
from robbie_mp.station.live.server import with_live
from robbie_mp.station.page import page as pages
from robbie_mp.station.page.page import Page
from robbie_mp.station.web.gate import SESSION

AHEAD_S = 5000.0
"""The page's clock is ahead by this."""


def pinged(page: PageNetwork, ways_s: list[float], begin_s: float = 0.0) -> float:
    for number, way_s in enumerate(ways_s):
        sent_s = begin_s + 0.25 * number
        page.ping_came(sent_s, sent_s + way_s + AHEAD_S)
    return page.share


def test_what_can_wait_is_sent_more_rarely_while_pings_are_late() -> None:
    page = PageNetwork()
    assert pinged(page, 40 * [0.3]) == 1.0, "of a long way"
    assert pinged(page, 2 * [0.45], 10.0) < 0.7
    assert pinged(page, 40 * [0.45], 20.0) == LEAST_SHARE
    assert pinged(page, 120 * [0.32], 30.0) == 1.0


def test_way_that_has_become_longer_counts_as_such_after_a_while() -> None:
    page = PageNetwork()
    pinged(page, [0.04])
    assert pinged(page, 40 * [0.25], 1.0) == LEAST_SHARE
    assert pinged(page, 4 * 600 * [0.25], 20.0) == 1.0


def test_little_is_under_way_to_a_page_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(network, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    page = PageNetwork()
    page.costs.append(cost := NetworkCost())
    cost.add(10_000, UNDER_WAY_S)
    assert page.has_room(10 * UNDER_WAY_S), "one picture goes, however large"
    large = page.send(6000)
    assert page.has_room(0.4 * UNDER_WAY_S)
    assert not page.has_room(0.5 * UNDER_WAY_S)
    small = page.send(4000)
    page.came(large)
    assert page.has_room(0.6 * UNDER_WAY_S)
    assert not page.has_room(0.7 * UNDER_WAY_S)
    clock.now_s += STUCK_S + 0.1
    assert page.has_room(UNDER_WAY_S), "a page that draws nothing does not stop all"
    page.came(small)
    assert page.has_room(10 * UNDER_WAY_S)


@pytest.mark.parametrize(
    ("session", "asked", "is_own"),
    [
        ("anna's", b"page=anna", True),
        ("ben's", b"page=anna", False),
        ("anna's", b"page=x", False),
        ("anna's", b"", False),
    ],
)
def test_connections_of_one_page_share_its_network(session: str, asked: bytes, is_own: bool) -> None:
    async def run() -> None:
        live = LiveParts()
        page = SimpleNamespace(session="anna's", network=PageNetwork())

        async def refuse(*_: Any) -> None:
            raise AssertionError

        app = with_live(refuse, live, dict, VideoStreams(Mock()), {"anna": page})
        told: asyncio.Queue[Any] = asyncio.Queue()
        sent: asyncio.Queue[Any] = asyncio.Queue()
        told.put_nowait({"type": "websocket.connect"})
        scope = {"type": "websocket", "path": "/live/map", "query_string": asked, SESSION: session}
        serving = asyncio.ensure_future(app(scope, told.get, sent.put))
        await sent.get()
        live.put("map", {"place": b"here"})
        assert (await sent.get())["type"] == "websocket.send"
        assert page.network.has_room(2 * UNDER_WAY_S) is not is_own
        told.put_nowait({"type": "websocket.disconnect", "code": 1001})
        await serving
        assert page.network.has_room(2 * UNDER_WAY_S), "what was under way is lost"
        assert page.network.costs == []

    asyncio.run(run())


@pytest.mark.parametrize(("share", "updates"), [(1.0, 20), (0.5, 10), (LEAST_SHARE, 5)])
def test_page_is_updated_more_rarely_while_its_network_is_late(
    monkeypatch: pytest.MonkeyPatch, share: float, updates: int
) -> None:
    monkeypatch.setattr(pages, "ui", ui := Mock())
    page = Page("anna", "anna's", Mock(), Mock(), Mock(is_free=True))
    page.network.share = share
    page.always(0.1, update := Mock())
    ((_, tick), _) = ui.timer.call_args
    for _ in range(20):
        tick()
    assert update.call_count == updates


def test_picture_right_after_another_tells_what_a_byte_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(network, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    page, s_per_byte, at_once = PageNetwork(), 8 / 0.3e6, 3000
    page.costs.append(cost := NetworkCost())
    free_s = 0.0
    for begin_s in (1.0, 2.0, 3.0):
        sent = []
        for late_s in (0.0, 0.01):  # the second one while the first one is in the network
            clock.now_s = begin_s + late_s
            free_s = max(free_s, clock.now_s - at_once * s_per_byte) + 4000 * s_per_byte
            sent.append((page.send(4000), max(0.0, free_s - clock.now_s)))
        for one, way_s in sent:
            page.came(one, way_s)
            cost.add(one.size, way_s)
    assert cost.of(1.0) == pytest.approx(s_per_byte)
