"""The picture to drive by is a stream, in which each picture builds on the one that the page has."""

import asyncio
import io
import json
import logging
import struct
import sys
from collections.abc import Coroutine, Mapping
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as PillowImage

from robbie_mp.attached.views.image_pixels import NoPicture
from robbie_mp.base.extras import how_to_install
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.station.live.h264 import (
    KEY_PERIOD,
    MAX_STREAMS,
    VIDEO_GRADES,
    VideoFailed,
    VideoStream,
    VideoStreams,
)
from robbie_mp.station.live.network import NetworkCost, PageNetwork
from robbie_mp.station.live.video import COST_LIMIT_S, SHORTEST_WAY_S, VideoFollower, WantedVideo
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.pictures import NewestPicture

LOG = logging.getLogger("video")
GRADE = VIDEO_GRADES[4]
RED, GREEN = (200, 30, 60), (20, 180, 90)


def halves(width: int = 320, height: int = 240, left: tuple[int, ...] = RED) -> NDArray[np.uint8]:
    pixels = np.full((height, width, 3), GREEN, np.uint8)
    pixels[:, : width // 2] = left
    return pixels


def image_of(pixels: NDArray[np.uint8], encoding: str = "rgb8") -> Image:
    height, width = pixels.shape[:2]
    step = pixels.nbytes // height
    return Image(height=height, width=width, encoding=encoding, step=step, data=pixels.ravel())


class StreamDecoder:
    """Decodes what a stream sends, as a browser does."""

    def __init__(self) -> None:
        self._decoder = av.CodecContext.create("h264", "r")

    def decode(self, data: bytes) -> NDArray[np.uint8]:
        packet = av.Packet(data)
        (frame,) = self._decoder.decode(packet)
        return np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)


def video_of(found: tuple[bytes, Mapping[str, object]]) -> dict[str, Any]:
    video = found[1]["video"]
    assert isinstance(video, dict)
    return video


def test_page_gets_each_picture_at_once_and_in_its_colours() -> None:
    stream, page = VideoStream("eye", 7), StreamDecoder()
    for number, left in enumerate([RED, GREEN, RED]):
        data, about = stream.encode(image_of(halves(left=left)), GRADE)
        assert about == {"video": {"decoder": 7, "number": number, "is_key": number == 0}}
        shown = page.decode(data)
        assert np.abs(shown[120, 40].astype(int) - left).max() < 12
        assert np.abs(shown[120, 280].astype(int) - GREEN).max() < 12


def test_picture_stands_alone_at_least_every_few_seconds() -> None:
    stream, image = VideoStream("eye", 1), image_of(halves(64, 48))
    keys = [video_of(stream.encode(image, GRADE))["is_key"] for _ in range(2 * KEY_PERIOD + 1)]
    assert [number for number, is_key in enumerate(keys) if is_key] == [0, KEY_PERIOD, 2 * KEY_PERIOD]


def test_camera_that_changes_its_size_restarts_the_encoder() -> None:
    stream, page = VideoStream("eye", 1), StreamDecoder()
    sizes = [(320, 240), (320, 240), (641, 479), (641, 479), (2, 2), (320, 240)]
    found = [stream.encode(image_of(halves(*size)), GRADE) for size in sizes]
    assert [video_of(one)["is_key"] for one in found] == [True, False, True, False, True, True]
    shown = [page.decode(data).shape[1::-1] for data, _ in found]
    assert shown == [(320, 240), (320, 240), (640, 478), (640, 478), (2, 2), (320, 240)]


def test_coarser_grade_is_smaller_and_begins_with_a_picture_that_stands_alone() -> None:
    chance = np.random.default_rng(1)
    stream, sizes = VideoStream("eye", 1), {}
    for grade in (VIDEO_GRADES[2], VIDEO_GRADES[-1]):
        noise = [image_of(chance.integers(0, 256, (480, 640, 3), np.uint8)) for _ in range(20)]
        found = [stream.encode(image, grade) for image in noise]
        assert [video_of(one)["is_key"] for one in found] == [True] + 19 * [False]
        sizes[grade] = sum(len(data) for data, _ in found) / len(found)
    for grade, size in sizes.items():
        assert size < 1300 * grade.typical, sizes


def test_grey_and_compressed_images_are_streams_too() -> None:
    page, stream = StreamDecoder(), VideoStream("eye", 1)
    grey = image_of(halves()[:, :, 0].copy(), "mono8")
    assert abs(int(page.decode(stream.encode(grey, GRADE)[0])[120, 40, 0]) - RED[0]) < 12
    file = io.BytesIO()
    PillowImage.fromarray(halves()).save(file, "JPEG")
    jpeg = CompressedImage(format="jpeg", data=np.frombuffer(file.getvalue(), np.uint8))
    assert page.decode(stream.encode(jpeg, GRADE)[0]).shape == (240, 320, 3)
    with pytest.raises(NoPicture):
        stream.encode(CompressedImage(format="jpeg", data=np.zeros(9, np.uint8)), GRADE)


def test_streams_are_bounded() -> None:
    streams = VideoStreams(LOG)
    opened = [streams.open("eye", number) for number in range(MAX_STREAMS + 1)]
    assert opened[-1] is None
    first = opened[0]
    assert first is not None
    streams.close(first)
    assert streams.open("eye", 9) is not None


def test_missing_library_is_said_once_and_the_page_gets_jpeg(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    caplog.set_level(logging.INFO)

    async def steps() -> None:
        eye, streams = StreamedCamera(), VideoStreams(LOG)
        for _ in range(2):
            follower = eye.follower(streams)
            follower.hear('{"want": {"eye": 640}, "decodes": ["eye", 1]}')
            eye.take()
            assert (await eye.next_of(follower))["type"] == "image/jpeg"
            follower.go()

    run(steps())
    assert [record.levelname for record in caplog.records] == ["INFO"]
    assert how_to_install("video") in caplog.text


class StreamedCamera:
    """A camera."""

    def __init__(self) -> None:
        self.latest: Latest[Image | CompressedImage] = Latest()
        self.picture = NewestPicture(self.latest)

    def take(self, image: Image | None = None) -> None:
        self.latest.put(image or image_of(halves()))

    def follower(self, streams: VideoStreams) -> VideoFollower:
        return VideoFollower(lambda: {"eye": self.picture, "rear": self.picture}, streams, PageNetwork())

    async def next_of(self, follower: VideoFollower) -> dict[str, Any]:
        packet = await follower.next()
        assert packet is not None
        follower.hear('{"way_s": 0.001}')
        at = 4 + struct.unpack_from("<I", packet)[0]
        found: dict[str, Any] = json.loads(packet[at : at + json.loads(packet[4:at])[0][1]])
        return found


def run(steps: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(steps, 60.0))


def test_new_decoder_begins_with_a_picture_that_stands_alone_and_a_failed_one_gets_jpeg() -> None:
    async def steps() -> None:
        eye, streams = StreamedCamera(), VideoStreams(LOG)
        follower = eye.follower(streams)

        async def next_after(text: str = "") -> dict[str, Any]:
            follower.hear(text)
            eye.take()
            return await eye.next_of(follower)

        assert "type" in await next_after('{"want": {"eye": 640}}')
        wants_first = '{"want": {"eye": 640}, "decodes": ["eye", 1]}'
        assert (await next_after(wants_first))["video"] == {"decoder": 1, "number": 0, "is_key": True}
        assert (await next_after(wants_first))["video"] == {"decoder": 1, "number": 1, "is_key": False}
        again = await next_after('{"want": {"eye": 640}, "decodes": ["eye", 2]}')
        assert again["video"] == {"decoder": 2, "number": 0, "is_key": True}
        failed = await next_after('{"want": {"eye": 640}, "failed": "it stopped"}')
        assert failed["type"] == "image/jpeg"
        assert streams.failures == 1
        follower.go()

    run(steps())


def test_pictures_that_the_network_has_no_room_for_are_not_encoded() -> None:
    async def steps() -> None:
        eye = StreamedCamera()
        follower = eye.follower(VideoStreams(LOG))
        follower.hear('{"want": {"eye": 640}, "decodes": ["eye", 1]}')
        numbers = []
        for _ in range(4):
            for _ in range(5):
                eye.take()
            numbers.append((await eye.next_of(follower))["video"]["number"])
        assert numbers == [0, 1, 2, 3]
        follower.go()

    run(steps())


def test_other_cameras_and_depths_stay_jpeg() -> None:
    async def steps() -> None:
        eye = StreamedCamera()
        follower = eye.follower(VideoStreams(LOG))
        follower.hear('{"want": {"eye": 640, "rear": 200}, "decodes": ["eye", 1]}')
        eye.take()
        found = [await eye.next_of(follower) for _ in range(2)]
        assert {one["camera"]: "video" in one for one in found} == {"eye": True, "rear": False}
        depths = np.ones((48, 64), np.uint16).view(np.uint8)
        eye.take(Image(height=48, width=64, encoding="16UC1", step=128, data=depths.ravel()))
        found = [await eye.next_of(follower) for _ in range(2)]
        assert [one["type"] for one in found] == ["image/jpeg", "image/jpeg"]
        follower.go()

    run(steps())


@pytest.mark.parametrize("wanted", ['"eye"', '["eye"]', '["nose", 1]', '["eye", "1"]', "[[], {}]", "7"])
def test_ill_formed_wish_for_a_stream_gets_jpeg(wanted: str) -> None:
    async def steps() -> None:
        eye = StreamedCamera()
        follower = eye.follower(VideoStreams(LOG))
        follower.hear(f'{{"want": {{"eye": 640}}, "decodes": {wanted}, "failed": [1]}}')
        eye.take()
        assert (await eye.next_of(follower))["type"] == "image/jpeg"
        follower.go()

    run(steps())


def test_encoder_that_fails_ends_the_streams(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_name: str, _mode: str) -> None:
        raise av.error.EncoderNotFoundError(1, "no libx264")

    monkeypatch.setattr(av.CodecContext, "create", fail)
    with pytest.raises(VideoFailed, match="no libx264"):
        VideoStream("eye", 1).encode(image_of(halves()), GRADE)


def failing(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_args: object, **_more: object) -> None:
        raise av.error.MemoryError(12, "no memory")

    monkeypatch.setattr(av.VideoFrame, "from_ndarray", fail)


def test_picture_that_cannot_be_encoded_is_counted_told_and_ends_no_other_stream(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def steps() -> None:
        eye, streams = StreamedCamera(), VideoStreams(LOG)
        follower, other = eye.follower(streams), eye.follower(streams)

        async def next_of(one: VideoFollower, decoder: int, width: int = 640) -> dict[str, Any]:
            one.hear(f'{{"want": {{"eye": {width}}}, "decodes": ["eye", {decoder}]}}')
            eye.take()
            return await eye.next_of(one)

        assert (await next_of(follower, 1))["video"]["number"] == 0
        with monkeypatch.context() as broken:
            failing(broken)
            failed = await next_of(follower, 1)
        assert (failed["type"], streams.failures) == ("image/jpeg", 1)
        assert "no memory" in failed["note"]
        assert (await next_of(other, 1))["video"]["number"] == 0
        # The decoder expects picture 1, so the stream must not begin again for it.
        assert "no memory" in (await next_of(follower, 1, 500))["note"]
        assert (await next_of(follower, 2))["video"] == {"decoder": 2, "number": 0, "is_key": True}
        follower.go()
        other.go()

    run(steps())


def test_page_that_found_no_room_says_so_and_gets_its_stream_when_there_is_some() -> None:
    async def steps() -> None:
        eye, streams = StreamedCamera(), VideoStreams(LOG)
        lost = [
            streams.open("eye", 1) for _ in range(MAX_STREAMS)
        ]  # of connections that are not known as lost
        follower = eye.follower(streams)
        follower.hear('{"want": {"eye": 640}, "decodes": ["eye", 1]}')
        eye.take()
        assert f"{MAX_STREAMS} other pages" in (await eye.next_of(follower))["note"]
        assert lost[0] is not None
        streams.close(lost[0])
        eye.take()
        assert (await eye.next_of(follower))["video"] == {"decoder": 1, "number": 0, "is_key": True}
        follower.go()

    run(steps())


def test_picture_of_a_very_odd_shape_is_a_stream() -> None:
    pixels = np.zeros((1, 5_000_000, 3), np.uint8)
    assert video_of(VideoStream("eye", 1).encode(image_of(pixels), VIDEO_GRADES[0]))["is_key"]


def test_large_picture_is_reduced_without_a_change_of_place_or_colour() -> None:
    shown = StreamDecoder().decode(VideoStream("eye", 1).encode(image_of(halves(1999, 1500)), GRADE)[0])
    assert shown.shape == (480, 640, 3)
    assert np.abs(shown[240, 312].astype(int) - RED).max() < 12
    assert np.abs(shown[240, 328].astype(int) - GREEN).max() < 12


def test_small_pictures_that_a_slow_network_lets_pass_at_once_bring_no_jam() -> None:
    video, cost = WantedVideo("eye", 1280), NetworkCost(SHORTEST_WAY_S)
    video.use(VIDEO_GRADES)
    video.grade = len(VIDEO_GRADES) - 1
    for _ in range(20):
        cost.add(1700, 0.0)
    grade = VIDEO_GRADES[video.choose(cost, COST_LIMIT_S)]
    assert grade.typical < 5 * 1.7
