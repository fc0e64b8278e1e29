"""Pictures and packets share the network of their page: commands and answers do not wait behind them."""

import asyncio
import json
import time
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from robbie_mp.messages import Image
from robbie_mp.station.live import network
from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.network import GAPS_S, LEAST_SHARE, OLD_S, UNDER_WAY_S, NetworkCost, PageNetwork
from robbie_mp.station.live.parts import Follower, LiveParts
from robbie_mp.station.live.server import MAX_GROUPS, Follows, with_live
from robbie_mp.station.live.video import VideoFollower
from robbie_mp.station.page import page as pages
from robbie_mp.station.page.page import Page
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.pictures import NewestPicture
from robbie_mp.station.web.gate import SESSION
from tests.station.test_driver import Scene

BIT_PER_BYTE = 8.0
LARGE, SMALL = 10_000, 1000
"""Sizes of something that needs as long as all that may be under way, and of something that needs a tenth."""


def network_of_known_cost() -> tuple[PageNetwork, NetworkCost]:
    page, cost = PageNetwork(), NetworkCost()
    page.costs.add(cost)
    cost.add(LARGE, UNDER_WAY_S)
    return page, cost  # which would be gone if nobody had it


async def is_turn(page: PageNetwork, size: int) -> bool:
    """Return whether something may be sent at once, and do not send it."""
    asked = asyncio.ensure_future(page.turn(size))
    await asyncio.sleep(0.01)
    if asked.done():
        page.came(asked.result())
    asked.cancel()
    return asked.done()


def pinged(page: PageNetwork, trips_s: list[float], begin_s: float = 0.0) -> float:
    for number, trip_s in enumerate(trips_s):
        page.ping_came(trip_s, begin_s + 0.25 * number)
    return page.share


def test_what_can_wait_is_sent_more_rarely_while_pings_are_late() -> None:
    page = PageNetwork()
    assert pinged(page, 40 * [0.3]) == 1.0, "of a long way"
    assert pinged(page, 2 * [0.45], 10.0) < 0.7
    assert pinged(page, 40 * [0.45], 20.0) == LEAST_SHARE
    assert pinged(page, 120 * [0.32], 30.0) == 1.0


def test_ping_that_had_to_wait_once_in_a_while_is_no_slow_network(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(monkeypatch)
    scene.page.network = page = PageNetwork()
    for number in range(100):
        scene.now_s += 0.2
        scene.delay_s = 0.1 if number % 10 == 9 else 0.02
        scene.ping()
    assert page.share == 1.0
    scene.delay_s = 0.1
    for _ in range(20):
        scene.now_s += 0.2
        scene.ping()
    assert page.share < 0.5
    before = page.share
    scene.pong(SimpleNamespace(args={"number": 0, "page_s": 0.0}))  # which nobody asked for
    assert page.share == before


def test_way_that_has_become_longer_counts_as_such_after_a_while() -> None:
    page = PageNetwork()
    pinged(page, [0.04])
    assert pinged(page, 40 * [0.25], 1.0) == LEAST_SHARE
    assert pinged(page, 4 * 600 * [0.25], 20.0) == 1.0


def test_little_is_under_way_to_a_page_at_once() -> None:
    async def run() -> None:
        page, _known = network_of_known_cost()
        assert await is_turn(page, 10 * LARGE), "one picture goes, however large"
        first = page.went(await page.turn(6 * SMALL), 6 * SMALL)
        assert await is_turn(page, 4 * SMALL)
        assert not await is_turn(page, 5 * SMALL)
        second = await page.turn(SMALL)
        page.went(second, 4 * SMALL)
        assert not await is_turn(page, SMALL), "the second one has become larger"
        page.came(first)
        assert await is_turn(page, 6 * SMALL)
        page.came(second)
        assert await is_turn(page, 10 * LARGE)

    asyncio.run(run())


def test_part_of_a_page_that_is_stuck_stops_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "STUCK_S", 0.3)

    async def run() -> float:
        page, _known = network_of_known_cost()
        await page.turn(LARGE)  # which never comes
        begin_s = time.monotonic()
        for _ in range(10):
            page.came(await page.turn(LARGE))
        return time.monotonic() - begin_s

    assert asyncio.run(run()) < 3 * 0.3


def test_what_a_part_of_the_page_learned_long_ago_makes_no_other_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = SimpleNamespace(now_s=10.0)
    monkeypatch.setattr(network, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    page, known = network_of_known_cost()
    page.costs.add(jammed := NetworkCost())
    jammed.add(LARGE, 2.0)
    assert page.cost_s(LARGE) == pytest.approx(2.0)
    clock.now_s += OLD_S + 0.1
    known.add(LARGE, UNDER_WAY_S)
    assert page.cost_s(LARGE) == pytest.approx(UNDER_WAY_S)


def test_network_of_which_nothing_is_known_is_a_slow_one() -> None:
    assert PageNetwork().cost_s(125_000) == pytest.approx(1.0), "1 Mbit/s"


def test_what_took_long_to_encode_is_under_way_when_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    async def run() -> None:
        page, _known = network_of_known_cost()
        encoded = await page.turn(LARGE)
        monkeypatch.setattr(network, "STUCK_S", 0.0)
        page.came(await page.turn(LARGE))
        monkeypatch.undo()
        page.went(encoded, LARGE)
        assert not await is_turn(page, SMALL)

    asyncio.run(run())


def test_turns_are_given_in_the_order_in_which_they_were_asked_for() -> None:
    async def run() -> None:
        page, _known = network_of_known_cost()
        sent = await page.turn(LARGE)
        order: list[str] = []

        async def ask(name: str, size: int) -> None:
            for _ in range(3):
                one = await page.turn(size)
                order.append(name)
                await asyncio.sleep(0)
                page.came(one)

        asking = [asyncio.ensure_future(ask(*one)) for one in (("picture", LARGE), ("map", SMALL))]
        await asyncio.sleep(0)
        page.came(sent)
        await asyncio.gather(*asking)
        assert order == 3 * ["picture", "map"]

    asyncio.run(run())


class FarPage:
    """A page far away, which shows a camera and a map that always change."""

    def __init__(self, mbit_per_s: float, trip_s: float):
        self._byte_per_s, self._trip_s = mbit_per_s * 1e6 / BIT_PER_BYTE, trip_s
        self._free_s = 0.0
        self.sent_s: dict[str, list[float]] = {"pictures": [], "map": []}
        self.sizes: list[int] = []

    async def show(self, name: str, follower: Follows) -> None:
        """Show what a follower sends."""
        loop = asyncio.get_running_loop()
        while (packet := await follower.next()) is not None:
            now_s = loop.time()
            self.sent_s[name].append(now_s)
            self.sizes.append(len(packet))
            self._free_s = max(self._free_s, now_s) + len(packet) / self._byte_per_s
            way_s = self._free_s - now_s
            loop.call_later(way_s + self._trip_s, follower.hear, json.dumps({"way_s": way_s}))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mbit_per_s", "trip_s", "map_bytes", "least_hz"),
    [(0.3, 0.15, 300, 0.0), (1.0, 0.1, 12_000, 0.0), (20.0, 0.15, 12_000, 7.0)],
)
def test_pictures_and_map_do_not_starve_each_other(
    mbit_per_s: float, trip_s: float, map_bytes: int, least_hz: float
) -> None:
    async def run() -> None:
        page, shared, live, latest = FarPage(mbit_per_s, trip_s), PageNetwork(), LiveParts(), Latest[Any]()
        camera = NewestPicture(latest)
        video = VideoFollower(lambda: {"eye": camera}, VideoStreams(Mock()), shared)
        video.hear('{"want": {"eye": 640}}')
        parts = Follower(live, frozenset({"map"}), shared)
        showing = [asyncio.ensure_future(page.show("pictures", video))]
        showing.append(asyncio.ensure_future(page.show("map", parts)))
        noise = np.random.default_rng(1).integers(0, 256, (480, 640), np.uint8)
        for number in range(80):
            latest.put(Image(height=480, width=640, encoding="mono8", step=640, data=noise.ravel()))
            live.put("map", {"tile/0/0": bytes([number]) * map_bytes})
            await asyncio.sleep(0.1)
        video.go()
        parts.go()
        await asyncio.gather(*showing)
        end_s = asyncio.get_running_loop().time()
        for name, sent_s in page.sent_s.items():
            gaps_s = np.diff([at_s for at_s in sent_s if at_s > end_s - 6.0], append=end_s)
            assert max(gaps_s) < 2.0, f"{name}: {gaps_s}"
        assert sum(at_s > end_s - 6.0 for at_s in page.sent_s["pictures"]) >= 6.0 * least_hz

    asyncio.run(run())


@pytest.mark.slow
def test_page_that_answers_late_gets_pictures_for_three_under_way_and_no_smaller_ones() -> None:
    """At most three are; a browser that takes a second to draw is no slow network."""

    async def run() -> None:
        page, latest = FarPage(5.0, 1.0), Latest[Any]()
        camera = NewestPicture(latest)
        video = VideoFollower(lambda: {"eye": camera}, VideoStreams(Mock()), PageNetwork())
        video.hear('{"want": {"eye": 640}}')
        showing = asyncio.ensure_future(page.show("pictures", video))
        noise = np.random.default_rng(1).integers(0, 256, (480, 640), np.uint8)
        for _ in range(80):
            latest.put(Image(height=480, width=640, encoding="mono8", step=640, data=noise.ravel()))
            await asyncio.sleep(0.1)
        video.go()
        await showing
        assert page.sizes[-1] > 10_000

    asyncio.run(run())


def connection(
    path: str, live: LiveParts, pages: dict[str, Any], session: str = "anna's", asked: bytes = b"page=anna"
) -> tuple[Any, Any, Any]:
    """Open a connection; return what the page tells, what it gets, and the task that serves it."""
    told: asyncio.Queue[Any] = asyncio.Queue()
    got: asyncio.Queue[Any] = asyncio.Queue()

    async def refuse(*_: Any) -> None:
        got.put_nowait({"type": "refused"})

    told.put_nowait({"type": "websocket.connect"})
    app = with_live(refuse, live, dict, VideoStreams(Mock()), pages)
    scope = {"type": "websocket", "path": path, "query_string": asked, SESSION: session}
    return told, got, asyncio.ensure_future(app(scope, told.get, got.put))


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
        told, got, serving = connection("/live/map", live, {"anna": page}, session, asked)
        await got.get()
        live.put("map", {"place": b"here"})
        assert (await got.get())["type"] == "websocket.send"
        page.network.costs.add(slow := NetworkCost())
        slow.add(SMALL, 10.0)
        assert await is_turn(page.network, SMALL) is not is_own
        told.put_nowait({"type": "websocket.disconnect", "code": 1001})
        await serving
        assert await is_turn(page.network, SMALL), "what was under way is lost"
        assert [*page.network.costs] == [slow]

    asyncio.run(run())


@pytest.mark.parametrize("groups", ["map", "video"])
def test_connection_that_waits_for_its_turn_ends_when_it_is_closed(groups: str) -> None:
    async def run() -> None:
        live, page = LiveParts(), SimpleNamespace(session="anna's", network=PageNetwork())
        page.network.costs.add(slow := NetworkCost())
        slow.add(SMALL, 10.0)
        live.put("map", {"place": b"here"})
        stuck = await page.network.turn(SMALL)
        told, got, serving = connection(f"/live/{groups}", live, {"anna": page})
        await got.get()
        await asyncio.sleep(0.01)
        told.put_nowait({"type": "websocket.disconnect", "code": 1001})
        await asyncio.wait_for(serving, 0.5 * network.STUCK_S)
        page.network.came(stuck)
        assert await is_turn(page.network, SMALL), "it has left its place in the queue"

    asyncio.run(run())


def test_connection_follows_a_bounded_number_of_groups() -> None:
    async def run() -> None:
        for number, answer in ((MAX_GROUPS, "websocket.accept"), (MAX_GROUPS + 1, "refused")):
            path = "/live/" + "+".join(map(str, range(number)))
            told, got, serving = connection(path, LiveParts(), {})
            assert (await got.get())["type"] == answer
            told.put_nowait({"type": "websocket.disconnect", "code": 1001})
            await serving

    asyncio.run(run())


@pytest.mark.parametrize(("share", "updates"), [(1.0, 20), (0.8, 16), (0.5, 10), (LEAST_SHARE, 5)])
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

    async def run() -> None:
        page, s_per_byte, at_once = PageNetwork(), BIT_PER_BYTE / 1e6, 3000
        page.costs.add(cost := NetworkCost())
        free_s = 0.0
        for begin_s in (1.0, 2.0, 3.0):
            sent = []
            for late_s in (0.0, 0.001):  # the second one while the first one is in the network
                clock.now_s = begin_s + late_s
                free_s = max(free_s, clock.now_s - at_once * s_per_byte) + 4000 * s_per_byte
                sent.append((page.went(await page.turn(0), 4000), max(0.0, free_s - clock.now_s)))
            for one, way_s in sent:
                page.came(one, way_s)
                cost.add(one.size, way_s)
        assert cost.of(1.0) == pytest.approx(s_per_byte)
        clock.now_s += 2 * GAPS_S
        page.came(page.went(await page.turn(0), 4000), 0.0)
        assert cost.least_s_per_byte == 0.0, "the network may have changed meanwhile"

    asyncio.run(run())
