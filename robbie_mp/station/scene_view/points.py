"""Transforms points of scans and clouds to the map frame, thins them, and packs them for the browser."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import LaserScan, PointCloud2, PointField
from robbie_mp.scene_graph import RigidTransform

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext
    from robbie_mp.station.latest import Latest


STEP_M = 0.01
"""Resolution of sent points. With 16 bits, they reach as far as 327 m."""
COORDINATES = ("x", "y", "z")
CODES = {PointField.FLOAT32: "f4", PointField.FLOAT64: "f8"}


def scan_points(scan: LaserScan) -> NDArray[np.float64]:
    """Return the ends of rays that hit something: (N, 3), m, the scanner's frame."""
    ranges = np.asarray(scan.ranges, np.float64)
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges < scan.range_max)
    angles = scan.angle_min + scan.angle_increment * np.flatnonzero(hit)
    x, y = ranges[hit] * np.cos(angles), ranges[hit] * np.sin(angles)
    return np.column_stack((x, y, np.zeros(len(x))))


def cloud_points(cloud: PointCloud2, limit: int) -> NDArray[np.float64]:
    """Return a cloud's points, thinned evenly: (N <= limit, 3), m, its frame; none if it is malformed."""
    nothing = np.zeros((0, 3))
    fields = {field.name: field for field in cloud.fields}
    used = [fields[name] for name in COORDINATES if name in fields]
    if len(used) < len(COORDINATES) or any(field.datatype not in CODES for field in used):
        return nothing
    sizes = [int(CODES[field.datatype][1]) for field in used]
    fits = all(field.offset + size <= cloud.point_step for field, size in zip(used, sizes, strict=True))
    is_whole = cloud.width * cloud.point_step <= cloud.row_step
    if not fits or not is_whole or len(cloud.data) != cloud.height * cloud.row_step or not len(cloud.data):
        return nothing
    rows = np.asarray(cloud.data).reshape(cloud.height, cloud.row_step)
    points = rows[:, : cloud.width * cloud.point_step].reshape(-1, cloud.point_step)
    chosen = np.ascontiguousarray(points[:: max(1, math.ceil(len(points) / limit))])
    order = ">" if cloud.is_bigendian else "<"
    found = [
        np.ascontiguousarray(chosen[:, field.offset : field.offset + size]).view(
            order + CODES[field.datatype]
        )[:, 0]
        for field, size in zip(used, sizes, strict=True)
    ]
    coordinates = np.column_stack(found).astype(np.float64)
    return coordinates[np.isfinite(coordinates).all(axis=1)]


def packed(points: NDArray[np.float64]) -> bytes:
    """Return points (N, 3), m, in the form that the page's script reads: steps of 16 bits each."""
    return np.clip(np.rint(points / STEP_M), -32768, 32767).astype("<i2").tobytes()


MAX_POINTS = 10_000
"""Maximum number of points in one picture, of all scans and clouds together."""
MAX_SOURCES = 4
"""Maximum number of scanners, and also of sources of clouds."""
TYPES: tuple[type[LaserScan] | type[PointCloud2], ...] = (LaserScan, PointCloud2)
PoseAt = Callable[[str, int], RigidTransform | None]
"""Return the pose of a frame at a time (ns), or None if it is unknown."""


class Source:
    """The points of the newest message on one topic.

    Args:
        latest: holder of the newest message.
    """

    def __init__(self, latest: Latest[Any]):
        self._latest = latest
        self._seen: tuple[int, str, int] | None = None
        self.packed = b""
        self.count = 0

    def look(self, pose_at: PoseAt, world: str, limit: int) -> None:
        """Pack the points of the newest message, thinned to a limit, if the message is new."""
        message: LaserScan | PointCloud2 | None = self._latest.message
        seen = (self._latest.count, world, limit)
        if message is None or seen == self._seen:
            return
        pose = pose_at(message.header.frame_id, message.header.stamp.nanoseconds)
        if pose is None:
            points: NDArray[np.float64] = np.zeros((0, 3))  # try again later
        else:
            self._seen = seen
            found = scan_points(message) if isinstance(message, LaserScan) else cloud_points(message, limit)
            points = pose.apply(found[:: -(-len(found) // limit) or 1])
        self.packed, self.count = packed(points), len(points)


class PointSources:
    """All scanners and sources of clouds. Each is separate, so that none replaces another."""

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
        """Number of these points."""
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
