"""The points of all scanners and clouds that the robot has, for a picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robbie_mp.messages import LaserScan, PointCloud2
from robbie_mp.scene import RigidTransform
from robbie_mp.station.scene_view.points import NO_POINTS, cloud_points, packed, scan_points, shades

if TYPE_CHECKING:
    from robbie_mp.station.watch.latest import Latest, MessageSource
    from robbie_mp.station.watch.run import RunWatch

MAX_POINTS = 50_000
"""Maximum number of points in one picture, of all scans and clouds together."""
MAX_SOURCES = 4
"""Maximum number of scanners, and also of sources of clouds."""
Kinds = tuple[type[LaserScan] | type[PointCloud2], ...]
PoseAt = Callable[[str, int], RigidTransform | None]
"""Return the pose of a frame at a time (ns), or None if it is unknown."""


class PointSource:
    """The points of the newest message on one topic.

    Args:
        latest: holder of the newest message.
    """

    def __init__(self, latest: Latest[Any]):
        self._latest = latest
        self._seen: tuple[int, str, int] | None = None
        self.packed = b""
        self.shades = b""
        self.count = 0

    def look(self, pose_at: PoseAt, world: str, limit: int) -> None:
        """Pack the points of the newest message, thinned to a limit, if the message is new."""
        message: LaserScan | PointCloud2 | None = self._latest.message
        seen = (self._latest.count, world, limit)
        if message is None or seen == self._seen:
            return
        pose = pose_at(message.header.frame_id, message.header.stamp.nanoseconds)
        found = NO_POINTS
        if pose is not None:  # otherwise try again later
            self._seen = seen
            found = scan_points(message) if isinstance(message, LaserScan) else cloud_points(message, limit)
            found = found.every(-(-len(found.places) // limit) or 1)
            self.packed = packed(pose.apply(found.places))
        else:
            self.packed = b""
        self.shades, self.count = shades(found.intensities), len(found.places)


class PointSources:
    """All scanners and sources of clouds. Each is separate, so that none replaces another.

    Args:
        messages: source of the messages.
        figures: knows which topics there are.
        kinds: the types to look for.
    """

    def __init__(self, messages: MessageSource, figures: RunWatch, kinds: Kinds = (LaserScan, PointCloud2)):
        self._messages = messages
        self._figures = figures
        self._kinds = kinds
        self._sources: dict[tuple[str, str], PointSource] = {}

    def look(self, pose_at: PoseAt, world: str) -> dict[str, bytes]:
        """Return the packed points of each source, in the frame of the world, and their shades."""
        self._find()
        parts: dict[str, bytes] = {}
        for number, source in enumerate(self._sources.values()):
            source.look(pose_at, world, MAX_POINTS // len(self._sources))
            # The shades are first: a page that has them draws the points in their colours.
            parts |= {f"shades/{number}": source.shades, f"points/{number}": source.packed}
        return parts

    @property
    def count(self) -> int:
        """Number of these points."""
        return sum(source.count for source in self._sources.values())

    def _find(self) -> None:
        reading = self._figures.reading
        for channel in reading.channels if reading else ():
            for kind in self._kinds:
                is_of_kind = (channel.type_name, channel.version) == (kind.type_name, kind.version)
                key = (channel.type_name, channel.topic)
                of_kind = [one for one in self._sources if one[0] == channel.type_name]
                if is_of_kind and key not in self._sources and len(of_kind) < MAX_SOURCES:
                    self._sources[key] = PointSource(self._messages.newest(kind, channel.topic))
