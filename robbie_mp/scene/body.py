"""Rigid bodies: all nodes that are fixed to one another belong to the same body."""

import math
from collections.abc import Callable

from robbie_mp.scene.history import History
from robbie_mp.scene.node import Joint, JointType, Node
from robbie_mp.scene.rigid_transform import IDENTITY, Pose7, compose

PoseAt = Callable[[int], Pose7]


class Body:
    """A rigid body, and its pose in the body that it moves against.

    Args:
        parent: the body that it moves against; None for the body of a root.
        history: its motion over time; None for the body of a root.
        pose_at: returns its pose in the parent at a time, in ns.
    """

    __slots__ = ("depth", "history", "parent", "pose_at", "root")

    def __init__(
        self,
        root: str,
        parent: "Body | None",
        history: History[Pose7] | History[float] | None,
        pose_at: PoseAt,
    ):
        self.root = root
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0
        self.history = history
        self.pose_at = pose_at


class PlacedNode:
    """A node, the body that it is part of, and its constant pose in that body."""

    __slots__ = ("body", "node", "place")

    def __init__(self, node: Node, body: Body, place: Pose7):
        self.node = node
        self.body = body
        self.place = place


def root_node(node: Node) -> PlacedNode:
    """Return a node without a parent, in a new body."""
    return PlacedNode(node, Body(node.name, None, None, lambda _time_ns: IDENTITY), IDENTITY)


def fixed_node(node: Node, parent: PlacedNode) -> PlacedNode:
    """Return a node that is fixed to its parent."""
    return PlacedNode(node, parent.body, compose(parent.place, node.origin))


def jointed_node(node: Node, joint: Joint, parent: PlacedNode, history: History[float]) -> PlacedNode:
    """Return a node that moves with the position of its joint, or of the joint that this one follows."""
    base = compose(parent.place, node.origin)
    mimic = joint.mimic
    multiplier, offset = (mimic.multiplier, mimic.offset) if mimic else (1.0, 0.0)
    motion = _slide(base, joint.axis) if joint.type is JointType.PRISMATIC else _turn(base, joint.axis)

    def pose_at(time_ns: int) -> Pose7:
        return motion(multiplier * history.at(time_ns) + offset)

    return PlacedNode(node, Body(parent.body.root, parent.body, history, pose_at), IDENTITY)


def floating_node(node: Node, parent: PlacedNode, history: History[Pose7]) -> PlacedNode:
    """Return a floating node, which is placed by whole poses."""
    base = parent.place

    def pose_at(time_ns: int) -> Pose7:
        return compose(base, history.at(time_ns))

    is_plain = base == IDENTITY
    return PlacedNode(
        node, Body(parent.body.root, parent.body, history, history.at if is_plain else pose_at), IDENTITY
    )


def _turn(base: Pose7, axis: tuple[float, float, float]) -> Callable[[float], Pose7]:
    px, py, pz, ax, ay, az, aw = base
    x, y, z = axis

    def pose(angle_rad: float) -> Pose7:
        sine, bw = math.sin(angle_rad / 2), math.cos(angle_rad / 2)
        bx, by, bz = x * sine, y * sine, z * sine
        return (
            px,
            py,
            pz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )

    return pose


def _slide(base: Pose7, axis: tuple[float, float, float]) -> Callable[[float], Pose7]:
    px, py, pz, qx, qy, qz, qw = base
    end = compose(base, (*axis, 0.0, 0.0, 0.0, 1.0))
    x, y, z = end[0] - px, end[1] - py, end[2] - pz

    def pose(distance_m: float) -> Pose7:
        return (px + x * distance_m, py + y * distance_m, pz + z * distance_m, qx, qy, qz, qw)

    return pose
