"""The robot, other robots and their surroundings at one time, in the map frame."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robbie_mp.messages import Path, Pose, PoseStamped
from robbie_mp.scene import RigidTransform, SceneGraphError, SceneGraphListener
from robbie_mp.station.map.goals import goal_now
from robbie_mp.station.map.marks import MapMark
from robbie_mp.station.map.trail import Trail
from robbie_mp.station.scene_view.picture_pose import MAP, pose_for_picture
from robbie_mp.station.scene_view.point_sources import PointSources
from robbie_mp.station.scene_view.points import packed

if TYPE_CHECKING:
    from robbie_mp.station.context import StationContext


BASE = "base_link"
MAX_ROBOTS = 32


def other_robots(scene: SceneGraphListener, world: str) -> dict[str, RigidTransform]:
    """Return the newest known poses of other robots, X_WB, by their names.

    Args:
        scene: the scene graph; used in the thread that updates it.
        world: the frame W.
    """
    names = [node.name for node in scene.graph if node.name.endswith(f"/{BASE}")]
    found: dict[str, RigidTransform] = {}
    for name in names[:MAX_ROBOTS]:
        try:
            found[name.removesuffix(f"/{BASE}")] = scene.pose(world, name)
        except SceneGraphError:
            continue
    return found


MAX_CORNERS = 1000
PATH_HEIGHT_M = 0.02


class SeenPlace(NamedTuple):
    """The drawing data of a point of interest; m, map frame."""

    name: str
    x: float
    y: float
    z: float


@dataclass(frozen=True)
class SceneContents:
    """Everything that is drawn."""

    world: str
    """Frame of points and path, and root of the nodes."""
    nodes: dict[str, tuple[str, RigidTransform]]
    """Parent and X_PN of all nodes with a known pose, parents first."""
    robot: RigidTransform | None
    """Pose of the robot, X_WB."""
    points: dict[str, bytes]
    """Packed points of each source."""
    count: int
    """Number of points."""
    path: bytes
    trail: bytes
    """The way that the robot has come, packed as the path is."""
    goal: tuple[float, float, float] | None
    """x and y (m) and heading (rad) of the goal, map frame."""
    marks: dict[str, tuple[MapMark, ...]]
    """Marks of panels, by the titles of the sources."""
    others: dict[str, RigidTransform]
    """Poses of other robots by their names, X_WB."""
    places: tuple[SeenPlace, ...]

    def parts(self) -> dict[str, bytes]:
        """Return the moving parts in the form that the page's script draws."""
        robot = None if self.robot is None else _rounded(self.robot)
        poses = {
            "robot": robot,
            "goal": self.goal,
            "nodes": {name: _rounded(pose) for name, (_, pose) in self.nodes.items()},
        }
        return {"poses": json.dumps(poses).encode(), "path": self.path, "trail": self.trail, **self.points}


def _planar(pose: Pose) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = (
        round(number, 3) for number in (pose.position.x, pose.position.y, pose.orientation.yaw)
    )
    return x_m, y_m, yaw_rad


def _rounded(pose: RigidTransform) -> list[float]:
    return [round(number, 4) for number in pose]


class Surveyor:
    """Combines the messages of the modules. Used in the station's thread.

    Args:
        station: source of all that is combined.
    """

    def __init__(self, station: StationContext):
        self._scene, self._map = station.robot.scene, station.map
        messages = station.messages
        self._path = messages.newest(Path, "path")
        self._packed_path: tuple[int, bytes] = (0, b"")
        self._goal = messages.newest(PoseStamped, "goal")
        self._trail = Trail(messages)
        self._packed_trail: tuple[int, bytes] = (0, b"")
        self._sources = PointSources(messages, station.run.figures)

    def look(self) -> SceneContents:
        """Return the present surroundings."""
        graph = self._scene.graph
        world = MAP
        if MAP not in graph and BASE in graph:
            world = BASE
            while (parent := graph.node(world).parent) is not None:
                world = parent
        points = self._sources.look(lambda frame, time_ns: self._pose(world, frame, time_ns), world)
        return SceneContents(
            world=world,
            nodes=self._nodes(world),
            robot=self._pose(world, BASE),
            points=points,
            count=self._sources.count,
            path=self._corners(),
            trail=self._way_come(),
            goal=None if (goal := goal_now(self._goal.message)) is None else _planar(goal.pose),
            marks=self._map.marks.now(),
            others=other_robots(self._scene, world),
            places=tuple(
                SeenPlace(one.name, one.pose.position.x, one.pose.position.y, one.pose.position.z)
                for one in self._map.places.places
            ),
        )

    def _pose(self, world: str, frame: str, time_ns: int | None = None) -> RigidTransform | None:
        return pose_for_picture(self._scene, world, frame, time_ns)

    def _nodes(self, world: str) -> dict[str, tuple[str, RigidTransform]]:
        graph = self._scene.graph
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

    def _corners(self) -> bytes:
        path = self._path
        if path.message is not None and self._packed_path[0] != path.count:
            poses = path.message.poses
            chosen = [pose.pose.position for pose in poses[:: -(-len(poses) // MAX_CORNERS) or 1]]
            corners = np.array([(corner.x, corner.y, corner.z + PATH_HEIGHT_M) for corner in chosen])
            self._packed_path = (path.count, packed(corners.reshape(-1, 3)))
        return self._packed_path[1]

    def _way_come(self) -> bytes:
        trail = self._trail
        if self._packed_trail[0] != trail.count:
            points = np.array([(x_m, y_m, PATH_HEIGHT_M) for x_m, y_m in trail.points])
            self._packed_trail = (trail.count, packed(points.reshape(-1, 3)))
        return self._packed_trail[1]
