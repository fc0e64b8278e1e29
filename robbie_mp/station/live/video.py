"""The pictures of cameras for one page, in the size, quality and rate that its network can carry.

The page names its visible cameras. For each picture that it has drawn, it says how much longer the picture
took to arrive than the fastest message so far (stop/emergency_stop.js). From this the station knows how many
seconds a byte costs. It sends the newest picture next, in a grade that the network carries in time.

A page that can decode H.264 names the camera to drive by, whose pictures then are a stream (h264.py). All
others, and those of a page whose decoder fails, are JPEG.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from robbie_mp.station.live.h264 import VIDEO_GRADES, VideoFailed, VideoGrade, VideoStream, VideoStreams
from robbie_mp.station.live.network import (
    ESTIMATES,
    UNDER_WAY_S,
    UNKNOWN_S_PER_BYTE,
    NetworkCost,
    PageNetwork,
    Transfer,
)
from robbie_mp.station.live.parts import DRAWING_LIMIT_S, packed
from robbie_mp.station.watch.pictures import Grade, GradedPicture, NewestPicture
from robbie_mp.station.web.page_json import from_page

VIDEO = "video"
"""The group of live parts that is the video."""
MIN_PERIOD_S = 0.08
"""Shortest time between two pictures of one camera: ten a second, even of an irregular camera."""
SMALL_PERIOD_S = 0.3
"""The same for all cameras but the largest."""
COST_LIMIT_S, SMALL_COST_S = 0.07, 0.03
"""Time that the network may need for a picture."""
RISE_SHARE = 0.7
"""A better grade must cost only this share of it, so that grades do not alternate."""
USED_SHARE = 0.75
"""Pictures use this share of the time at most, which leaves room for the rest of the page."""
SLOW_SHARE, SLOW_BYTES = 0.4, 5000
"""The same if a picture of this size costs more than `COST_LIMIT_S`: answers that wait behind it are late."""
TOO_LARGE = 1.5
"""A picture that costs this much more than the network may need is encoded again, more coarsely."""
FULL_SHARE = 0.5
"""A picture of a stream with this share of the size that its grade allows is as good as full."""
SHORTEST_WAY_S = 0.01
"""A shorter way says nothing about the network, which lets a few bytes pass at once."""
LONGEST_WAIT_S = 1.0
"""Longest time between two pictures, whatever they cost."""
MAX_AHEAD = 3
"""Maximum number of pictures in flight to a page, so that it does not wait for round trips."""
MAX_WANTED = 12
MAX_TEXT = 4096


GRADES: Sequence[Grade] = (
    Grade(1280, 80, 100.0),
    Grade(960, 70, 55.0),
    Grade(640, 70, 32.0),
    Grade(640, 45, 19.0),
    Grade(480, 45, 12.0),
    Grade(320, 60, 8.0),
    Grade(320, 40, 6.3),
    Grade(240, 45, 4.5),
    Grade(240, 25, 3.2),
)
"""From the best to the coarsest that one can drive by; on a slower network, pictures come less often."""
FIRST = 5
"""The grade until the network is known."""


@dataclass
class WantedVideo:
    """A camera that the page shows."""

    name: str
    pixels: int
    """Width at which it is shown."""
    sent: int = 0
    """Number of the last sent image."""
    sent_s: float = -math.inf
    grades: Sequence[Grade | VideoGrade] = GRADES
    grade: int = FIRST
    sizes: dict[int, int] = field(default_factory=dict)
    """The last size of each grade, bytes."""

    def use(self, grades: Sequence[Grade | VideoGrade]) -> None:
        """Choose among these grades from now on."""
        if self.grades is not grades:
            self.grades, self.grade, self.sizes = grades, FIRST, {}

    def size(self, grade: int) -> float:
        """Return the size (bytes) that a grade is expected to have."""
        if grade in self.sizes:
            return self.sizes[grade]
        typical = self.grades[grade].typical
        known = min(self.sizes, key=lambda one: abs(one - grade), default=None)
        return 1000.0 * typical if known is None else self.sizes[known] * typical / self.grades[known].typical

    def choose(self, cost: NetworkCost, limit_s: float) -> int:
        """Choose the best grade that the network carries in time, and no finer than the screen shows."""
        last = len(self.grades) - 1
        most = 2 * self.pixels
        fits = [index for index, one in enumerate(self.grades) if one.pixels <= most or index == last]
        for index in fits:
            cost_s = cost.of(self.size(index))
            if cost_s is None:
                return max(FIRST, fits[0])
            if cost_s <= (RISE_SHARE if index < self.grade else 1.0) * limit_s:
                return index
        return last


class VideoFollower:
    """Chooses the next pictures of one page; the interface is that of `parts.Follower`.

    Args:
        cameras: all cameras by name, as they are now.
        streams: makes streams for pages that can decode them.
        network: that of the page, which its pictures and packets share.
    """

    def __init__(
        self,
        cameras: Callable[[], Mapping[str, NewestPicture]],
        streams: VideoStreams,
        network: PageNetwork,
    ):
        self._cameras, self._streams, self._network = cameras, streams, network
        self._stream: VideoStream | None = None
        self._asked: object = None
        """The stream that the page wants: `[camera, number of its decoder]`, unless it is ill-formed."""
        self._why = ""
        """Why that stream has failed here."""
        self._wanted: dict[str, WantedVideo] = {}
        self._ends: list[Callable[[], None]] = []
        self._cost = NetworkCost(SHORTEST_WAY_S)
        network.costs.add(self._cost)
        self._answers_s: deque[float] = deque([0.0], maxlen=ESTIMATES)
        """How long the page took to answer the last pictures."""
        self._flying: deque[tuple[Transfer, bool]] = deque()
        """The pictures that the page has not yet drawn, and whether they are full."""
        self._free_s = -math.inf
        """From when on the network has room for the next picture."""
        self._drawn_s = time.monotonic()
        self._is_gone = False
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()

    def hear(self, text: str) -> None:
        """Handle what the page says: which cameras it shows, or that it has drawn a picture."""
        try:
            said = from_page(text) if len(text) <= MAX_TEXT else None
        except ValueError:
            return
        if isinstance(said, dict) and isinstance(said.get("want"), dict):
            self._want(said["want"])
            self._ask(said.get("decodes"))
            if isinstance(reason := said.get("failed"), str):
                self._streams.page_failed(reason)
        elif isinstance(said, dict) and self._flying:
            (sent, is_full), told = self._flying.popleft(), said.get("way_s")
            way_s = float(told) if isinstance(told, (int, float)) else None
            self._network.came(sent, way_s)
            self._answers_s.append(time.monotonic() - sent.sent_s)
            if way_s is not None:
                self._cost.add(sent.size, way_s, is_full=is_full)
            self._drawn_s = time.monotonic()
        self._changed.set()

    def _want(self, wanted: dict[str, object]) -> None:
        kept = {name: size for name, size in wanted.items() if isinstance(size, int) and 0 < size < 1 << 14}
        self._wanted = {
            name: self._wanted.get(name) or WantedVideo(name, size)
            for name, size in sorted(kept.items(), key=lambda one: -one[1])[:MAX_WANTED]
        }
        for name, one in self._wanted.items():
            one.pixels = kept[name]
        self._listen()

    def _ask(self, asked: object) -> None:
        if asked != self._asked:
            self._end_stream()
            self._asked, self._why = asked, ""

    def _stream_of(self, camera: str, source: NewestPicture) -> tuple[VideoStream | None, str]:
        """Return the stream to which the next picture belongs, and what the page should say if there is none.

        A stream that has failed does not begin again: the page's decoder has seen some of its pictures.
        """
        match self._asked:
            case [str(name), int(decoder)] if name == camera and source.can_be_video:
                if self._stream is None and not self._why:
                    self._stream = self._streams.open(camera, decoder)
                return self._stream, self._why or self._streams.why_not
        return None, ""

    def _end_stream(self) -> None:
        if self._stream is not None:
            self._streams.close(self._stream)
            self._stream = None

    def _listen(self) -> None:
        for end in self._ends:
            end()
        cameras = self._cameras()
        self._ends = [cameras[name].listen(self.wake) for name in self._wanted if name in cameras]

    def wake(self) -> None:
        """Look for a new picture. Any thread may call this."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._changed.set)

    def go(self) -> None:
        """Stop sending."""
        self._is_gone = True
        while self._flying:
            self._network.came(self._flying.popleft()[0])
        self._wanted = {}
        self._listen()
        self._end_stream()
        self._changed.set()

    async def next(self) -> bytes | None:
        """Wait for the next picture, and return a packet with it; None if there will be none."""
        while not self._is_gone:
            self._changed.clear()
            now_s = time.monotonic()
            if self._flying and now_s - self._drawn_s > DRAWING_LIMIT_S:
                break
            wait_s, chosen = self._next_due(now_s)
            if chosen is not None and wait_s <= 0.0:
                if (packet := await self._packet(chosen)) is not None:
                    return packet
                continue
            try:
                await asyncio.wait_for(self._changed.wait(), min(DRAWING_LIMIT_S, max(wait_s, 0.001)))
            except asyncio.TimeoutError:
                continue
        return None

    def _next_due(self, now_s: float) -> tuple[float, WantedVideo | None]:
        """Return the camera whose picture is next, and the time (s) until it may be sent."""
        if len(self._flying) >= MAX_AHEAD:
            return DRAWING_LIMIT_S, None
        cameras = self._cameras()
        waits = [
            (one.sent_s + (SMALL_PERIOD_S if index else MIN_PERIOD_S) - now_s, index, one)
            for index, one in enumerate(self._wanted.values())
            if one.name in cameras and cameras[one.name].count != one.sent
        ]
        if not waits:
            # A camera that is not known yet does not wake this.
            return (1.0 if self._wanted.keys() - cameras.keys() else DRAWING_LIMIT_S), None
        wait_s, _, chosen = min(waits, key=lambda one: one[:2])
        return max(wait_s, self._free_s - now_s), chosen

    async def _packet(self, wanted: WantedVideo) -> bytes | None:
        """Return a packet with the newest picture, when it may be sent; None if the page wants it no more."""
        sent = await self._network.turn(wanted.size(wanted.grade))
        source = self._cameras().get(wanted.name)
        if source is None or self._wanted.get(wanted.name) is not wanted:
            self._network.came(sent)
            return None
        stream, note = self._stream_of(wanted.name, source)
        is_large = next(iter(self._wanted.values())) is wanted
        wanted.use(GRADES if stream is None else VIDEO_GRADES)
        # From far away, answers come late, so several pictures are under way at once and share what may be.
        at_once = min(MAX_AHEAD, max(1.0, min(self._answers_s) / MIN_PERIOD_S))
        limit_s = min(COST_LIMIT_S if is_large else SMALL_COST_S, UNDER_WAY_S / at_once)
        wanted.grade = wanted.choose(self._cost, limit_s)
        wanted.sent = source.count
        picture = await self._encoded(wanted, source, stream, limit_s)
        wanted.sent_s = now_s = time.monotonic()
        size = len(picture.data)
        is_full = stream is None or size >= FULL_SHARE * wanted.size(wanted.grade)
        if stream is None:
            wanted.sizes[wanted.grade] = size
        cost_s = self._cost.of(size) or 0.0
        is_slow = (self._cost.of(SLOW_BYTES) or 0.0) > COST_LIMIT_S
        self._free_s = now_s + min(LONGEST_WAIT_S, cost_s / (SLOW_SHARE if is_slow else USED_SHARE))
        if not self._flying:
            self._drawn_s = now_s
        self._flying.append((self._network.went(sent, size), is_full))
        note = note if stream is None else self._why
        about = {"camera": wanted.name, "sent_s": now_s, "note": note, **picture.about}
        return packed({"about": json.dumps(about).encode(), "picture": picture.data})

    async def _encoded(
        self, wanted: WantedVideo, source: NewestPicture, stream: VideoStream | None, limit_s: float
    ) -> GradedPicture:
        if stream is not None:
            try:
                encode = partial(stream.encode, grade=VIDEO_GRADES[wanted.grade])
                return await asyncio.to_thread(source.encode, encode)
            except VideoFailed as error:
                self._streams.failed(error)
                if stream is self._stream:
                    self._end_stream()
                    self._why = f"JPEG: {error}"
                wanted.use(GRADES)
        while True:
            picture = await asyncio.to_thread(source.encoded, GRADES[wanted.grade])
            size = len(picture.data)
            cost_s = self._cost.of(size) or UNKNOWN_S_PER_BYTE * size
            if cost_s <= TOO_LARGE * limit_s or wanted.grade == len(GRADES) - 1:
                return picture
            wanted.sizes = {wanted.grade: size}  # those of other grades are of another scene
            wanted.grade = max(wanted.grade + 1, wanted.choose(self._cost, limit_s))
