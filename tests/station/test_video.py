"""Pictures are as good as the network lets them through, always the newest, and few are under way."""

import asyncio
import json
import logging
import struct
import time
from collections.abc import Coroutine
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_mp.messages import CompressedImage, Image
from robbie_mp.station.live.h264 import VideoStreams
from robbie_mp.station.live.network import UNKNOWN_S_PER_BYTE, NetworkCost, PageNetwork
from robbie_mp.station.live.video import (
    COST_LIMIT_S,
    GRADES,
    LONGEST_WAIT_S,
    MAX_AHEAD,
    MAX_WANTED,
    SLOW_BYTES,
    SLOW_SHARE,
    TOO_LARGE,
    VideoFollower,
    WantedVideo,
)
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.pictures import Grade, GradedPicture, NewestPicture

BIT_PER_BYTE = 8.0
AT_ONCE_BYTES = 3000
"""What a network lets pass at once."""
LOG = logging.getLogger("video")


class Camera:
    """A camera of noise, whose pictures are numbered by their height."""

    def __init__(self) -> None:
        self.latest: Latest[Image | CompressedImage] = Latest()
        self.picture = NewestPicture(self.latest)
        self.taken = 0

    def take(self) -> None:
        self.taken += 1
        pixels = np.random.default_rng(1).integers(0, 256, (self.taken, 64), np.uint8)
        self.latest.put(Image(height=self.taken, width=64, encoding="mono8", step=64, data=pixels.ravel()))


def about(packet: bytes | None) -> dict[str, Any]:
    assert packet is not None
    at = 4 + struct.unpack_from("<I", packet)[0]
    found: dict[str, Any] = json.loads(packet[at : at + json.loads(packet[4:at])[0][1]])
    return found


def follower_of(picture: NewestPicture, name: str = "eye") -> VideoFollower:
    return VideoFollower(lambda: {name: picture}, VideoStreams(LOG), PageNetwork())


def run(steps: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(steps, 60.0))


@pytest.mark.parametrize(("mbit_per_s", "pixels"), [(20.0, 1280), (5.0, 640), (1.0, 320), (0.3, 240)])
def test_grade_is_the_best_whose_pictures_come_in_time(mbit_per_s: float, pixels: int) -> None:
    video, cost = WantedVideo("camera", 1280), NetworkCost()
    for _ in range(50):
        video.grade = video.choose(cost, COST_LIMIT_S)
        size = round(1000 * GRADES[video.grade].typical)  # of a usual camera
        video.sizes[video.grade] = size
        cost.add(size, BIT_PER_BYTE * size / (mbit_per_s * 1e6))
    assert GRADES[video.grade].pixels == pixels
    assert cost.of(video.size(video.grade)) == pytest.approx(BIT_PER_BYTE * size / (mbit_per_s * 1e6))


def test_jam_lowers_the_grade_at_once() -> None:
    video, cost = WantedVideo("camera", 1280), NetworkCost()
    for _ in range(20):
        cost.add(40_000, 0.004)
    assert video.choose(cost, COST_LIMIT_S) == 0
    cost.add(40_000, 1.5)
    assert GRADES[video.choose(cost, COST_LIMIT_S)].pixels <= 320


def test_few_bytes_that_come_late_do_not_stop_the_video() -> None:
    async def steps() -> None:
        camera = Camera()
        follower = follower_of(camera.picture)
        follower.hear('{"want": {"eye": 640}}')
        for _ in range(3):
            camera.take()
            await follower.next()
            follower.hear('{"way_s": 30.0}')  # of a browser that hung
        follower.go()

    run(steps())


def test_picture_of_a_still_scene_does_not_make_the_network_look_faster() -> None:
    cost = NetworkCost()
    cost.add(8000, 0.08)
    for _ in range(20):
        cost.add(300, 0.001, is_full=False)
    assert cost.of(1000) == pytest.approx(0.01)
    cost.add(8000, 0.04)
    assert cost.of(1000) == pytest.approx(0.005)


def test_small_picture_is_no_finer_than_it_is_shown() -> None:
    cost = NetworkCost()
    cost.add(1000, 0.0)
    assert GRADES[WantedVideo("camera", 200).choose(cost, COST_LIMIT_S)].pixels <= 400


def test_newest_picture_is_sent_and_few_are_under_way() -> None:
    async def steps() -> None:
        camera = Camera()
        follower = follower_of(camera.picture)
        follower.hear('{"want": {"eye": 640}}')
        for _ in range(MAX_AHEAD):
            camera.take()
            assert about(await follower.next())["camera"] == "eye"
        waiting = asyncio.ensure_future(follower.next())
        for _ in range(5):
            camera.take()
        await asyncio.sleep(0.2)
        assert not waiting.done()
        follower.hear('{"way_s": 0.01}')
        await waiting
        assert camera.picture.encoded(GRADES[0]).about["born_s"] is None
        follower.go()
        assert await follower.next() is None

    run(steps())


def test_camera_without_a_picture_says_why() -> None:
    async def steps() -> None:
        latest: Latest[Image | CompressedImage] = Latest()
        follower = follower_of(NewestPicture(latest), "depth")
        follower.hear('{"want": {"depth": 640}}')
        latest.put(Image(height=1, width=1, encoding="bayer_rggb8", step=1, data=np.zeros(1, np.uint8)))
        assert "bayer_rggb8" in about(await follower.next())["reason"]
        follower.go()

    run(steps())


@pytest.mark.parametrize(
    "said",
    [
        "",
        "drawn",
        "[]",
        "{",
        '{"want": 3}',
        '{"want": {"eye": "x", "no": -1}}',
        '{"way_s": "NaN"}',
        '{"way_s": NaN}',
        '{"way_s": ' + 400 * "9" + "}",
        "[" * 5000,
    ],
)
def test_ill_formed_words_of_a_page_do_no_harm(said: str) -> None:
    async def steps() -> None:
        camera = Camera()
        follower = follower_of(camera.picture)
        follower.hear(said)
        many = {f"camera {number}": 100 for number in range(3 * MAX_WANTED)}
        follower.hear(json.dumps({"want": many}))
        follower.hear('{"want": {"eye": 640}}')
        camera.take()
        packet = about(await follower.next())
        assert packet["camera"] == "eye"
        follower.hear(said)
        follower.go()

    run(steps())


NOISE = np.random.default_rng(1).integers(0, 256, (480, 640), np.uint8)


def put(camera: Camera, pixels: NDArray[np.uint8]) -> None:
    camera.latest.put(Image(height=480, width=640, encoding="mono8", step=640, data=pixels.ravel()))


def test_first_picture_is_small_because_the_network_may_be_slow() -> None:
    async def steps() -> None:
        camera = Camera()
        follower = follower_of(camera.picture)
        follower.hear('{"want": {"eye": 640}}')
        put(camera, NOISE)
        packet = await follower.next()
        assert packet is not None
        assert len(packet) < 1.1 * TOO_LARGE * COST_LIMIT_S / UNKNOWN_S_PER_BYTE

    run(steps())


def test_picture_is_under_way_with_its_own_size_until_it_comes_or_the_page_goes() -> None:
    async def steps() -> None:
        camera, network = Camera(), PageNetwork()
        follower = VideoFollower(lambda: {"eye": camera.picture}, VideoStreams(LOG), network)
        follower.hear('{"want": {"eye": 640}}')
        put(camera, 0 * NOISE)  # far smaller than a usual picture
        packet = await follower.next()
        assert packet is not None
        (sent,) = network._under_way
        assert 0.5 * len(packet) < sent.size < len(packet)
        follower.go()
        assert network._under_way == []

    run(steps())


def test_pictures_leave_most_of_a_slow_network_to_others() -> None:
    async def steps() -> None:
        camera = Camera()
        follower = follower_of(camera.picture)
        follower._cost.add(SLOW_BYTES, 2 * COST_LIMIT_S)
        follower.hear('{"want": {"eye": 640}}')
        put(camera, NOISE)
        begin_s, packet = time.monotonic(), await follower.next()
        assert packet is not None
        follower.hear("{}")
        put(camera, NOISE)
        await follower.next()
        cost_s = follower._cost.of(0.9 * len(packet))  # the rest is its head
        assert cost_s is not None
        assert time.monotonic() - begin_s > min(LONGEST_WAIT_S, cost_s / SLOW_SHARE)

    run(steps())


def test_dark_scene_that_turns_bright_does_not_fill_a_slow_network(monkeypatch: pytest.MonkeyPatch) -> None:
    async def steps() -> None:
        camera, loop = Camera(), asyncio.get_running_loop()
        encode, encoded = camera.picture.encoded, []

        def count(grade: Grade) -> GradedPicture:
            encoded.append(grade)
            return encode(grade)

        monkeypatch.setattr(camera.picture, "encoded", count)
        follower = follower_of(camera.picture)
        follower.hear('{"want": {"eye": 640}}')
        byte_per_s, free_s, waits_s = 0.3e6 / BIT_PER_BYTE, 0.0, []

        async def show() -> None:
            nonlocal free_s
            while (packet := await follower.next()) is not None:
                now_s = time.monotonic()
                free_s = max(free_s, now_s) + len(packet) / byte_per_s
                waits_s.append(free_s - now_s)
                said = json.dumps({"way_s": max(0.0, waits_s[-1] - AT_ONCE_BYTES / byte_per_s)})
                loop.call_later(waits_s[-1], follower.hear, said)

        page = asyncio.ensure_future(show())
        for pixels in 15 * [0 * NOISE] + 10 * [NOISE]:
            put(camera, pixels)
            await asyncio.sleep(0.1)
        follower.go()
        await page
        assert len(waits_s) > 10
        assert max(waits_s) < 0.7, waits_s
        assert len(encoded) < len(waits_s) + 4, "only the first bright ones are encoded again"

    run(steps())
