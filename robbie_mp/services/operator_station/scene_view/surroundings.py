"""The robot and what is around it at one moment, in the frame of the map."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import LaserScan, OccupancyGrid, Path, PointCloud2
from robbie_mp.scene_graph import RigidTransform, SceneGraphError, TooNew, TooOld
from robbie_mp.services.operator_station.scene_view.floor import Floor, floor_of
from robbie_mp.services.operator_station.scene_view.points import cloud_points, packed, scan_points

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.latest import Latest
    from robbie_mp.services.operator_station.station import OperatorStation

BASE, MAP = "base_link", "map"
MAX_POINTS = 10_000
"""In one picture, of all scans and clouds together."""
MAX_SOURCES = 4
"""Scanners, and as many sources of clouds."""
MAX_CORNERS = 1000
FLOOR_PERIOD_S = 1.0


class SeenVictim(NamedTuple):
    """What is drawn of a victim; m, map frame."""

    name: str
    state: int
    x: float
    y: float
    z: float


@dataclass(frozen=True)
class Surroundings:
    """What there is to be drawn."""

    world: str
    """The frame of points and path, and the root of the nodes."""
    nodes: dict[str, tuple[str, RigidTransform]]
    """Parent, and X_PN, of all whose place is known, parents first."""
    robot: RigidTransform | None
    """X_WB."""
    points: str
    """Packed, as all points here."""
    count: int
    """Of the points."""
    path: str
    victims: dict[int, SeenVictim]
    floor: Floor | None


class Surveyor:
    """Puts together what the modules say; lives in the station's thread.

    Args:
        station: hears them.
    """

    def __init__(self, station: OperatorStation):
        self._station = station
        self._map = station.newest(OccupancyGrid)
        self._path = station.newest(Path, "path")
        self._scans: dict[str, Latest[LaserScan]] = {}
        self._clouds: dict[str, Latest[PointCloud2]] = {}
        self._floor: Floor | None = None
        self._drawn = 0
        self._drawn_s = 0.0

    def look(self) -> Surroundings:
        """Tell how everything is now."""
        self._find_sources()
        graph = self._station.scene.graph
        world = MAP
        if MAP not in graph and BASE in graph:
            world = BASE
            while (parent := graph.node(world).parent) is not None:
                world = parent
        nodes = self._nodes(world)
        points = self._points(world)
        return Surroundings(
            world=world,
            nodes=nodes,
            robot=self._pose(world, BASE),
            points=packed(points),
            count=len(points),
            path=packed(self._corners()),
            victims=self._victims(),
            floor=self._draw_floor(),
        )

    def _find_sources(self) -> None:
        """Subscribe to each scanner on its own, so that none takes the place of another."""
        reading = self._station.run_watch.reading
        for channel in reading.channels if reading else ():
            key = (channel.type_name, channel.version)
            if key == (LaserScan.type_name, LaserScan.version) and len(self._scans) < MAX_SOURCES:
                self._scans.setdefault(channel.topic, self._station.newest(LaserScan, channel.topic))
            if key == (PointCloud2.type_name, PointCloud2.version) and len(self._clouds) < MAX_SOURCES:
                self._clouds.setdefault(channel.topic, self._station.newest(PointCloud2, channel.topic))

    def _pose(self, world: str, frame: str, time_ns: int | None = None) -> RigidTransform | None:
        scene = self._station.scene
        try:
            try:
                return scene.pose(world, frame, time_ns)
            except (TooNew, TooOld):
                return scene.pose(world, frame)  # better than nothing, for eyes
        except SceneGraphError:
            return None

    def _nodes(self, world: str) -> dict[str, tuple[str, RigidTransform]]:
        graph = self._station.scene.graph
        waiting = [node for node in graph if node.parent is not None]
        found: dict[str, tuple[str, RigidTransform]] = {}
        known = {world}
        while ready := [node for node in waiting if node.parent in known]:
            waiting = [node for node in waiting if node.parent not in known]
            for node in ready:
                pose = self._pose(str(node.parent), node.name)
                if pose is not None:
                    found[node.name] = (str(node.parent), pose)
                    known.add(node.name)
        return found

    def _points(self, world: str) -> NDArray[np.float64]:
        parts = [np.zeros((0, 3))]
        seen: list[LaserScan | PointCloud2 | None] = [latest.message for latest in self._scans.values()]
        seen += [latest.message for latest in self._clouds.values()]
        share = MAX_POINTS // max(1, len(seen))
        for message in seen:
            if message is None:
                continue
            pose = self._pose(world, message.header.frame_id, message.header.stamp.nanoseconds)
            if pose is not None:
                points = (
                    scan_points(message) if isinstance(message, LaserScan) else cloud_points(message, share)
                )
                parts.append(pose.apply(points[:: -(-len(points) // share) or 1]))
        return np.concatenate(parts)

    def _corners(self) -> NDArray[np.float64]:
        poses = self._path.message.poses if self._path.message is not None else []
        chosen = [pose.pose.position for pose in poses[:: -(-len(poses) // MAX_CORNERS) or 1]]
        return np.array([(corner.x, corner.y, corner.z + 0.02) for corner in chosen]).reshape(-1, 3)

    def _victims(self) -> dict[int, SeenVictim]:
        found = (known.found for known in self._station.victim_watch.victims.values())
        return {
            one.id: SeenVictim(
                one.name, one.state, one.pose.position.x, one.pose.position.y, one.pose.position.z
            )
            for one in found
        }

    def _draw_floor(self) -> Floor | None:
        now_s = time.monotonic()
        is_new = self._map.count != self._drawn and now_s - self._drawn_s >= FLOOR_PERIOD_S
        if self._map.message is not None and is_new:
            self._drawn, self._drawn_s = self._map.count, now_s
            self._floor = floor_of(self._map.message)
        return self._floor
