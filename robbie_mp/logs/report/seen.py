"""What a run's messages tell the report: map, path, findings, battery, what happened. Reads each log once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from robbie_mp.attached.views.series import PlotSeries
from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.black_box.happenings import Happening, kind_of, text_of
from robbie_mp.logs.black_box.triggers import ChannelTriggers, triggers_of
from robbie_mp.logs.recording.decoding import LogDecoder, logged_type
from robbie_mp.logs.recording.format import RUN_METADATA
from robbie_mp.logs.recording.info import LogInfo, describe
from robbie_mp.logs.recording.reader import Log, LogChannel, LoggedMessage, channel_name, open_log
from robbie_mp.logs.recording.repair import Progress, unwatched
from robbie_mp.messages import (
    BatteryState,
    CompressedImage,
    Image,
    Mark,
    Message,
    OccupancyGrid,
    Odometry,
    PointsOfInterest,
    Pose,
    PoseStamped,
    SystemProfile,
)
from robbie_mp.messages.field_types import Nested
from robbie_mp.messages.message import fields_of

MAX_HAPPENINGS = 2000
MAX_FINDINGS = 200
MAX_CAMERAS = 8
STEP_M = 0.03
"""Shorter steps are noise of a pose that stands still, and no way."""
JUMP_M = 2.0
"""A longer step is a correction of the map, or a gap between two logs."""
MAX_PLACES = 4000
MAX_M = 1e7
"""A place that is farther away than half of the Earth's circumference is a mistake."""
MAX_IMAGE_BYTES = 256 << 20
"""Of the images of all findings, not encoded."""
NEAR_S = 5.0
"""The robot may have stood still since the last place that was noted."""
MAP_POSE, ODOMETRY = "map_pose", "odom"


@dataclass
class SeenOnTheWay:
    """Something that the robot has found, as its newest message says."""

    name: str
    time_s: float
    x_m: float
    y_m: float
    details: dict[str, str]
    image: Image | None


@dataclass
class Way:
    """Where the robot was."""

    times_s: list[float] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    breaks: set[int] = field(default_factory=set)
    """Numbers of the places to which no way leads from the one before."""
    travelled_m: float = 0.0
    _step_m: float = STEP_M

    def add(self, time_s: float, x_m: float, y_m: float, *, begins: bool) -> None:
        """Add a place, if it is far enough from the last one."""
        if not is_place(x_m, y_m):
            return
        step_m = math.dist(self.places[-1], (x_m, y_m)) if self.places else 0.0
        if self.places and step_m < self._step_m and not begins:
            return
        if self.places and (begins or step_m > max(JUMP_M, 3 * self._step_m)):
            self.breaks.add(len(self.places))
        else:
            self.travelled_m += step_m
        self.times_s.append(time_s)
        self.places.append((x_m, y_m))
        if len(self.places) > MAX_PLACES:
            self._thin_out()

    def _thin_out(self) -> None:
        kept = [at for at in range(len(self.places)) if at % 2 == 0 or at in self.breaks]
        self.breaks = {new for new, old in enumerate(kept) if old in self.breaks}
        self.places = [self.places[at] for at in kept]
        self.times_s = [self.times_s[at] for at in kept]
        self._step_m *= 2

    def at(self, time_s: float) -> tuple[float, float] | None:
        """Return where the robot was at a time; None if that is not known to within some seconds."""
        if not self.times_s:
            return None
        nearest = min(range(len(self.times_s)), key=lambda one: abs(self.times_s[one] - time_s))
        later = [one for one in self.times_s if one <= time_s]
        is_between = bool(later) and len(later) < len(self.times_s) and len(later) not in self.breaks
        is_known = is_between or abs(self.times_s[nearest] - time_s) < NEAR_S
        return self.places[nearest] if is_known else None


class Seen:
    """Takes the messages of logs, in their order.

    Attributes:
        grid: the newest map; None if there was none.
        way: where the robot was on it, or by its odometry.
        views: the newest image of each camera, by topic.
        skipped: messages that could not be read.
        images_left_out: images of findings for which there was no room.
    """

    def __init__(self) -> None:
        self.grid: OccupancyGrid | None = None
        self.way = Way()
        self.findings: dict[tuple[str, str], SeenOnTheWay] = {}
        self.places: dict[str, PointsOfInterest] = {}
        self.views: dict[str, tuple[float, Image | CompressedImage]] = {}
        self.battery = PlotSeries("charge")
        self.voltage = PlotSeries("voltage")
        self.processors = PlotSeries("processors")
        self.happened: list[Happening] = []
        self.more_happened = 0
        self.infos: list[LogInfo] = []
        self.notes: list[str] = []
        self.skipped = 0
        self.images_left_out = 0
        self.begin_s = self.end_s = 0.0
        self.host = ""
        self._views: dict[str, LoggedMessage] = {}
        self._begins = True
        self._image_bytes = 0

    def read(self, path: Path, progress: Progress = unwatched) -> bool:
        """Read a log; return whether that was possible. What cannot be read is noted."""
        try:
            with open_log(path) as log:
                self._read(log, progress)
                self.infos.append(describe(log))
        except (RobbieError, OSError) as error:
            self.notes.append(f"A recording cannot be read: {error}")
            return False
        return True

    def _read(self, log: Log, progress: Progress) -> None:
        decoder = LogDecoder()
        takers = self._takers(log, decoder)
        self._begins = True
        grid: LoggedMessage | None = None
        total, count = sum(log.counts.get(channel, 0) for channel in takers), 0
        for count, message in enumerate(log.messages(channels=takers), 1):
            if count % 256 == 0:
                progress(count, total)
            if message.channel.type_name == OccupancyGrid.type_name:
                grid = message  # only the newest is decoded
                continue
            try:
                takers[message.channel](message)
            except (RobbieError, ValueError, AttributeError, TypeError):
                self.skipped += 1  # it is damaged, or of a type that only looks like one of ours
        self._end_log(log, decoder, grid)

    def _end_log(self, log: Log, decoder: LogDecoder, grid: LoggedMessage | None) -> None:
        if grid is not None:
            self._try(partial(self._end_map, decoder, grid))
        for topic, message in self._views.items():
            self._try(partial(self._end_view, decoder, topic, message))
        self._views = {}
        begin_s, end_s = log.start_ns / 1e9, log.end_ns / 1e9
        self.begin_s = min(self.begin_s or begin_s, begin_s)
        self.end_s = max(self.end_s, end_s)
        for about in log.metadata(RUN_METADATA):
            self.host = about.get("host", "") or self.host

    def _end_view(self, decoder: LogDecoder, topic: str, message: LoggedMessage) -> None:
        image = decoder.decode(message)
        if not isinstance(image, Image | CompressedImage):
            raise TypeError("it only looks like an image")
        self.views[topic] = message.time_ns / 1e9, image

    def _end_map(self, decoder: LogDecoder, message: LoggedMessage) -> None:
        self.grid = _whole(decoder.decode(message))

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except (RobbieError, ValueError, AttributeError, TypeError):
            self.skipped += 1  # as above

    # -- one kind of messages each -----------------------------------------------------------------------

    def _takers(self, log: Log, decoder: LogDecoder) -> dict[LogChannel, Callable[[LoggedMessage], None]]:
        """Return what takes the messages of each channel that the report needs."""
        found: dict[LogChannel, Callable[[LoggedMessage], None]] = {}
        poses = _pose_channels(log.channels)
        for channel in log.channels:
            take = self._taker(channel, decoder, is_way=channel in poses)
            if take is not None:
                found[channel] = take
        return found

    def _taker(
        self, channel: LogChannel, decoder: LogDecoder, *, is_way: bool
    ) -> Callable[[LoggedMessage], None] | None:
        decode = decoder.decode
        name = channel.type_name
        if is_way:
            return lambda message: self._on_pose(message.time_ns / 1e9, decode(message))
        if name in (Image.type_name, CompressedImage.type_name):
            return self._on_view
        known: dict[str, Callable[[float, Any], None]] = {
            OccupancyGrid.type_name: lambda _time_s, _grid: None,
            BatteryState.type_name: self._on_battery,
            SystemProfile.type_name: self._on_processors,
            Mark.type_name: lambda time_s, mark: self._happened(time_s, f"mark: {mark.text}"),
            PointsOfInterest.type_name: lambda _time_s, points: self.places.__setitem__(
                channel_name(channel), points
            ),
        }
        if name in known:
            return lambda message: known[name](message.time_ns / 1e9, decode(message))
        if is_finding(channel):
            return lambda message: self._on_finding(channel, message.time_ns / 1e9, decode(message))
        return self._trigger_taker(channel)

    def _trigger_taker(self, channel: LogChannel) -> Callable[[LoggedMessage], None] | None:
        """Return what finds the moments that would have been triggers of the black box."""
        fields = {
            one: path for one in triggers_of(()) if (path := one.field_of(channel.type_name, channel.topic))
        }
        if not fields:
            return None
        try:
            written = logged_type(channel)
            holds = {one.text: one.comparison(written, path) for one, path in fields.items()}
        except (RobbieError, ValueError):
            return None
        watched = ChannelTriggers(written.decode, holds)

        def take(message: LoggedMessage) -> None:
            for fired in watched.fired(memoryview(message.data)):
                self._happened(message.time_ns / 1e9, fired)

        return take

    def _happened(self, time_s: float, trigger: str) -> None:
        if len(self.happened) >= MAX_HAPPENINGS:
            self.more_happened += 1
            return
        self.happened.append(Happening(time_s, kind_of(trigger), text_of(trigger), ""))

    def _on_pose(self, time_s: float, message: Any) -> None:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        self.way.add(time_s, pose.position.x, pose.position.y, begins=self._begins)
        self._begins = False

    def _on_view(self, message: LoggedMessage) -> None:
        name = channel_name(message.channel)
        if name in self._views or len(self._views) < MAX_CAMERAS:
            self._views[name] = message

    def _on_battery(self, time_s: float, battery: BatteryState) -> None:
        if 0.0 <= battery.percentage <= 1.0:
            self.battery.add(time_s, 100 * battery.percentage)
        self.voltage.add(time_s, battery.voltage)

    def _on_processors(self, time_s: float, profile: SystemProfile) -> None:
        if len(profile.cpu_percent):
            self.processors.add(time_s, float(profile.cpu_percent.mean()))

    def _kept_image(self, before: Image | None, new: Image) -> Image | None:
        """Return the new image of a finding; the one before if it has none, or if there is no room."""
        if not len(new.data):
            return before
        added = new.data.nbytes - (0 if before is None else before.data.nbytes)
        if self._image_bytes + added > MAX_IMAGE_BYTES:
            self.images_left_out += 1
            return before
        self._image_bytes += added
        return new

    def _on_finding(self, channel: LogChannel, time_s: float, message: Any) -> None:
        names = {one.name for one in fields_of(type(message))}
        name = str(message.name) if "name" in names else ""
        number = str(message.id) if "id" in names else ""
        key = channel.type_name, number or name
        if key not in self.findings and len(self.findings) >= MAX_FINDINGS:
            return
        position = message.pose.position
        if not is_place(position.x, position.y):
            raise ValueError(f"nothing can be found at {position.x}, {position.y} m")
        kind = channel.type_name.rpartition("/")[2].removesuffix("Found") or "found"
        first_s = self.findings[key].time_s if key in self.findings else time_s
        image = self._kept_image(self.findings[key].image if key in self.findings else None, message.image)
        self.findings[key] = SeenOnTheWay(
            f"{kind} {name or number}", first_s, position.x, position.y, _details(message), image
        )


def is_place(x_m: float, y_m: float) -> bool:
    """Whether a robot can be, or find something, there; that is false of what is no number."""
    return abs(x_m) <= MAX_M and abs(y_m) <= MAX_M


def is_finding(channel: LogChannel) -> bool:
    """Whether the messages of a channel say what was found: a name or number, a pose and a picture."""
    try:
        fields = {one.name: one.type for one in fields_of(logged_type(channel))}
    except (RobbieError, ValueError):
        return False

    def is_of(name: str, kind: type[Message]) -> bool:
        found = fields.get(name)
        return isinstance(found, Nested) and found.layout.type_name == kind.type_name

    return is_of("pose", Pose) and is_of("image", Image) and bool({"name", "id"} & fields.keys())


def _details(message: Any) -> dict[str, str]:
    """Return the numbers and texts of a finding; a state in words where its class names them."""
    found: dict[str, str] = {}
    for name in (one.name for one in fields_of(type(message))):
        value = getattr(message, name)
        if name in ("id", "name") or not isinstance(value, int | float | str):
            continue
        words = [key for key, constant in vars(type(message)).items() if key.isupper() and constant == value]
        found[name] = (
            words[0]
            if name == "state" and words
            else f"{value:.4g}"
            if isinstance(value, float)
            else str(value)
        )
    return found


def _pose_channels(channels: Iterable[LogChannel]) -> list[LogChannel]:
    """Return the channels of the robot's place: on the map, or if there is none by odometry."""
    listed = list(channels)
    on_map = [one for one in listed if one.type_name == PoseStamped.type_name and one.topic == MAP_POSE]
    if on_map:
        return on_map
    odometry = [one for one in listed if one.type_name == Odometry.type_name]
    return [one for one in odometry if one.topic in ("", ODOMETRY)] or odometry[:1]


def _whole(grid: Message) -> OccupancyGrid:
    """Return a map whose cells are all there.

    Raises:
        ValueError: they are not.
        TypeError: it is of another type of the same name.
    """
    if not isinstance(grid, OccupancyGrid):
        raise TypeError("it only looks like a map")
    if len(grid.data) != grid.info.width * grid.info.height:
        raise ValueError("a map has another number of cells than it says")
    return grid
