"""Where the simulated robot's parts truly are."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp.scene import JointType, SceneGraph, read_scene
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.hw.simulation.urdf_solids import LinkSolid, read_urdf_solids

BASE = "base_link"


class RobotShapes:
    """The collision shapes of a robot, placed by its joints.

    Args:
        file: the robot's URDF.

    Raises:
        SceneFileError, UrdfShapeError, OSError: the file is invalid or cannot be read.
    """

    def __init__(self, file: Path) -> None:
        self._graph = SceneGraph(read_scene(file), history_s=1.0)
        self._solids = read_urdf_solids(file)
        self.joints = {
            placed.joint.name: placed.joint
            for placed in self._graph
            if placed.joint is not None and placed.joint.type is not JointType.FLOATING
        }
        self._links = {placed.joint.name: placed.name for placed in self._graph if placed.joint is not None}
        self._moving = [shape for shape in self._solids if self._moves(shape.link)]
        self._time_ns = 0
        self.move({name: 0.0 for name, joint in self.joints.items() if joint.mimic is None})

    def move(self, positions: Mapping[str, float]) -> None:
        """Move joints, rad or m; joints that the robot does not have are ignored."""
        self._time_ns += 1
        for name in self.joints:
            if name in positions:
                self._graph.set_joint(name, self._time_ns, positions[name])

    def pose(self, link: str, robot: Pose) -> NDArray[np.float64]:
        """Return X_AL of a link: (4, 4), where the robot's base has a pose in the arena."""
        return on_floor(robot) @ self._graph.pose(BASE, link).matrix

    def torque_nm(
        self, name: str, robot: Pose, point: NDArray[np.float64], force: NDArray[np.float64]
    ) -> float:
        """Return the torque of a force about a joint that turns.

        Args:
            name: the joint.
            robot: the pose of the robot's base in the arena.
            point: (3,), m, arena frame: where the force acts.
            force: (3,), N, arena frame.
        """
        X_AL = self.pose(self._links[name], robot)
        axis = X_AL[:3, :3] @ np.array(self.joints[name].axis)
        return float(axis @ np.cross(point - X_AL[:3, 3], force))

    def arm(self, robot: Pose) -> list[Placed]:
        """Return the shapes that joints move."""
        return self._placed(self._moving, robot)

    def all(self, robot: Pose) -> list[Placed]:
        """Return all shapes."""
        return self._placed(self._solids, robot)

    def _placed(self, shapes: list[LinkSolid], robot: Pose) -> list[Placed]:
        X_AB = on_floor(robot)
        links = {shape.link for shape in shapes}
        poses = {link: X_AB @ self._graph.pose(BASE, link).matrix for link in links}
        return [Placed(shape.solid, poses[shape.link] @ shape.pose) for shape in shapes]

    def _moves(self, link: str) -> bool:
        nodes = {node.name: node for node in self._graph}
        node = nodes[link]
        while node.parent is not None:
            if node.joint is not None:
                return True
            node = nodes[node.parent]
        return False


def on_floor(robot: Pose) -> NDArray[np.float64]:
    """Return the pose of a robot on the floor: (4, 4)."""
    return pose_at((robot.x_m, robot.y_m, 0.0), robot.heading_rad)


def table_solids(arena: Arena) -> list[Placed]:
    """Return the tables of an arena."""
    placed = []
    for table in arena.tables:
        x1, y1, x2, y2 = table.corners_m
        solid = Solid((abs(x2 - x1), abs(y2 - y1), table.height_m))
        placed.append(Placed(solid, pose_at(((x1 + x2) / 2, (y1 + y2) / 2, table.height_m / 2))))
    return placed
