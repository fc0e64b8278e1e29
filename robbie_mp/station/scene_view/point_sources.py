"""What laser scanners and depth cameras see, in the frame of the map."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import LaserScan, PointCloud2
from robbie_mp.scene_graph import RigidTransform
from robbie_mp.station.scene_view.points import cloud_points, packed, scan_points

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.latest import Latest

MAX_POINTS = 10_000
"""In one picture, of all scans and clouds together."""
MAX_SOURCES = 4
"""Scanners, and as many sources of clouds."""
TYPES: tuple[type[LaserScan] | type[PointCloud2], ...] = (LaserScan, PointCloud2)
PoseAt = Callable[[str, int], RigidTransform | None]
"""The pose of a frame at a time (ns); None if it is not known."""


class Source:
    """The points of the newest message on one topic.

    Args:
        latest: has it.
    """

    def __init__(self, latest: Latest[Any]):
        self._latest = latest
        self._seen: tuple[int, str, int] | None = None
        self.packed = b""
        self.count = 0

    def look(self, pose_at: PoseAt, world: str, limit: int) -> None:
        """Prepare the points, at most so many, if there are others than before."""
        message: LaserScan | PointCloud2 | None = self._latest.message
        seen = (self._latest.count, world, limit)
        if message is None or seen == self._seen:
            return
        pose = pose_at(message.header.frame_id, message.header.stamp.nanoseconds)
        if pose is None:
            points: NDArray[np.float64] = np.zeros((0, 3))  # and look again
        else:
            self._seen = seen
            found = scan_points(message) if isinstance(message, LaserScan) else cloud_points(message, limit)
            points = pose.apply(found[:: -(-len(found) // limit) or 1])
        self.packed, self.count = packed(points), len(points)


class PointSources:
    """All scanners and sources of clouds, each on its own, so that none takes the place of another."""

    def __init__(self, station: StationContext):
        self._station = station
        self._sources: dict[tuple[str, str], Source] = {}

    def look(self, pose_at: PoseAt, world: str) -> dict[str, bytes]:
        """Return the packed points of each source, in the frame of the world."""
        self._find()
        for source in self._sources.values():
            source.look(pose_at, world, MAX_POINTS // len(self._sources))
        return {f"points/{number}": one.packed for number, one in enumerate(self._sources.values())}

    @property
    def count(self) -> int:
        """How many points that were."""
        return sum(source.count for source in self._sources.values())

    def _find(self) -> None:
        reading = self._station.run_watch.reading
        for channel in reading.channels if reading else ():
            for kind in TYPES:
                is_of_kind = (channel.type_name, channel.version) == (kind.type_name, kind.version)
                key = (channel.type_name, channel.topic)
                of_kind = [one for one in self._sources if one[0] == channel.type_name]
                if is_of_kind and key not in self._sources and len(of_kind) < MAX_SOURCES:
                    self._sources[key] = Source(self._station.newest(kind, channel.topic))
