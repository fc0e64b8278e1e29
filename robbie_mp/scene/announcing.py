"""Messages that publish the state of a scene graph, so that others can follow it."""

from collections.abc import Iterable
from contextlib import suppress

from robbie_mp.messages import (
    Header,
    SceneGraphState,
    SceneNodeState,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
)
from robbie_mp.scene.conversion import to_transform
from robbie_mp.scene.errors import TooOld
from robbie_mp.scene.graph import SceneGraph
from robbie_mp.scene.node import JointType, Node


def transforms_at(graph: SceneGraph, moved: Iterable[tuple[str, int]]) -> TFMessage:
    """Return the poses of nodes in their parents.

    Args:
        graph: the graph that the nodes are part of.
        moved: names of nodes, each with a time in ns; times that the graph no longer remembers are left out.
    """
    transforms = []
    for name, time_ns in moved:
        with suppress(TooOld):
            transforms.append(_stamped(graph, graph.node(name), time_ns))
    return TFMessage(transforms=transforms)


def fixed_transforms(graph: SceneGraph, now_ns: int) -> TFMessage:
    """Return the poses of all nodes that are fixed to their parents."""
    fixed = [node for node in graph if node.parent is not None and node.joint is None]
    return TFMessage(transforms=[_stamped(graph, node, now_ns) for node in fixed])


def state_of(graph: SceneGraph) -> SceneGraphState:
    """Return the whole scene graph as a message."""
    nodes = [_node_state(graph, node) for node in graph]
    newest = max((node.stamp.nanoseconds for node in nodes), default=0)
    return SceneGraphState(header=Header(stamp=Time.from_nanoseconds(newest)), nodes=nodes)


def _stamped(graph: SceneGraph, node: Node, time_ns: int) -> TransformStamped:
    parent = node.parent or ""
    return TransformStamped(
        header=Header(stamp=Time.from_nanoseconds(time_ns), frame_id=parent),
        child_frame_id=node.name,
        transform=to_transform(graph.pose(parent, node.name, time_ns)),
    )


def _node_state(graph: SceneGraph, node: Node) -> SceneNodeState:
    newest_ns = graph.newest_ns(node.name)
    is_placed = node.joint_type is JointType.FIXED or newest_ns is not None
    transform = Transform()
    if node.parent is not None and is_placed:
        transform = to_transform(graph.pose(node.parent, node.name, newest_ns))
    return SceneNodeState(
        name=node.name,
        parent=node.parent or "",
        type=node.joint_type.value,
        joint=node.joint.name if node.joint else "",
        is_placed=is_placed,
        stamp=Time.from_nanoseconds(newest_ns or 0),
        transform=transform,
    )
